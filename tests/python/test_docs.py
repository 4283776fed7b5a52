"""What the documentation says is true: its links lead somewhere, its commands run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])


def fenced(page: Path, language: str) -> list[str]:
    """The fenced blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


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


def test_readme_commands_run_in_order(tmp_path: Path) -> None:
    commands = [
        line.split("#")[0].strip()
        for block in fenced(ROOT / "README.md", "sh")
        for line in block.splitlines()
        if line.startswith("truewrench")
    ]
    assert len(commands) == 3
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for command in commands:
        result = subprocess.run(
            [str(Path(sys.executable).with_name("truewrench")), *command.split()[1:]],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert result.returncode == 0, f"{command}\n{result.stdout}\n{result.stderr}"
    header = (tmp_path / "out" / "corrected.csv").read_text().splitlines()[0].split(",")
    assert {"fx", "mz", "fx_std", "mz_std"} <= set(header)


def test_readme_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import truewrench as tw
    from truewrench.simulate import simulate

    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    simulate(tw.load_rig("examples/rig.yaml")).write(tmp_path / "out" / "run.csv")
    (block,) = fenced(ROOT / "README.md", "python")
    names: dict[str, object] = {}
    exec(block, names)
    assert names["wrench"].shape[1] == 6  # type: ignore[attr-defined]


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
