"""What the documentation says is true: its links lead somewhere, its commands run."""

import argparse
import ast
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
import yaml
from pages import BENCHMARKS, PAGES, ROOT, fenced

from truewrench.cli import app


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as code hosts form them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        linked = (page.parent / name).resolve() if name else page
        assert linked.exists(), f"{page.name} links to {target}"
        if anchor:
            assert anchor in anchors(linked), f"{page.name} links to {target}"


def test_python_of_the_documentation_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import truewrench as tw
    from truewrench.simulation.free_body import simulate

    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    simulate(tw.load_rig("examples/rig.yaml")).write(tmp_path / "out" / "run.csv")
    (block,) = fenced(ROOT / "README.md", "python")
    names: dict[str, object] = {}
    exec(block, names)
    assert names["wrench"].shape[1] == 6  # type: ignore[attr-defined]
    for page in sorted((ROOT / "docs").glob("*.md")):  # which go on from there
        for block in fenced(page, "python"):
            exec(block, names)


@pytest.mark.parametrize("page", ["README.md", "docs/formats.md"])
def test_rigs_in_the_documentation_load(page: str, tmp_path: Path) -> None:
    import truewrench as tw

    for number, block in enumerate(fenced(ROOT / page, "yaml")):
        path = tmp_path / f"rig{number}.yaml"
        path.write_text(block)
        rig = tw.load_rig(path)
        assert rig.sensor.n == len(yaml.safe_load(block)["sensor"]["channels"])


def test_rig_shown_in_the_readme_is_the_example() -> None:
    (block,) = fenced(ROOT / "README.md", "yaml")
    assert yaml.safe_load(block) == yaml.safe_load((ROOT / "examples" / "rig.yaml").read_text())


# Benchmarks take hours, and the tools of docs/results.md are recordings that are not part of the repository.
NOT_RUN = re.compile(r"python benchmarks/|truewrench calibrate (tools|static)/")

TUTORIALS = ("tutorial.md", "tool_tutorial.md")  # each runs by itself, below

# The plan of an arm for 20 s at 500 Hz takes a minute: here the same commands get a short motion.
SHORT = {
    "plan": {"duration": 3, "rate": 15, "harmonics": 2},
    "simulate": {"rate": 50, "sensor_rate": 100},
    "required": 10,
}


def run(block: str, folder: Path) -> int:
    """The status of a block that runs as it stands."""
    if not (folder / "examples").exists():
        (folder / "examples").symlink_to(ROOT / "examples")
    scripts = Path(sys.executable).parent
    path = f"{scripts}{os.pathsep}{os.environ['PATH']}"
    result = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block], cwd=folder, capture_output=True, text=True, check=False,
        env={**os.environ, "PATH": path, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert result.returncode in (0, 3), f"{block}\n{result.stdout}\n{result.stderr}"
    return result.returncode


def test_commands_of_the_readme_run_in_order_and_those_of_pages_go_on_from_there(tmp_path: Path) -> None:
    commands = re.findall(r"^truewrench .*$", "\n".join(fenced(ROOT / "README.md", "sh")), re.MULTILINE)
    assert len(commands) == 3
    assert [run(command, tmp_path) for command in commands] == [0, 0, 0]
    header = (tmp_path / "out" / "corrected.csv").read_text().splitlines()[0].split(",")
    assert {"fx", "mz", "fx_std", "mz_std"} <= set(header)
    for page in sorted((ROOT / "docs").glob("*.md")):
        for block in fenced(page, "sh"):
            if page.name not in TUTORIALS and not NOT_RUN.match(block):
                assert run(block, tmp_path) == 0, f"{page.name}: {block}"


def test_commands_of_the_tutorial_run_in_order_with_a_short_motion(tmp_path: Path) -> None:
    first, *rest = fenced(ROOT / "docs" / "tutorial.md", "sh")
    assert run(first, tmp_path) == 0
    rig = tmp_path / "rig.yaml"
    settings = yaml.safe_load(rig.read_text())
    for key, value in SHORT.items():
        settings[key] = {**settings[key], **value} if isinstance(value, dict) else value
    rig.write_text(yaml.safe_dump(settings))
    for block in rest:
        run(block, tmp_path)  # status 3 does, too: a short motion tells less, and the verdict says so
    assert len((tmp_path / "corrected.csv").read_text().splitlines()) > 100


def test_commands_of_the_tutorial_of_a_tool_run_in_order_and_end_as_it_says(tmp_path: Path) -> None:
    page = ROOT / "docs" / "tool_tutorial.md"
    for block in fenced(page, "sh"):
        assert run(block.replace("--poses 8", "--poses 6 --dwell 2"), tmp_path) == 0, block
    tool = yaml.safe_load((tmp_path / "tool" / "tool.yaml").read_text())
    assert tool["mass"] == pytest.approx(1.37, abs=0.01)
    assert (
        f"set_target_payload({tool['exported']['mass']:.9g}, "
        in (tmp_path / "tool/tool_ur.script").read_text()
    )
    assert (tmp_path / "contact.png").stat().st_size > 10_000
    assert len(page.read_text().split()) < 900


def test_commands_of_benchmarks_are_understood_by_their_scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to the point at which hours of work would begin; `make test-benchmarks` runs them, smaller."""
    parse = argparse.ArgumentParser.parse_args

    def parse_and_stop(parser: argparse.ArgumentParser) -> None:
        parse(parser)
        raise SystemExit("understood")

    assert len(BENCHMARKS) > 20
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, "path", [str(ROOT / "benchmarks"), *sys.path])
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_and_stop)
    for command in BENCHMARKS:
        _, script, *arguments = shlex.split(command, comments=True)
        monkeypatch.setattr(sys, "argv", [script, *arguments])
        with pytest.raises(SystemExit, match="understood"):
            runpy.run_path(script, run_name="__main__")


def test_make_targets_named_in_the_documentation_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {
        name
        for page in PAGES
        for text in [*fenced(page, "sh"), *re.findall(r"`(make [^`\n]+)`", page.read_text())]
        for name in re.findall(r"^make ([a-z][a-z-]*)", text, re.MULTILINE)
    }
    assert len(named) > 5
    assert named <= targets


def test_usage_lines_name_commands_and_options_that_exist() -> None:
    commands = typer.main.get_command(app)
    assert isinstance(commands, typer.core.TyperGroup)
    usages = [
        match.split("  ")[0]
        for page in PAGES
        for match in re.findall(r"^    truewrench (.+)$", page.read_text(), re.MULTILINE)
    ]
    assert usages
    for usage in usages:
        name = usage.split()[0]
        known = {option for parameter in commands.commands[name].params for option in parameter.opts}
        assert set(re.findall(r"(?<![\w-])--?[a-z][a-z0-9-]*", usage)) <= known, usage


def test_messages_quoted_in_troubleshooting_are_those_of_the_product() -> None:
    said = [
        node.value
        for path in (ROOT / "src" / "truewrench").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    quoted = re.findall(r"^> (.+)$", (ROOT / "docs" / "troubleshooting.md").read_text(), re.MULTILINE)
    assert len(quoted) > 20
    for message in quoted:  # what is fixed, between names, numbers and punctuation
        parts = [part.strip() for part in re.split(r"[….:,;()]+", message)]
        for part in parts:
            assert any(part in text for text in said), f"nobody says `{part}` of `{message}`"
