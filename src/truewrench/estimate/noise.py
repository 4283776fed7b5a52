"""Noise as the residuals show it: its size, its colour, what that does to sigma (docs/method.md, "Noise").

The gain is decided by the noise at the frequencies of the motion. White noise has the same spectral density
there as anywhere; that of coloured noise is larger by a factor, its colour, and an estimate that takes it for
white is too sure of itself. So the colour is measured from means of the residuals over runs of samples, and
the estimate is repeated with the white noise that has the same density where it matters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.estimate.fits import ENOUGH, fitted_share, group_fits, mostly_unexplained
from truewrench.estimate.streams import parts_of
from truewrench.estimate.window_estimate import GROUPS, WindowEstimate
from truewrench.io.table import TWIST
from truewrench.log import Log
from truewrench.motion_noise import joint_noise
from truewrench.rig import Rig

__all__ = [
    "Noise",
    "estimate_with_noise",
    "hidden_delay",
    "measured_noise",
    "noise_figures",
    "noise_notes",
    "with_noise",
    "with_noise_of_walk",
]

Array = NDArray[np.float64]

SIGNIFICANT = 5.0  # standard deviations by which means over runs must exceed those of white noise,
NOTICEABLE = 1.1  # and the factor
LARGEST = 300.0  # colour that is still paid for
MARGIN = 1.5  # on what colour adds
SLIGHTLY = 1.05  # chi-square above which noise is larger than stated,
LIKELY = 2.5  # where it is that many standard deviations from 1
SILENT = 0.02  # of the assumed noise: a stream that is constant and says nothing of its noise
FITS = 1.3  # variance of the residuals over the stated one up to which it is a matter of colour
SETTLED = 1.15  # factor between two rounds that ends the search
ROUNDS = 6
TOO_SMALL = 2.0, 5.0, 15.0  # times the stated noise, tried where most windows do not fit
EXPLAINS = 0.3  # 1 sigma of the clock, of a delay that it can take up


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Per channel of the sensor and per component of the twist (n + 6).

    Attributes:
        given: 1 sigma as stated [raw, m/s, rad/s].
        estimated: 1 sigma of the residuals, corrected for what the motion took; NaN where the stream has none
            or is constant.
        colour: spectral density at the frequencies of the motion over that of white noise of this sigma.
        assumed: 1 sigma of the white noise that the estimate was made with.
        resized: whether most windows fit only with that, and not with the noise as stated.
    """

    given: Array
    estimated: Array
    colour: Array
    assumed: Array
    resized: bool = False

    @property
    def paid(self) -> bool:
        """Whether residuals may be smaller than the noise assumed: it has their density, not their size."""
        return self.coloured or bool((self.assumed > self.given).any())

    @property
    def coloured(self) -> bool:
        """Whether any channel's noise is coloured."""
        return bool((self.colour > NOTICEABLE).any())


def estimate_with_noise(
    stated: Rig,
    rig: Rig,
    found: WindowEstimate,
    estimate: Callable[[Rig, bool], WindowEstimate],
    rescale: bool,
    may_be_larger: bool = True,
) -> tuple[WindowEstimate, Noise]:
    """Estimate with the stated noise, and again with what the residuals show where that is coloured.

    Args:
        stated: with the stated noise.
        rig: with noise for an offset that walks, too.
        found: the estimate with that.
        estimate: the estimator on the logs for a rig; with True its first, quick pass is enough.
        rescale: take the size of the noise from the residuals, too.
        may_be_larger: where most windows do not fit, and do with a larger noise than stated, estimate with
            that.
    """
    given = _stated(stated)
    noise = measured_noise(rig, found.windows, given)
    if rescale:
        size = _settled_size(rig, estimate, given, noise)
        rig = with_noise(rig, size)
        found = estimate(rig, False)
        noise = measured_noise(rig, found.windows, given)
    if _all_fitted(found) and not noise.coloured and np.any(larger := _slightly_larger(rig, found.windows)):
        rig = with_noise(rig, _stated(rig) * np.sqrt(np.where(larger > 0.0, larger, 1.0)))
        found = estimate(rig, False)
        noise = measured_noise(rig, found.windows, given)
    base = _stated(rig)
    first = noise
    if fitted_share(found.windows) < ENOUGH:
        # Windows of the quick pass are solved with a gain of their own, and tell more where none fits.
        first = measured_noise(rig, estimate(rig, True).windows, given)
    if not first.coloured or np.any(np.nan_to_num(first.estimated / base, nan=1.0) ** 2.0 > FITS):
        if rescale or not may_be_larger:
            return found, noise
        return _with_larger_noise(rig, estimate, found, given) or (found, noise)
    colour = first.colour
    for _ in range(ROUNDS):
        changed = with_noise(rig, base * np.sqrt(colour))
        seen = measured_noise(changed, estimate(changed, True).windows, given).colour
        before, colour = colour, np.maximum(colour, seen)
        if np.all(colour < SETTLED * before):
            break
    changed = with_noise(rig, base * np.sqrt(colour))
    found = estimate(changed, False)
    last = measured_noise(changed, found.windows, given)
    return found, replace(last, colour=colour)


