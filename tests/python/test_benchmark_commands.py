"""Every documented command of a benchmark runs to its end, at its smallest size: `make test-benchmarks`."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from pages import BENCHMARKS, ROOT

SMALLEST: dict[str, str] = {
    "chain.py": "--runs 1 --arm panda_ground",
    "confident.py": "--runs 1",
    "contact.py": "--tools 1 --hours 0.02",
    "contact_free.py": "--runs 2",
    "coverage.py": "--runs 2",
    "demo_seeds.py": "--seeds 1",
    "efficiency.py": "--seeds 2",
    "far_clocks.py": "--runs 2",
    "grid.py": "--runs 1 --samples 2000",
    "healthy.py": "--runs 2",
    "imperfect.py": "--runs 2",
    "imperfect_tools.py": "--runs 2",
    "live.py": "--duration 3 --rate 200",
    "live_tool.py": "--duration 3 --rate 200",
    "long_records.py": "--hours 0.01 --records 1",
    "plans.py": "",
    "pooled_logs.py": "--runs 2",
    "rates.py": "--runs 1",
    "recordings.py": "--duration 3 --repeat 1 --size 0.02",
    "reference_wrenches.py": "--seeds 4",
    "report.py": "--duration 5 --repeats 1",
    "robot_accuracy.py": "--states 20",
    "setup_sweep.py": "--healthy 4 --end-to-end 1",
    "smoothed.py": "--runs 2",
    "shaken.py": "--runs 2",
    "speed.py": "--duration 5 --repeat 1",
    "static_poses.py": "",
    "tool_setup.py": "--seeds 1 --healthy 1",
    "tools.py": "--draws 2",
    "unknown_tools.py": "--runs 2",
    "wrench_accuracy.py": "--draws 20",
}


@pytest.mark.campaign
@pytest.mark.parametrize("command", BENCHMARKS)
def test_command_runs_to_its_end(command: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    _, script, *arguments = shlex.split(command, comments=True)
    name = Path(script).name
    environment = dict(os.environ)
    if name == "tools.py":
        environment["TRUEWRENCH_EXTERNAL_DATA"] = str(request.getfixturevalue("external_data"))
    done = subprocess.run(
        [sys.executable, str(ROOT / script), *arguments, *SMALLEST[name].split()],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.strip() or any(tmp_path.iterdir())  # tables, or what it was told to write
