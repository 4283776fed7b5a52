"""What holds for the package as a whole: which core is loaded, stubs, direction of imports."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from truewrench._cpu import supports_x86_64_v3

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "truewrench"

# The floors of the package, lowest first: imports run downward only.
FLOORS = [
    {"_cpu"},
    {"_core"},
    {"model"},
    {"robot", "robots"},
    {"estimation", "io"},
    {"inspection", "judging", "simulation", "tool"},
    {"calibrating", "correction", "planning", "report"},
    {"campaign", "demo", "live", "public"},
    {"cli"},
]
FLOOR_OF = {unit: floor for floor, units in enumerate(FLOORS) for unit in units}


def loaded_variant(requested: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from truewrench import _core; print(_core.variant)"],
        env={**os.environ, "TRUEWRENCH_CORE": requested},
        capture_output=True,
        text=True,
        check=False,
    )


def test_default_core_is_the_fastest_that_the_processor_runs() -> None:
    assert loaded_variant("").stdout.strip() == ("avx2" if supports_x86_64_v3() else "baseline")


def test_baseline_core_can_be_forced_everywhere() -> None:
    assert loaded_variant("baseline").stdout.strip() == "baseline"


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="asks Linux as the independent witness")
def test_processor_features_agree_with_the_kernel() -> None:
    flags = set(Path("/proc/cpuinfo").read_text().split())
    assert supports_x86_64_v3() == ({"avx2", "fma", "bmi1", "bmi2"} <= flags)


def test_unknown_core_is_refused_with_the_names_that_would_do() -> None:
    result = loaded_variant("sse9")
    assert result.returncode != 0
    assert "TRUEWRENCH_CORE='sse9'" in result.stderr
    assert "baseline" in result.stderr


def test_committed_stubs_are_those_of_the_compiled_modules() -> None:
    result = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "make_stubs.py"), "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr


def imported_units(path: Path) -> set[str]:
    """Top-level units of the package that a source file imports."""
    units: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute, so that their direction can be seen"
            if node.module == "truewrench":
                units |= {a.name if a.name in FLOOR_OF else "public" for a in node.names}
            elif node.module and node.module.startswith("truewrench."):
                units.add(node.module.split(".")[1])
        elif isinstance(node, ast.Import):
            units |= {a.name.split(".")[1] for a in node.names if a.name.startswith("truewrench.")}
    return units


def test_imports_run_downward_only() -> None:
    upward = []
    for path in sorted(PACKAGE.rglob("*.py")):
        unit = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if unit in ("__init__", "__main__"):
            continue
        assert unit in FLOOR_OF, f"{unit} has no floor: give it one in FLOORS"
        for imported in imported_units(path) - {unit}:
            if FLOOR_OF[imported] >= FLOOR_OF[unit]:
                upward.append(f"{path.relative_to(PACKAGE)} imports {imported}")
    assert not upward