def noise_figures(rig: Rig, noise: Noise) -> dict[str, Any]:
    """1 sigma as given and as the residuals show it, and the colour, per channel and part of the twist."""
    return {
        name: {
            "given": float(given),
            "estimated": None if np.isnan(found) else float(found),
            "colour": float(colour),
        }
        for name, given, found, colour in _named(rig, noise)
    }


def hidden_delay(rig: Rig, noise: Noise, logs: Sequence[Log]) -> float:
    """Delay [s] of the low-pass filter that would colour the sensor's noise so; 0 where none is suspected.

    A first-order filter of the pole rho has the colour (1 + rho) / (1 - rho), and delays the wrench by its
    time constant -period / ln(rho). A clock that may be off by as much takes that up.
    """
    colour = 1.0 + (float(noise.colour.max()) - 1.0) / MARGIN
    if not noise.coloured or rig.sensor.lowpass_hz is not None:
        return 0.0
    period = float(np.median(np.diff(logs[0].time[np.isfinite(logs[0].raw).any(axis=1)])))
    delay = period / math.log((colour + 1.0) / (colour - 1.0))
    return delay if rig.sensor.time_offset_prior < EXPLAINS * delay else 0.0


def noise_notes(rig: Rig, noise: Noise) -> list[str]:
    """What a person should know of the noise: where the stated one disagrees, and what colour cost."""
    notes = []
    off = [
        f"{name} {found:.3g} and not {given:.3g}"
        for name, given, found, _ in _named(rig, noise)
        if np.isfinite(found) and not 0.8 < found / given < 1.25
    ]
    if off:
        listed = ", ".join(off)
        notes.append(f"the residuals show another noise than the rig states: {listed}")
    if noise.coloured:
        most = float(noise.colour.max())
        notes.append(
            "the sensor's noise is coloured (a low-pass filter, or drift): at the motion's frequencies it "
            f"has {most:.1f} times the density of white noise of its size, which sigma contains"
        )
    return notes


def _named(rig: Rig, noise: Noise) -> list[tuple[str, float, float, float]]:
    """Name, given, estimated and colour of every channel and component of the twist; joints in one."""
    n = rig.sensor.n
    rows = np.column_stack([noise.given, noise.estimated, noise.colour])
    names = (*rig.sensor.channels, *TWIST)
    if rig.motion.source == "joints":
        joints = [noise.given[n], np.sqrt(np.mean(noise.estimated[n:] ** 2)), noise.colour[n:].max()]
        rows, names = np.vstack([rows[:n], joints]), (*rig.sensor.channels, "joints")
    return [(name, *row) for name, row in zip(names, rows.tolist(), strict=True)]


def _slightly_larger(rig: Rig, windows: Sequence[_core.WindowReport]) -> Array:
    """Per channel and component, chi-square per freedom of its stream where that is a little above 1.

    Ripple that the knots follow only in part looks so, or noise stated a few percent too small: that is paid.
    """
    n = rig.sensor.n
    force, moment = (range(3), range(3, 6)) if n == 6 else (range(n), range(0))
    members = dict(zip(GROUPS, (force, moment, range(n, n + 3), range(n + 3, n + 6)), strict=True))
    larger = np.zeros(n + 6)
    for name, fit in group_fits(windows).items():
        if SLIGHTLY < fit.chi_square < FITS and fit.deviate > LIKELY:
            larger[list(members[name])] = fit.chi_square
    return larger


def _settled_size(
    rig: Rig, estimate: Callable[[Rig, bool], WindowEstimate], given: Array, noise: Noise
) -> Array:
    """1 sigma that the residuals of an estimate made with it confirm."""
    size = given
    for _ in range(ROUNDS):
        before, size = size, np.where(np.isfinite(noise.estimated), noise.estimated, given)
        if np.all(np.maximum(size, before) < SETTLED**0.5 * np.minimum(size, before)):
            break
        changed = with_noise(rig, size)
        noise = measured_noise(changed, estimate(changed, True).windows, given)
    return size


def _with_larger_noise(
    rig: Rig, estimate: Callable[[Rig, bool], WindowEstimate], found: WindowEstimate, given: Array
) -> tuple[WindowEstimate, Noise] | None:
    """Where most windows do not fit: the estimate with a noise that residuals confirm, if they then do."""
    if not mostly_unexplained(found.windows):
        return None
    for factor in TOO_SMALL:
        changed = with_noise(rig, factor * given)
        windows = estimate(changed, True).windows
        if mostly_unexplained(windows):
            continue
        size = _settled_size(rig, estimate, given, measured_noise(changed, windows, given))
        changed = with_noise(rig, np.maximum(given, size))
        again = estimate(changed, False)
        if not mostly_unexplained(again.windows):
            return again, replace(measured_noise(changed, again.windows, given), resized=True)
    return None


