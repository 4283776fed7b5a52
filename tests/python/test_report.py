"""Reports in a real browser: what they show first, that they ask for nothing, run nothing of others, fit."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from truewrench.calibration import Calibration, Verdict
from truewrench.evidence import Evidence
from truewrench.log import Log
from truewrench.pipeline import calibrate
from truewrench.report import write_report
from truewrench.rig import Rig
from truewrench.simulate import simulate

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>$$x$$\u2028"
EXACT = {"mass": 0, "center_of_mass": 0, "inertia": 0}
DESKTOP, PHONE = (1280, 800), (360, 740)
LARGEST = 4_000_000  # bytes

Found = tuple[Calibration, Evidence]


@dataclass
class Page:
    """A report that a browser has loaded, and what happened meanwhile."""

    page: Any
    requests: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    dialogs: list[str] = field(default_factory=list)

    def run(self, script: str) -> Any:
        return self.page.evaluate(script)

    def drawn(self) -> None:
        """Wait until every figure has a canvas."""
        for _ in range(300):
            if self.run("[...document.querySelectorAll('.plot')].every(p => p.children.length)"):
                return
            self.page.wait_for_timeout(50)
        raise AssertionError("a figure is missing")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if BROWSER is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture
def opened(browser: Any) -> Iterator[Callable[..., Page]]:
    contexts = []

    def open_page(path: Path, size: tuple[int, int] = DESKTOP, **options: Any) -> Page:
        context = browser.new_context(viewport={"width": size[0], "height": size[1]}, **options)
        contexts.append(context)
        shown = Page(context.new_page())
        shown.page.on("request", lambda request: shown.requests.append(request.url))
        shown.page.on("pageerror", lambda error: shown.errors.append(str(error)))
        shown.page.on("dialog", lambda dialog: (shown.dialogs.append(dialog.message), dialog.dismiss()))
        shown.page.on(
            "console", lambda said: said.type in ("error", "warning") and shown.errors.append(said.text)
        )
        shown.page.goto(path.as_uri())
        return shown

    yield open_page
    for context in contexts:
        context.close()


def settings_of(n: int = 6, duration: float = 10.0, rate: float = 100.0, **sensor: Any) -> dict[str, Any]:
    rows = np.vstack([np.eye(6), np.full((n - 6, 6), 0.5)])
    return {
        "sensor": {
            "channels": [f"c{i}" for i in range(n)],
            "feels": "payload_on_sensor",
            "noise": [0.1, 0.1, 0.1, 0.01, 0.01, 0.01, *[0.1] * (n - 6)],
            "range": [500, 500, 500, 50, 50, 50],
            "nominal_gain": rows.tolist(),
            "time_offset_prior": 0,
            **sensor,
        },
        "payloads": {
            "default": {
                "mass": 50,
                "center_of_mass": [0.2, 0, 0],
                "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4, "xy": 0, "xz": 0, "yz": 0},
                "uncertainty": EXACT,
            }
        },
        "motion": {"source": "twist", "of": "com", "noise": [1e-3] * 6},
        "plan": {"duration": duration},
        "simulate": {"rate": rate, "sensor_rate": rate},
    }


def found_by(rig: Rig, logs: Log | list[Log], estimator: Any = "map", **options: Any) -> Found:
    seen: list[Evidence] = []
    calibration = calibrate(rig, logs, estimator, evidence=seen.append, **options)
    return calibration, seen[0]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig.from_mapping(settings_of())


@pytest.fixture(scope="module")
def log(rig: Rig) -> Log:
    return simulate(rig, seed=1).log


@pytest.fixture(scope="module")
def found(rig: Rig, log: Log) -> Found:
    return found_by(rig, log)


@pytest.fixture(scope="module")
def report(found: Found, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, *found)
    return path


def weights(rig: Rig) -> Log:
    """Rows of dead weights, one of them noted wrong."""
    draw = np.random.default_rng(3)
    wrench = 0.5 * rig.sensor.range_array * draw.uniform(-1.0, 1.0, (40, 6))
    noise = rig.sensor.noise_array
    raw = wrench @ rig.sensor.nominal_gain_array.T * 1.1 + noise * draw.normal(size=(40, rig.sensor.n))
    wrench = wrench + np.array([0.1] * 3 + [0.01] * 3) * draw.normal(size=(40, 6))
    wrench[7] += 100.0
    return Log(None, "default", "", 10**10 * np.arange(40), raw, reference=wrench)


def still(log: Log) -> Log:
    """A log whose motion nothing fits."""
    draw = np.random.default_rng(0)
    assert log.twist is not None
    return replace(log, twist=draw.normal(size=log.twist.shape))


def touched(log: Log) -> Log:
    raw = log.raw.copy()
    raw[500:530] += 40.0
    return replace(log, raw=raw)


def make(kind: str, rig: Rig, log: Log) -> Found:
    """One calibration of every estimator and kind of input."""
    if kind in ("online", "ekf", "ls"):
        return found_by(rig, log, kind)
    if kind == "two logs, one touched":
        return found_by(rig, [touched(log), simulate(rig, seed=2).log], held_out=False)
    if kind == "nothing fits":
        return found_by(rig, still(log))
    if kind == "reference":
        settings = deepcopy(settings_of())
        settings["reference_noise"] = [0.1] * 3 + [0.01] * 3
        other = Rig.from_mapping(settings)
        return found_by(other, weights(other))
    if kind == "eight channels, three still axes":
        other = Rig.from_mapping(settings_of(n=8, duration=6.0))
        still_axes = simulate(other, seed=3).log
        assert still_axes.twist is not None
        draw = np.random.default_rng(4)
        twist = np.zeros_like(still_axes.twist)
        twist[:, 0] = np.sin(3.0 * still_axes.time)
        raw = -150.0 * np.cos(3.0 * still_axes.time)[:, None] * other.sensor.nominal_gain_array[:, 0]
        raw = raw + other.sensor.noise_array * draw.normal(size=raw.shape)
        twist += 1e-3 * draw.normal(size=twist.shape)
        return found_by(other, replace(still_axes, raw=raw, twist=twist), held_out=False)
    raise ValueError(kind)


KINDS = [
    "online", "ekf", "ls", "two logs, one touched", "nothing fits", "reference",
    "eight channels, three still axes",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_calibration_has_a_report_without_faults(
    kind: str, rig: Rig, log: Log, opened: Callable[..., Page], tmp_path: Path
) -> None:
    calibration, evidence = make(kind, rig, log)
    path = tmp_path / "report.html"
    write_report(path, calibration, evidence)
    shown = opened(path)
    shown.drawn()
    assert shown.errors == []
    assert shown.requests == [path.as_uri()]
    text = shown.page.inner_text("#verdict")
    if calibration.verdict.usable:
        assert "Usable" in text
    else:
        assert "Not to be used as it stands" in text
        for reason in calibration.verdict.reasons:
            assert " ".join(reason.split()) in " ".join(text.split())
    for undetermined in calibration.verdict.undetermined:
        assert undetermined.words in text
    # where there is no figure, there are words
    for section in shown.run(
        "[...document.querySelectorAll('main > section')].map(s => [s.id, s.innerText.split('\\n').length])"
    ):
        assert section[1] > 1, section
