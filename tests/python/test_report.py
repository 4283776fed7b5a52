"""Reports in a real browser: what they show first, that they ask for nothing, run nothing of others, fit."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from truewrench.calibrating.pipeline import calibrate
from truewrench.estimation.assembly import assemble, assemble_motion, motion_figures
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.estimator import estimate
from truewrench.estimation.evidence import Evidence
from truewrench.estimation.known_wrench import estimate_from_known_wrench
from truewrench.judging.validation.comparison import compare_in_sample
from truewrench.model.calibration import AXES, Assumed, BlindTo, Calibration, LogReport, Verdict
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.split import rows_of
from truewrench.report.page import write_report
from truewrench.simulation.free_body import simulate

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>$$x$$\u2028"
EXACT = {"mass": 0, "center_of_mass": 0, "inertia": 0}
DESKTOP, PHONE = (1280, 800), (360, 740)
LARGEST = 4_000_000  # bytes

UNSEEN = BlindTo("cable", 1e-3, 2e-3, "a force of 0.1% of range that follows the pose")

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
        "simulate": {"rate": rate, "sensor_rate": rate, "gain": (1.05 * rows).tolist()},
    }


def found_by(rig: Rig, logs: Log | list[Log], usable: bool = True) -> Found:
    """By motion, unjudged."""
    records = [logs] if isinstance(logs, Log) else logs
    found = estimate(rig, records)
    verdict = Verdict(usable, () if usable else ("drift: something creeps",), blind_to=(UNSEEN,))
    calibration = assemble_motion(rig, records, "map", found, verdict, figures=motion_figures(rig, found))
    compared = compare_in_sample(rig, records, found, calibration.inverse, "not asked for")
    figures = {**calibration.figures, "held_out": compared.figures}
    calibration = replace(calibration, improvement=compared.improvement, figures=figures)
    return calibration, Evidence(tuple(records), found)


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


def weights(rig: Rig) -> Found:
    """By rows of dead weights, one of them noted wrong."""
    draw = np.random.default_rng(3)
    wrench = 0.5 * rig.sensor.range_array * draw.uniform(-1.0, 1.0, (40, 6))
    noise = rig.sensor.noise_array
    raw = wrench @ rig.sensor.nominal_gain_array.T * 1.1 + noise * draw.normal(size=(40, rig.sensor.n))
    wrench = wrench + np.array([0.1] * 3 + [0.01] * 3) * draw.normal(size=(40, 6))
    wrench[7] += 100.0
    log = Log(None, "default", "", 10**10 * np.arange(40), raw, reference=wrench)
    found = estimate_from_known_wrench(rig, [log])
    reports = [LogReport(None, "", "default", found.offsets[0], found.offsets_std[0], used=39)]
    verdict = Verdict(False, ("too few weights",))
    return (
        assemble(rig, "reference", found.gain, found.covariance, verdict, reports),
        Evidence((log,), found),
    )


def touched(log: Log) -> Log:
    raw = log.raw.copy()
    raw[500:530] += 40.0
    return replace(log, raw=raw)


def make(kind: str, rig: Rig, log: Log, found: Found) -> Found:
    """One calibration of every estimator and kind of input."""
    calibration, evidence = found
    fit = evidence.estimate
    assert isinstance(fit, Estimate)
    if kind in ("ekf", "ls"):
        seen: list[Evidence] = []
        return calibrate(rig, log, kind, evidence=seen.append), seen[0]  # type: ignore[arg-type]
    if kind == "online":
        late = np.linspace(2.0, 9.0, 8)
        gains = fit.gain * (1.0 + 0.1 / late[:, None, None])
        history: dict[str, Any] = {
            "history_time": late,
            "history_log": np.zeros(8, np.int64),
            "history_gain": gains,
        }
        return replace(calibration, estimator="online"), replace(evidence, estimate=replace(fit, **history))
    if kind == "two logs, one touched":
        calibration, evidence = found_by(rig, [touched(log), simulate(rig, seed=2).log], usable=False)
        axes = {axis: axis != "mz" for axis in AXES}
        assumed = (Assumed("step of the offset, fraction of range", "log 1", 0.01, 1e-4, "residuals"),)
        return replace(calibration, axes=axes, assumed=assumed), evidence
    if kind == "too short":
        return found_by(rig, rows_of(log, log.time < 0.05), usable=False)
    if kind == "reference":
        settings = deepcopy(settings_of())
        settings["reference_noise"] = [0.1] * 3 + [0.01] * 3
        return weights(Rig.from_mapping(settings))
    if kind == "hysteresis, gravity and a gap":
        settings = settings_of(duration=12.0)
        settings["gravity"] = [0, 0, -9.81]
        settings["simulate"]["imperfections"] = {"hysteresis": {"size": 5e-3, "form": "dahl"}}
        other = Rig.from_mapping(settings)
        whole = simulate(other, seed=3).log
        return found_by(other, rows_of(whole, (whole.time < 5.0) | (whole.time > 7.0)))
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
        return found_by(other, replace(still_axes, raw=raw, twist=twist))
    raise ValueError(kind)


KINDS = [
    "online", "ekf", "ls", "two logs, one touched", "too short", "reference", "hysteresis, gravity and a gap",
    "eight channels, three still axes",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_calibration_has_a_report_without_faults(
    kind: str, rig: Rig, log: Log, found: Found, opened: Callable[..., Page], tmp_path: Path
) -> None:
    calibration, evidence = make(kind, rig, log, found)
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
    for blind in calibration.verdict.blind_to:
        assert blind.words in text
    for assumed in calibration.assumed:
        assert assumed.what in shown.page.inner_text("#found")
    if kind == "two logs, one touched":
        assert "Axes that may not be used: mz." in text
        assert "left out" in shown.page.inner_text("#left-out")
    # where there is no figure, there are words
    for section in shown.run(
        "[...document.querySelectorAll('main > section')].map(s => [s.id, s.innerText.split('\\n').length])"
    ):
        assert section[1] > 1, section


@pytest.mark.parametrize(
    ("size", "options"), [(DESKTOP, {}), (PHONE, {"is_mobile": True, "has_touch": True})]
)
def test_verdict_stands_in_the_first_viewport(
    size: tuple[int, int], options: dict[str, Any], report: Path, opened: Callable[..., Page]
) -> None:
    shown = opened(report, size, **options)
    shown.drawn()
    assert shown.errors == []
    box = shown.page.locator("#verdict h2").bounding_box()
    assert box["y"] >= 0
    assert box["y"] + box["height"] <= size[1]
    said = shown.page.locator("#verdict p").first.bounding_box()
    assert said["y"] + said["height"] <= size[1]
    wide = shown.run("[document.documentElement.scrollWidth, innerWidth]")
    assert wide[0] <= wide[1], "the page scrolls sideways"


def test_figures_show_what_was_calibrated_and_zoom_together(
    report: Path, opened: Callable[..., Page]
) -> None:
    shown = opened(report)
    shown.drawn()
    names = shown.run("[...document.querySelectorAll('.plot')].map(p => p.getAttribute('aria-label'))")
    assert [name.split()[2] for name in names if name.startswith("Residual of")] == list(AXES)
    assert [name.split()[3] for name in names if name.startswith("Measured and expected")] == list(AXES)
    ranges = "Bokeh.documents.flatMap(d => d.roots()).map(f => f.x_range).filter(r => r && r.name == 'time')"
    assert shown.run(f"{ranges}.length") == 15  # 6 of wrenches, 6 of residuals, 2 of their squares, the gain
    shown.page.locator("button[data-zoom=in]").press("Enter")
    seen = shown.run(f"{ranges}.map(r => [r.start, r.end])")
    assert all(np.allclose(pair, seen[0]) for pair in seen)
    assert seen[0][1] - seen[0][0] == pytest.approx(0.5 * 9.99, rel=1e-3)
    shown.page.locator("button[data-zoom=all]").click()
    assert shown.run(f"{ranges}.map(r => r.start)")[0] == pytest.approx(0.0)


def contrast(first: str, second: str) -> float:
    """Of two colours as browsers tell them, by WCAG 2."""

    def luminance(colour: str) -> float:
        rgb = np.array([float(c) for c in colour[colour.index("(") + 1 : -1].split(",")[:3]]) / 255.0
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    light, dark = sorted([luminance(first), luminance(second)], reverse=True)
    return (light + 0.05) / (dark + 0.05)


TEXTS = """[...document.querySelectorAll('main *')].filter(e => e.checkVisibility()
    && [...e.childNodes].some(n => n.nodeType == 3 && n.textContent.trim())).map(e => {
  let behind = e;
  while (getComputedStyle(behind).backgroundColor == 'rgba(0, 0, 0, 0)') behind = behind.parentElement;
  return [e.tagName + '.' + e.className, getComputedStyle(e).color, getComputedStyle(behind).backgroundColor];
})"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_what_is_behind_it(
    scheme: str, report: Path, opened: Callable[..., Page]
) -> None:
    shown = opened(report, color_scheme=scheme)
    texts = shown.run(TEXTS)
    assert len(texts) > 200
    poor = {(name, a, b) for name, a, b in texts if contrast(a, b) < 4.5}
    assert not poor
    page = texts[0][2]
    assert contrast(page, "rgb(0, 0, 0)" if scheme == "dark" else "rgb(255, 255, 255)") < 1.3
    shown.drawn()
    on_canvas = shown.run(
        "getComputedStyle(document.querySelector('.plot')).getPropertyValue('--bk-axis-label-text-color')"
    )
    rgb = shown.run(
        f"(e => {{ e.style.color = '{on_canvas.strip()}'; return getComputedStyle(e).color }})(document.body)"
    )
    assert contrast(rgb, page) >= 4.5