def measured_noise(rig: Rig, windows: Sequence[_core.WindowReport], given: Array | None = None) -> Noise:
    """Size and colour of the noise from the residuals of windows that were made with the noise of a rig."""
    assumed = _stated(rig)
    n = rig.sensor.n
    given = assumed if given is None else given
    squares, freedom, count = np.zeros(n + 6), np.zeros(n + 6), np.zeros(n + 6)
    run_squares, runs = np.zeros((n + 6, 6)), np.zeros((n + 6, 6))
    most_fit = fitted_share(windows) >= ENOUGH  # and then the others show what disturbed them, not noise
    for window in windows:
        if most_fit and window.status != _core.WindowStatus.fitted:
            continue
        for i, component in enumerate(window.components):
            squares[i] += component.all.sum_of_squares
            count[i] += component.all.count
            freedom[i] += component.all.count - component.all.leverage
            run_squares[i] += component.run_squares
            runs[i] += component.runs
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = squares / count
        heard = (freedom > 1.0) & (squares > SILENT**2.0 * freedom)
        estimated = assumed * np.sqrt(np.where(heard, squares / freedom, np.nan))
    colour = np.ones(n + 6)
    for channels in (range(3), range(3, 6)) if n == 6 else (range(n),):
        group = [i for i in channels if heard[i]]
        if not group:
            continue
        total = runs[group].sum(axis=0)
        used = (runs[group] > 0.0).all(axis=0) & (variance[group] > 0.0).all()
        if not used.any():
            continue
        ratio = np.full(6, np.nan)
        normalised = run_squares[group][:, used] / variance[group][:, None]
        ratio[used] = normalised.sum(axis=0) / total[used]
        colour[group] = _colour(ratio, total)
    return Noise(given, estimated, colour, assumed)


def _colour(ratio: Array, runs: Array) -> float:
    """From mean squares of run sums over their length, relative to one sample's: 1 where the noise is white.

    A share of the variance with correlation rho^k, the rest white: the least squares fit over all lengths.
    What the motion absorbs makes long runs small, so the fit can only be too low: it rises as the assumed
    noise does, and what remains is covered by a margin.
    """
    lengths = 2.0 ** np.arange(1, ratio.size + 1)
    known = np.isfinite(ratio)
    excess = (ratio - 1.0) / np.sqrt(2.0 / np.maximum(runs, 1.0))
    seen = known & (excess > SIGNIFICANT) & (ratio > NOTICEABLE)
    if not seen.any():
        return 1.0
    last = int(np.flatnonzero(seen)[np.argmax(ratio[seen])])  # beyond the largest the motion absorbs
    lengths, ratio, runs = lengths[: last + 1], ratio[: last + 1], runs[: last + 1]
    best, colour = np.inf, 1.0
    for rho in 1.0 - np.geomspace(0.8, 0.005, 60):
        shape = np.array([2.0 * sum((1.0 - k / m) * rho**k for k in range(1, int(m))) for m in lengths])
        weight = runs / ratio**2.0
        share = float(np.clip((weight * shape) @ (ratio - 1.0) / ((weight * shape) @ shape), 0.0, 1.0))
        misfit = float(weight @ (ratio - 1.0 - share * shape) ** 2.0)
        if misfit < best:
            best, colour = misfit, 1.0 + MARGIN * 2.0 * share * rho / (1.0 - rho)
    return min(colour, LARGEST)


def _all_fitted(estimate: WindowEstimate) -> bool:
    return bool(estimate.windows) and all(
        w.status in (_core.WindowStatus.fitted, _core.WindowStatus.too_short) for w in estimate.windows
    )


def with_noise_of_walk(rig: Rig, logs: Sequence[Log]) -> Rig:
    """The rig with larger noise for what an offset walks within the parts of logs (M15b)."""
    walk, stated = rig.sensor.offset_walk_array, _stated(rig)
    n, larger = rig.sensor.n, np.ones(stated.size)
    if not walk.any():
        return rig
    for part in parts_of(rig, logs):
        period = float(np.median(np.diff(logs[part.log].time)))
        within = (walk * part.duration) ** 2.0 / (10.0 * stated[:n] ** 2.0 * period)
        larger[:n] = np.maximum(larger[:n], 1.0 + within)
    return with_noise(rig, stated * np.sqrt(larger))


def _stated(rig: Rig) -> Array:
    """(n + 6) 1 sigma of the channels and of the motion: of the twist, or of joints their RMS six times."""
    motion = rig.motion.noise_array if rig.motion.source == "twist" else np.full(6, joint_noise(rig))
    return np.concatenate([rig.sensor.noise_array, motion])


def with_noise(rig: Rig, noise: Array) -> Rig:
    """The rig with other noise (n + 6)."""
    n, motion = rig.sensor.n, rig.motion
    changed: dict[str, Any] = {"noise": tuple(noise[n:].tolist())}
    if motion.source == "joints":  # whose residuals, as twists, tell of all joints together
        factor = float(np.sqrt(np.mean(noise[n:] ** 2))) / joint_noise(rig)
        changed = {
            key: None if values is None else tuple(factor * value for value in values)
            for key, values in (("noise", motion.noise), ("position_noise", motion.position_noise))
        }
    return rig.model_copy(
        update={
            "sensor": rig.sensor.model_copy(update={"noise": tuple(noise[:n].tolist())}),
            "motion": motion.model_copy(update=changed),
        }
    )
