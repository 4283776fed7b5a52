"""Size of a report and the time a browser takes to load it: 60 s at 1 kHz.

    python benchmarks/report.py [--duration 60] [--rate 1000] [--repeats 5]

Headless Chromium, started anew for every load of the file; medians. `verdict` is the first paint, `loaded`
the browser's load event, `figures` when the last figure is drawn;
behind each what the page's main thread has spent until then, which other work on the machine does not change.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

import truewrench as tw
from truewrench.calibrating.pipeline import calibrate
from truewrench.estimation.evidence import Evidence
from truewrench.report.page import write_report
from truewrench.simulation.free_body import simulate

EXAMPLE = Path(__file__).parents[1] / "examples" / "rig.yaml"
DRAWN = "[...document.querySelectorAll('.plot')].every(p => p.children.length)"
TIMES = """(() => {
  const [page] = performance.getEntriesByType('navigation');
  return [performance.getEntriesByName('first-contentful-paint')[0].startTime, page.loadEventEnd];
})()"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    rig = tw.load_rig(EXAMPLE)
    rig = rig.model_copy(
        update={
            "plan": rig.plan.model_copy(update={"duration": options.duration}),
            "simulate": rig.simulate.model_copy(update={"rate": options.rate, "sensor_rate": options.rate}),
        }
    )
    log = simulate(rig).log
    seen: list[Evidence] = []
    calibration = calibrate(rig, log, held_out=False, evidence=seen.append)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "report.html"
        write_report(path, calibration, seen[0])  # once for the imports
        began = time.perf_counter()
        write_report(path, calibration, seen[0])
        written = time.perf_counter() - began
        size = path.stat().st_size
        rows = [_load(path, size) for size in ((1280, 800), (360, 740)) for _ in range(options.repeats)]
    print(f"{len(log.time_ns)} rows: {size / 1e6:.2f} MB, written in {written:.2f} s\n")
    print("| window | verdict [s] | loaded [s] | its CPU [s] | figures [s] | their CPU [s] |")
    print("|---|---|---|---|---|---|")
    for name, part in (("desktop", rows[: options.repeats]), ("phone", rows[options.repeats :])):
        medians = (f"{statistics.median(column):.2f}" for column in zip(*part, strict=True))
        print(f"| {name} | {' | '.join(medians)} |")


def _load(path: Path, size: tuple[int, int]) -> tuple[float, ...]:
    """First paint, load event and last figure in a browser of its own, with CPU times behind [s]."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page: Any = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.goto("about:blank")
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable", {"timeDomain": "threadTicks"})
        began = time.perf_counter()
        page.goto(path.as_uri())
        spent = _spent(session)
        while not page.evaluate(DRAWN):
            page.wait_for_timeout(10)
        drawn = time.perf_counter() - began
        first, loaded = page.evaluate(TIMES)
        spent_at_last = _spent(session)
        browser.close()
    return first / 1e3, loaded / 1e3, spent, drawn, spent_at_last


def _spent(session: Any) -> float:
    metrics = {m["name"]: m["value"] for m in session.send("Performance.getMetrics")["metrics"]}
    return float(metrics["TaskDuration"])


if __name__ == "__main__":
    main()
