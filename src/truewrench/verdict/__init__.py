"""Whether a calibration may be used, and why not when it may not (docs/method.md, "The verdict")."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from truewrench import _core
from truewrench.calibration import AXES, UNDETERMINED, Undetermined, Verdict
from truewrench.estimate.attempts import LEFT_OUT
from truewrench.estimate.clock import clock_overclaimed
from truewrench.estimate.fits import group_fits
from truewrench.estimate.moving_offset import Wandering
from truewrench.estimate.noise import Noise, with_noise
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.log import Log
from truewrench.rig import Rig
from truewrench.verdict.advice import advice
from truewrench.verdict.setup_errors import (
    Suspicion,
    parameters_off_their_priors,
    setup_errors_in_estimate,
    setup_errors_in_logs,
)
from truewrench.verdict.silence import channel_faults

__all__ = [
    "gain_reasons",
    "judge_reference",
    "judge_windows",
    "undetermined_directions",
]

Array = NDArray[np.float64]

REJECTED = 0.05  # share of the samples in rejected windows that is still accepted
CHI_SQUARE = 1.05  # residual chi-square per degree of freedom that is still accepted,
CHI_SQUARE_LOW = 0.5  # below it the stated noise is too large to say anything
DEVIATE = 4.0  # unless chance alone explains it: standard normal deviate
DEPENDENCE = _core.EstimatorSettings().dependence_sigma  # of the gain against other knots and windows
SINGULAR = 1e12  # condition number that only rounding keeps from infinity
TIED = 0.15  # share of an axis, in units of range, that another one has to make up to be named with it
CONDITION = 100.0  # condition number of the normalised gain: noise of one axis that another would inherit

PAYLOAD_PARAMETERS = (
    "the mass",
    *(f"the centre of mass along {axis}" for axis in "xyz"),
    *(f"the inertia {element}" for element in ("xx", "yy", "zz", "xy", "xz", "yz")),
)
"""What the ten departures of a payload are."""

_WRENCH = tuple(f"{kind} {axis}" for kind in ("force along", "moment about") for axis in "xyz")
_CAUSES = {
    "too_short": "fewer samples than a motion needs",
    "motion_undetermined": "the samples do not determine the motion",
    "not_converged": "the iteration did not converge",
    "misfit": "residuals above the stated noise at every admissible knot spacing: motion faster than the "
    "samples resolve (vibration, servo ripple), contact, or noise stated too small",
    "unresolved": "finer knots would still fit better, but the samples do not resolve them",
}


def judge_windows(
    rig: Rig,
    estimate: WindowEstimate,
    logs: Sequence[Log] = (),
    noise: Noise | None = None,
    hidden_delay: float = 0.0,
    moving: Wandering | None = None,
) -> Verdict:
    """The verdict on what `map` or `online` found; with the logs, also on how the rig was set up.

    Args:
        rig: sensor, payloads, motion and `required`.
        estimate: on these logs.
        logs: may be left out.
        noise: that was found in the residuals.
        hidden_delay: of a low-pass filter that the colour of the sensor's noise suggests [s]; 0 for none.
        moving: what an offset had to do to explain the logs.
    """
    faults = channel_faults(rig, logs)
    silent = {fault.channel for fault in faults if fault.silent}
    reasons = [fault.words for fault in faults]
    reasons += [*_of_windows(estimate), *_of_disturbances(estimate, logs)]
    if not silent:  # whose gains look like any mistake
        reasons += _setup_errors(rig, logs, estimate)
    if not estimate.solved:
        reasons.append("the sums over the windows could not be solved")
    elif not estimate.converged:
        reasons.append("the estimate did not converge")
    if moving is not None:
        walk = ", ".join(f"{q:.3g}" for q in moving.rig.sensor.offset_walk_array)
        reasons.append(
            "the logs fit only with an offset that wanders, which this result rests on: state "
            f"`offset_walk: [{walk}]` if the offset does; a time offset, payload or motion that is not as "
            "the rig says looks alike"
        )
    if noise is not None and noise.resized:
        reasons.append(
            "residuals do not match the stated noise: noise stated too small, or payload, clock or motion "
            "not as the rig says; most windows fit only with noise up to "
            f"{np.max(noise.assumed / noise.given):.3g} times as large, which this result rests on; state "
            "the noise as it is, or let it be taken from the residuals (--rescale-noise)"
        )
    for name, fit in group_fits(estimate.windows).items():
        above = fit.chi_square > CHI_SQUARE and fit.deviate > DEVIATE
        below = fit.chi_square < CHI_SQUARE_LOW and fit.deviate < -DEVIATE
        paid = noise is not None and noise.paid
        if above or (below and not paid):
            reasons.append(
                f"residuals of {name} do not match the stated noise: chi-square {fit.chi_square:.3g} "
                f"per degree of freedom ({fit.deviate:.1f} sigma from 1); state the noise as it is, or let "
                "it be taken from the residuals (--rescale-noise)"
            )
    if hidden_delay > 0.0:
        reasons.append(
            "the sensor's noise is coloured as behind a low-pass filter, which would also delay the wrench "
            f"by about {1e3 * hidden_delay:.2g} ms, and the rig states a better clock: state `lowpass_hz`, "
            "or a `time_offset_prior` of that size"
        )
    if estimate.knot_dependence > DEPENDENCE:
        reasons.append(
            f"the gain depends on the knot spacing ({estimate.knot_dependence:.1f} sigma): "
            "the motion is not resolved"
        )
    if estimate.window_dependence > DEPENDENCE:
        reasons.append(
            f"the gain depends on the length of the windows ({estimate.window_dependence:.1f} sigma): "
            "too few samples for this motion"
        )
    as_found = rig if noise is None else with_noise(rig, noise.assumed)
    reasons += clock_overclaimed(as_found, logs, estimate)
    found, undetermined = gain_reasons(
        rig,
        estimate.gain,
        estimate.normalised_covariance,
        advice(rig, estimate, logs[-1].payload if logs else None, silent),
        silent,
    )
    reasons += found
    if undetermined and estimate.clock_untold:
        reasons.append(
            "in this motion a change of time looks like a change of the gain, and the time offset is known "
            f"only to {1e3 * estimate.time_offsets_std[-1]:.2g} ms: sensor and motion synchronised better (a "
            "smaller `time_offset_prior`), or a motion of more frequencies, would help"
        )
    return Verdict(not reasons, tuple(reasons), undetermined)


def gain_reasons(
    rig: Rig,
    gain: Array,
    normalised_covariance: Array,
    remedy: str,
    silent: Collection[int] = (),
) -> tuple[list[str], tuple[Undetermined, ...]]:
    """Why a gain cannot be used: singular, not determined, not accurate enough; and what is not determined.

    Args:
        rig: sensor, `required`.
        gain: (n, 6), SI.
        normalised_covariance: (6n, 6n) of it, or more rows (offsets behind it).
        remedy: what would make it more accurate.
        silent: channels without a signal, whose gains need no further reason.
    """
    n = rig.sensor.n
    heard = [i for i in range(n) if i not in silent]
    reasons = [] if silent else _of_gain(rig, gain)
    covariance = normalised_covariance[: 6 * n, : 6 * n]
    undetermined = undetermined_directions(covariance, rig.sensor.gain_prior, rig.sensor.channels)
    unexplained, explained = [], []
    for u in undetermined:
        size = np.abs(u.direction.reshape(n, 6)).max(axis=1)
        if size[heard].max(initial=0.0) > 0.1:
            unexplained.append(u)
        else:
            name = rig.sensor.channels[int(np.argmax(size))]
            explained.append(replace(u, words=f"gains of {name}, which has no signal"))
    undetermined = (*unexplained, *explained)
    if unexplained:
        words = Counter(u.words for u in unexplained)
        named = "; ".join(word if count == 1 else f"{word} ({count})" for word, count in words.items())
        reasons.append(f"{len(unexplained)} of {6 * n} directions of the gain are not determined: {named}")
    std = np.sqrt(np.diag(covariance)).reshape(n, 6)
    std[list(silent)] = 0.0
    if std.max() > rig.required and len(undetermined) < 6 * n:
        i, j = np.unravel_index(np.argmax(std), std.shape)
        reasons.append(
            f"accuracy: the gain of {rig.sensor.channels[i]} on {AXES[j]} has a sigma of "
            f"{std[i, j]:.3g} of range, more than the required {rig.required:.3g}; {remedy}"
        )
    return reasons, undetermined


def judge_reference(rig: Rig, gain: Array, findings: Sequence[str] = ()) -> Verdict:
    """The verdict on `ekf` and `ls`: never usable; they are there to be compared with."""
    return Verdict(False, ("reference estimator", *findings, *_of_gain(rig, gain)))


def undetermined_directions(
    covariance: Array, prior: float, channels: Sequence[str]
) -> tuple[Undetermined, ...]:
    """Directions of the normalised gain that are still less certain than half their prior.

    Args:
        covariance: (6n, 6n) of the normalised gain, row by row.
        prior: 1 sigma of every element beforehand.
        channels: n names.

    Returns:
        An orthonormal basis, as near to single gains as it can be. Where a direction of the wrench was not
        excited, no channel's gain to it is known: its n directions are named together. Such a direction is
        an axis, or an axis tied to others: its component was the same combination of theirs in all data.
    """
    n = len(channels)
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    basis = vectors[:, values > (UNDETERMINED * prior) ** 2]  # (6n, k)
    found: list[Undetermined] = []
    if basis.shape[1] >= n:
        # How much of u, in every channel, lies in the undetermined space.
        share = np.einsum("iak,ibk->ab", basis.reshape(n, 6, -1), basis.reshape(n, 6, -1)) / n
        weights, axes = np.linalg.eigh(share)
        unseen, pivots = _near_axes(axes[:, weights > 0.95])
        tied = unseen @ np.linalg.inv(unseen[pivots])  # each pivot as a combination of the other axes
        for u, relation, pivot in zip(unseen.T, tied.T, pivots, strict=True):
            words = f"{_wrench_words(relation, pivot)}: gains of all channels"
            whole = [np.kron(e, u) for e in np.eye(n)]
            found += [Undetermined(direction, words) for direction in whole]
            basis = basis - np.column_stack(whole) @ (np.column_stack(whole).T @ basis)
    left, sizes, _ = np.linalg.svd(basis, full_matrices=False)
    for direction in _near_axes(left[:, sizes > 0.5])[0].T:
        found.append(Undetermined(direction, _direction_words(direction.reshape(n, 6), channels)))
    return tuple(found)


def _near_axes(basis: Array) -> tuple[Array, NDArray[np.int64]]:
    """An orthonormal basis (m, k) of the same space, turned towards coordinate axes, and these axes (k,)."""
    k = basis.shape[1]
    pivots = np.sort(qr(basis.T, mode="r", pivoting=True)[1][:k]).astype(np.int64)
    u, _, vt = np.linalg.svd(basis[pivots])
    return basis @ (u @ vt).T, pivots


def _wrench_words(u: Array, pivot: int) -> str:
    """A direction of the wrench by its axis, and those that it is tied to: u @ w is always 0."""
    others = [k for k in range(6) if k != pivot and abs(u[k]) > TIED * abs(u[pivot])]
    if not others:
        return str(_WRENCH[pivot])
    kinds = [("force along", [k for k in others if k < 3]), ("moment about", [k for k in others if k >= 3])]
    listed = [f"{kind} {' and '.join('xyz'[k % 3] for k in axes)}" for kind, axes in kinds if axes]
    return f"{_WRENCH[pivot]}, always tied to {' and '.join(listed)}"


def _direction_words(direction: Array, channels: Sequence[str]) -> str:
    """One direction (n, 6): the wrench it belongs to and the channels that feel it, when it separates so."""
    rows, sizes, columns = np.linalg.svd(direction)
    if sizes[0] < 0.9:
        strongest = np.argsort(-np.abs(direction).ravel())[:3]
        pairs = ", ".join(f"{channels[k // 6]} to {_WRENCH[k % 6]}" for k in strongest)
        return f"a combination of gains, most of all {pairs}"
    strong = [channels[i] for i in np.argsort(-np.abs(rows[:, 0])) if abs(rows[i, 0]) > 0.3]
    u = columns[0]
    return f"{_wrench_words(u, int(np.argmax(np.abs(u))))}: gain of {' and '.join(strong)}"


def _setup_errors(rig: Rig, logs: Sequence[Log], estimate: WindowEstimate) -> list[str]:
    """What looks like a mistake in the set-up: units, axes, signs, and parameters far from their priors."""
    found: list[Suspicion] = []
    if logs and any(w.status == _core.WindowStatus.fitted for w in estimate.windows):
        found += setup_errors_in_estimate(rig, logs, estimate.gain, estimate.covariance)
    elif logs:
        found += setup_errors_in_logs(rig, logs)
    for name, departure in estimate.payloads.items():
        u = rig.payloads[name].uncertainty
        stated = np.array([u.mass] + [u.center_of_mass] * 3 + [u.inertia] * 6)
        names = [f"{parameter} of payload `{name}`" for parameter in PAYLOAD_PARAMETERS]
        found += parameters_off_their_priors(names, departure.mean, stated)
    clocks = [
        f"the time offset of log {k + 1}, {1e3 * offset:.3g} ms,"
        for k, offset in enumerate(estimate.time_offsets)
    ]
    stated = np.full(len(clocks), rig.sensor.time_offset_prior)
    found += parameters_off_their_priors(clocks, estimate.time_offsets, stated)
    return [suspicion.words for suspicion in found]


def _of_windows(estimate: WindowEstimate) -> list[str]:
    samples = Counter[str]()
    count = Counter[str]()
    for w in estimate.windows:
        samples[w.status.name] += w.samples
        count[w.status.name] += 1
    total = samples.total()
    rejected = {name: count[name] for name in count if name != "fitted"}
    without = [
        f"no window of log {log + 1} fits: its offset is not determined"
        for log in range(len(estimate.offsets))
        if count["fitted"] and not any(w.log == log and w.status.name == "fitted" for w in estimate.windows)
    ]
    if count["fitted"] and total - samples["fitted"] <= REJECTED * total:
        return without
    worst = max(
        ((fit.chi_square, name) for name, fit in group_fits(estimate.windows, fitted=False).items()),
        default=None,
    )
    level = f" (chi-square per degree of freedom up to {worst[0]:.3g}, {worst[1]})" if worst else ""
    causes = _listed(rejected)
    if not count["fitted"]:
        return [
            f"no window of motion fits{level}: {causes}" if rejected else "the log holds no window of motion"
        ]
    share = 100.0 * (total - samples["fitted"]) / total
    return [*without, f"{share:.0f} % of the samples lie in rejected windows{level}: {causes}"]


def _of_disturbances(estimate: WindowEstimate, logs: Sequence[Log]) -> list[str]:
    found = []
    for k, left_out in enumerate(estimate.left_out):
        share = float(left_out.mean()) if left_out.size else 0.0
        if share > LEFT_OUT:
            found.append(
                f"{100.0 * share:.0f} % of the samples of log {k + 1} were left out as contact or spikes: "
                "too many to trust the rest"
            )
    for k, log in enumerate(logs):
        if estimate.motion_left_out[k] > LEFT_OUT * len(log.time_ns):
            found.append(f"too many samples of the motion of log {k + 1} were left out as spikes")
    return found


def _listed(rejected: Mapping[str, int]) -> str:
    return "; ".join(f"{number} x {_CAUSES[name]}" for name, number in rejected.items())


def _of_gain(rig: Rig, gain: Array) -> list[str]:
    sensor = rig.sensor
    found = _core.conditioning(gain, sensor.noise_array, sensor.nominal_gain_array, sensor.range_array)
    if not found.condition_number < SINGULAR:
        return ["the gain is singular: some wrench leaves no trace in the channels"]
    if found.condition_number > CONDITION:
        return [
            f"the gain is ill-conditioned: condition number {found.condition_number:.3g} in units of range"
        ]
    return []
