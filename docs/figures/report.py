"""Draws docs/figures/report.png: the first screen of the report of a simulated log of the example.

python docs/figures/report.py
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

import truewrench as tw
from truewrench.calibrating.pipeline import calibrate
from truewrench.estimation.evidence import Evidence
from truewrench.report.page import write_report
from truewrench.simulation.free_body import simulate

HERE = Path(__file__).parent
SIZE = (1180, 880)


def main() -> None:
    """Simulate, calibrate, report, and take a picture."""
    seen: list[Evidence] = []
    rig = tw.load_rig(HERE.parents[1] / "examples" / "rig.yaml")
    calibration = calibrate(rig, simulate(rig).log, evidence=seen.append)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        path = Path(folder) / "report.html"
        write_report(path, calibration, seen[0])
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        page.goto(path.as_uri())
        page.screenshot(path=HERE / "report.png")
        browser.close()


if __name__ == "__main__":
    main()