def test_structure_can_be_heard_and_reached_by_keys(report: Path, opened: Callable[..., Page]) -> None:
    shown = opened(report)
    shown.drawn()
    assert shown.run("document.documentElement.lang") == "en"
    assert shown.page.title().startswith("Usable")
    levels = shown.run("[...document.querySelectorAll('h1,h2,h3,h4,h5,h6')].map(h => +h.tagName[1])")
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert shown.run("[...document.querySelectorAll('th')].every(h => ['col', 'row'].includes(h.scope))")
    assert shown.run("[...document.querySelectorAll('table')].every(t => t.caption.textContent.trim())")
    assert shown.run("[...document.querySelectorAll('img')].every(i => i.alt)")
    assert shown.run("[...document.querySelectorAll('.plot')].every(p => p.role == 'img' && p.ariaLabel)")
    assert shown.run("[...document.querySelectorAll('figcaption')].every(c => c.innerText.length > 20)")
    # what scrolls can be focused, what is a region has a name, what is a link has a target
    assert shown.run("[...document.querySelectorAll('.scroll')].every(s => s.tabIndex == 0 && s.ariaLabel)")
    assert shown.run(
        "[...document.querySelectorAll('section')].every("
        "s => document.getElementById(s.getAttribute('aria-labelledby')))"
    )
    assert shown.run("[...document.querySelectorAll('nav a')].every(a => document.querySelector(a.hash))")
    identifiers = shown.run("[...document.querySelectorAll('[id]')].map(e => e.id)")
    assert len(identifiers) == len(set(identifiers))


