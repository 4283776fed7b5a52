"""What an estimate found beside the gain, and what it assumed beside the rig as stated: two tables."""

from collections.abc import Iterator

import numpy as np

from truewrench import _core
from truewrench.estimation.estimate import Clock, Estimate, Slow
from truewrench.estimation.joint import EXACT
from truewrench.model.calibration import Calibration
from truewrench.report.summary import with_uncertainty
from truewrench.report.tables import Cell, Row, Table

_LATENESS = {0.0: "a filter of the sensor", 0.5: "a clock", 1.0: "a filter of the velocities"}
_SURE = 3.0  # sigma
_HELD = 2.0 * EXACT  # 1 sigma [s, rad]: of a clock, or gravity, that is held where the rig states it


def assumed_table(c: Calibration) -> Table | None:
    """Every alternative beside the rig, with its size and what spoke for it; None where there is none."""
    rows = []
    for a in c.assumed:
        value = f"{a.value:.4g}" if a.sigma is None else with_uncertainty(a.value, a.sigma)
        rows.append(Row(a.what, (_text(a.where), Cell(value), _text(a.evidence or "-"))))
    caption = "Assumed beside the rig as stated, ± 1 sigma"
    return Table(caption, ("what", "where", "size", "evidence"), tuple(rows)) if rows else None


def found_table(c: Calibration, estimate: Estimate) -> Table:
    """Sizes that the record itself gave, beside those that the rig states."""
    rows = [row for k in range(len(c.logs)) for row in _of_log(c, estimate, k)]
    u, sigma = estimate.quadratic, estimate.quadratic_std
    worst = int(np.argmax(np.abs(u) / np.maximum(sigma, 1e-30)))
    size = f"{with_uncertainty(100 * u[worst], 100 * sigma[worst])} % of range"
    means = "the gain is the tangent at no load" if abs(u[worst]) > _SURE * sigma[worst] else ""
    log = f"all, {c.rig.sensor.channels[worst]}"
    rows.append(_row("quadratic term, where it is clearest", log, size, "0", means))
    stated = f"0 ± {np.degrees(c.rig.gravity_tilt_prior):.2g}°"
    for tilt in estimate.tilts:
        every = len(estimate.tilts) == 1
        where = "all" if every else f"log {', '.join(str(k + 1) for k in tilt.logs)}"
        for about, angle, std in zip("12", np.degrees(tilt.angles), np.degrees(tilt.std), strict=True):
            held = std < np.degrees(_HELD)
            found = "as stated" if held else f"{with_uncertainty(float(angle), float(std))}°"
            rows.append(_row(f"gravity turned about axis {about}", where, found, stated, ""))
    caption = "Found by the estimate, ± 1 sigma, beside what the rig states"
    return Table(caption, ("what", "log", "found", "stated", "which means"), tuple(rows))


def _of_log(c: Calibration, estimate: Estimate, k: int) -> Iterator[Row]:
    log = f"log {k + 1}"
    if np.isfinite(estimate.spacing[k]):
        unresolved = bool(estimate.unresolved[k])
        means = "✘ the motion is not resolved" if unresolved else "the coarsest that resolves the motion"
        spacing = f"{1e3 * estimate.spacing[k]:.4g} ms"
        yield _row("knots of the motion, spacing", log, spacing, "-", means, off=unresolved)
    for noise in estimate.noise[k]:
        off = not 1.0 / _core.NOISE_TOLD <= noise.factor <= _core.NOISE_TOLD
        means = f"{'larger' if noise.factor > 1.0 else 'smaller'} than stated" if off else ""
        yield _row(f"noise, {noise.what}", log, f"{noise.factor:.3g} × stated", "1", means, off=off)
    for clock in estimate.clocks[k]:
        late = f"{with_uncertainty(1e3 * clock.as_logged, 1e3 * clock.std)} ms"
        if clock.std < _HELD and clock.undone == clock.set_back == 0.0:
            late = "as stated"
        stated = f"± {1e3 * clock.stated:.3g} ms"
        yield _row(f"sensor late against {clock.stream}", log, late, stated, _lateness(clock))
    for slow in estimate.slow[k]:
        yield _row(f"slow disturbance, {slow.what}", log, _size(slow), "-", _slow(slow), off=slow.capped)
    for step in estimate.steps[k]:
        at = int(np.argmax(np.abs(step.size)))
        size = f"{with_uncertainty(100 * step.size[at], 100 * step.std[at])} % of range"
        means = f"of {c.rig.sensor.channels[at]}, where it is largest; in the fit"
        yield _row(f"step of the offset at {step.time:.4g} s", log, size, "-", means)


def _lateness(clock: Clock) -> str:
    if clock.undone != 0.0:
        return f"{1e3 * clock.undone:.3g} ms of it of a filter, undone"
    if clock.set_back != 0.0:
        return f"{1e3 * clock.set_back:.4g} ms of it undone before the estimate"
    if clock.kappa is None or clock.kappa_std is None:
        return "of what kind the data do not tell" if abs(clock.late) > _SURE * clock.std else ""
    kappa = clock.kappa
    nearest = min(_LATENESS, key=lambda value: abs(value - kappa))
    return f"most like {_LATENESS[nearest]} (kappa {with_uncertainty(kappa, clock.kappa_std)})"


def _size(slow: Slow) -> str:
    size, std = 100 * slow.size, slow.size_std
    value = f"{size:.2g}" if std is None else with_uncertainty(size, 100 * std)
    return f"{value} % of range over {slow.tau:.2g} s"


def _slow(slow: Slow) -> str:
    if slow.form == "none":
        return "too small to be in the fit; what it may do to the gains is in their sigma"
    kind = "a random walk" if slow.form == "walk" else "what comes and goes"
    return f"in the fit as {kind}" + (", ✘ as large as it may be" if slow.capped else "")


def _row(what: str, log: str, found: str, stated: str, means: str, *, off: bool = False) -> Row:
    shade = "bad text" if off else "text"
    return Row(what, (_text(log), Cell(found), Cell(stated), Cell(means, shade=shade)))


def _text(words: str) -> Cell:
    return Cell(words, shade="text")