def test_names_from_files_are_shown_and_do_nothing(
    log: Log, opened: Callable[..., Page], tmp_path: Path
) -> None:
    settings = settings_of(channels=[f"{HOSTILE}{i}" for i in range(6)])
    settings["payloads"] = {HOSTILE: settings["payloads"]["default"]}
    hostile = replace(
        touched(log), payload=HOSTILE, path=Path(HOSTILE.replace("/", "\\") + ".csv"), nan_counts={HOSTILE: 1}
    )
    calibration, evidence = found_by(Rig.from_mapping(settings), hostile)
    verdict = Verdict(False, (HOSTILE,), blind_to=(replace(UNSEEN, words=HOSTILE),))
    assumed = (Assumed(HOSTILE, HOSTILE, 1.0, None, HOSTILE),)
    calibration = replace(calibration, verdict=verdict, assumed=assumed)
    path = tmp_path / "report.html"
    write_report(path, replace(calibration, created=HOSTILE), evidence)
    shown = opened(path)
    shown.drawn()
    assert shown.dialogs == []
    assert shown.errors == []
    assert shown.requests == [path.as_uri()]
    assert shown.run("document.querySelectorAll('main img, main script').length") == 0
    assert shown.run("document.scripts.length") == 3
    assert HOSTILE[:20] in shown.page.inner_text("#verdict")
    assert HOSTILE[:20] in shown.page.inner_text("#gain")


def test_policy_lets_no_script_of_others_run_and_nothing_out(
    report: Path, opened: Callable[..., Page]
) -> None:
    shown = opened(report)
    policy = shown.run("document.querySelector('meta[http-equiv=Content-Security-Policy]').content")
    assert "default-src 'none'" in policy
    scripts = next(part for part in policy.split(";") if part.strip().startswith("script-src"))
    assert "unsafe" not in scripts
    shown.run(
        "document.body.insertAdjacentHTML('beforeend', '<img src=https://example.org/x onerror=alert(1)>')"
    )
    shown.run("fetch('https://example.org/').catch(() => 0)")
    shown.page.wait_for_timeout(100)
    assert shown.dialogs == []
    assert any("Content Security Policy" in said for said in shown.errors)


def test_a_minute_at_a_kilohertz_stays_below_4_mb(found: Found, tmp_path: Path) -> None:
    calibration, evidence = found
    log, fit = evidence.logs[0], evidence.estimate
    assert isinstance(fit, Estimate)
    times = 60  # of 10 s at 100 Hz, its samples repeated at 1 kHz for a minute
    long = replace(
        log,
        time_ns=10**6 * np.arange(times * len(log.time_ns)),
        raw=np.tile(log.raw, (times, 1)),
        twist=np.tile(log.twist, (times, 1)),  # type: ignore[arg-type]
    )
    rows = fit.rows[0]
    many = replace(
        rows,
        rows=np.arange(60_000),
        time=long.time,
        masked=np.tile(rows.masked, times),
        residual=np.tile(rows.residual, (times, 1)),
        discrepancy=np.tile(rows.residual, (times, 1)),
        wrench=np.tile(rows.wrench, (times, 1)),
        stretch=np.tile(rows.stretch, times),
    )
    path = tmp_path / "report.html"
    write_report(path, calibration, Evidence((long,), replace(fit, rows=(many,))))
    assert len(long.time_ns) == 60_000
    assert path.stat().st_size < LARGEST
