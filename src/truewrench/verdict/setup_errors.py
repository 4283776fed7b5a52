"""Gross set-up errors that a free gain absorbs: units, axes, signs.

Kilonewtons for newtons or swapped axes fit as well as the truth, as another gain. What betrays them is the
nominal gain: C = (C_nom + Delta) T with a T that somebody could have set up is weighed against T = 1, by the
posterior odds of the two given the estimate,

    odds = prior odds * N(c; vec(C_nom T), Sigma_T + P) / N(c; vec(C_nom), Sigma_1 + P)

with Sigma_T the spread that `gain_prior` gives to the departures Delta T, and P the data's own covariance.
Departures are as large as stated or smaller, so each side is averaged over the spreads in `SPREADS`
(docs/method.md, "What a good fit cannot show").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dtrtrs

from truewrench.errors import InputError
from truewrench.estimate.least_squares import least_squares
from truewrench.log import Log
from truewrench.rig import Rig
from truewrench.verdict import signed_axes
from truewrench.verdict.setup_hypotheses import PRIOR_ODDS, Hypothesis, Kind, drifts, payload_units, scales

__all__ = [
    "Suspicion",
    "odds_in_words",
    "parameters_off_their_priors",
    "setup_errors_in_estimate",
    "setup_errors_in_logs",
    "suspected_setup_errors",
]

Array = NDArray[np.float64]
Side = Literal["axes", "channels"]

SPREADS = (1.0, 0.5, 0.25)  # of gain_prior, equally likely: departures are as large as it or smaller
WIDE = 10.0  # spread, in gain priors, of a departure that none of the named mistakes explains
UNSEEN = 0.98  # of the prior variance: a direction that uncertain has not been seen in the data
NAMED = 0.05  # share of the odds from which on a hypothesis is worth naming
MOST = 3  # hypotheses that are named
NEGLIGIBLE = 20.0  # nats: what is less likely by so much is not pursued
SHORTLIST = 12  # signed permutations of each family that are evaluated in full
LONGEST = 6000  # rows of a log that least squares are given
PARAMETER_SIGMA = 3.0  # departure of a common parameter from its prior


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A set-up error that explains the gain better than a correct set-up does.

    Attributes:
        kind: what was set up wrongly.
        words: the same for a person, with the odds.
        log_odds: natural logarithm of the posterior odds against a correct set-up.
    """

    kind: Kind
    words: str
    log_odds: float


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What the data alone say: basis @ vec(C) ~ N(value, diag(variance)), basis (r, 6n) orthonormal."""

    basis: Array
    value: Array
    variance: Array


def suspected_setup_errors(
    gain: Array,
    covariance: Array,
    nominal: Array,
    prior: float,
    span: Array,
    channel_scale: Array,
    *,
    centers_of_mass: Sequence[Array] = (),
    prior_in_estimate: bool = True,
) -> tuple[Suspicion, ...]:
    """Set-up errors that the estimated gain suggests, most likely first; empty when none does.

    Gains are normalised: gain_ij range_j / channel_scale_i.

    Args:
        gain: (n, 6) estimate.
        covariance: (6n, 6n) of it, row by row.
        nominal: (n, 6).
        prior: 1 sigma of every gain's departure from nominal.
        span: (6,) range of the wrench axes [N, N m]; it relates normalised axes to SI ones,
        channel_scale: (n,) and this normalised channels to raw ones.
        centers_of_mass: (3,) each, of the payloads carried [m]: wrong units of mass, centre of mass and
            inertia are looked for in these.
        prior_in_estimate: False for an estimate that `prior` has not pulled towards nominal (least squares).
    """
    seen = _seen_in_data(gain, covariance, nominal, prior, prior_in_estimate)
    if not np.isfinite(gain).all() or seen.value.size == 0:
        return ()
    n = len(nominal)
    correct = Hypothesis("departure", "", 0.0, np.eye(n), np.eye(6))
    hypotheses = [
        *scales(n),
        *payload_units(n, span, centers_of_mass),
        *drifts(n, span, centers_of_mass),
        *_axes(seen, nominal, prior, span, channel_scale),
    ]
    evidence = _log_evidence(seen, nominal, prior, [correct, *hypotheses], SPREADS)
    wide = math.log(PRIOR_ODDS["departure"])
    wide += float(_log_evidence(seen, nominal, prior, [correct], (WIDE,))[0] - evidence[0])
    log_odds = np.array([h.log_prior for h in hypotheses]) + evidence[1:] - evidence[0]
    total = float(np.logaddexp(wide, np.logaddexp.reduce(log_odds)))
    if total <= 0.0:
        return ()
    by_words: dict[tuple[Kind, str], float] = {
        ("departure", f"the gain departs from nominal by far more than the stated {prior:g}"): wide
    }
    for k in np.flatnonzero(log_odds > total - NEGLIGIBLE):
        hypothesis = hypotheses[k]
        words = hypothesis.words if hypothesis.signed is None else signed_axes.in_words(hypothesis.signed)
        key = hypothesis.kind, words
        by_words[key] = float(np.logaddexp(by_words.get(key, -math.inf), log_odds[k]))
    named = {key: odds for key, odds in by_words.items() if odds > total + math.log(NAMED)}
    return tuple(
        Suspicion(kind, f"suspected set-up error: {words} ({odds_in_words(odds)})", odds)
        for (kind, words), odds in sorted(named.items(), key=lambda item: -item[1])[:MOST]
    )


def setup_errors_in_estimate(
    rig: Rig, logs: Sequence[Log], gain: Array, covariance: Array, *, prior_in_estimate: bool = True
) -> tuple[Suspicion, ...]:
    """`suspected_setup_errors` of a rig's gain.

    Args:
        rig: nominal gain, ranges, gain prior and payloads.
        logs: what the estimate rests on; they name the payloads.
        gain: (n, 6), SI.
        covariance: (6n, 6n) of the gain, or more rows than that (offsets behind it), SI.
        prior_in_estimate: as there.
    """
    sensor = rig.sensor
    unit = sensor.range_array / sensor.channel_scale[:, None]  # normalised gain per SI gain
    size, flat = 6 * sensor.n, unit.ravel()
    return suspected_setup_errors(
        gain * unit,
        covariance[:size, :size] * flat[:, None] * flat,
        sensor.nominal_gain_array * unit,
        sensor.gain_prior,
        sensor.range_array,
        sensor.channel_scale,
        centers_of_mass=[
            rig.payloads[name].center_of_mass_array for name in dict.fromkeys(log.payload for log in logs)
        ],
        prior_in_estimate=prior_in_estimate,
    )


def setup_errors_in_logs(rig: Rig, logs: Sequence[Log]) -> tuple[Suspicion, ...]:
    """`suspected_setup_errors` of a plain least-squares gain, where no estimate has converged.

    That gain knows no prior, needs no start and no convergence: a rig in kilonewtons, which every window may
    have rejected, is recognised by it. Long logs and streams of different rates are averaged to common rows.
    Logs it cannot use (no motion, no stretch of rows) suggest nothing.
    """
    try:
        estimate = least_squares(rig, [_thinned(log) for log in logs], smooth="spline")
    except InputError:
        return ()
    return setup_errors_in_estimate(rig, logs, estimate.gain, estimate.covariance, prior_in_estimate=False)


def _thinned(log: Log) -> Log:
    """A log with raw channels, twist and gravity averaged over spans that hold samples of each."""
    streams = [log.raw, log.twist, log.gravity]
    complete = [np.isfinite(x).all(axis=1) for x in streams if x is not None]
    fewest = min(int(rows.sum()) for rows in complete)
    if fewest == 0 or (np.all(complete) and len(log.raw) <= LONGEST):
        return log
    spans = min(LONGEST, fewest)
    edges = np.linspace(0.0, log.time[-1] * (1.0 + 1e-12) + 1e-9, spans + 1)
    begin = np.unique(np.searchsorted(log.time, edges[:-1]))
    begin = begin[begin < len(log.time)]
    count = np.diff(np.append(begin, len(log.time)))

    def mean(values: Array) -> Array:
        known = np.isfinite(values)
        total = np.add.reduceat(np.where(known, values, 0.0), begin)
        number = np.add.reduceat(known.astype(np.float64), begin)
        return np.where(number > 0, total / np.maximum(number, 1.0), np.nan)

    time_ns = log.time_ns[0] + np.rint(np.add.reduceat(log.time_ns - log.time_ns[0], begin) / count)
    return replace(
        log,
        time_ns=time_ns.astype(np.int64),
        raw=mean(log.raw),
        twist=None if log.twist is None else mean(log.twist),
        gravity=None if log.gravity is None else mean(log.gravity),
        acceleration=None,
        temperature=None,
        reference=None,
    )


def parameters_off_their_priors(
    names: Sequence[str], departure: Array, prior_std: Array, limit: float = PARAMETER_SIGMA
) -> tuple[Suspicion, ...]:
    """Common parameters that the data moved further from their priors than these allow.

    Args:
        names: (k,) such as "mass of payload `tool`".
        departure: (k,) posterior minus prior mean.
        prior_std: (k,) 1 sigma of the prior; 0 for what is exact, which cannot depart.
        limit: in sigmas.
    """
    found = []
    for name, moved, sigma in zip(names, departure, prior_std, strict=True):
        if sigma <= 0.0 or abs(moved) <= limit * sigma:
            continue
        z = abs(moved) / sigma
        # odds of a prior that was ten times too narrow
        log_odds = math.log(PRIOR_ODDS["payload"] / WIDE) + 0.5 * z**2 * (1.0 - WIDE**-2.0)
        words = f"suspected set-up error: {name} is {z:.1f} sigma from what the rig states"
        found.append(Suspicion("parameter", f"{words} ({odds_in_words(log_odds)})", log_odds))
    return tuple(sorted(found, key=lambda suspicion: -suspicion.log_odds))


def odds_in_words(log_odds: float) -> str:
    """`posterior odds 250 to 1`."""
    decades = log_odds / math.log(10.0)
    if decades > 6.0:
        return f"posterior odds 1e{math.floor(decades)} to 1"
    return f"posterior odds {math.exp(log_odds):.2g} to 1"


def _seen_in_data(
    gain: Array, covariance: Array, nominal: Array, prior: float, prior_in_estimate: bool
) -> _Seen:
    """Likelihood of the data alone. The prior is isotropic, so it leaves along the axes of the covariance."""
    p, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    p = np.maximum(p, (1e-9 * prior) ** 2)
    seen = p < UNSEEN * prior**2
    p, basis = p[seen], axes[:, seen].T
    pulled_less = prior**2 / (prior**2 - p) if prior_in_estimate else np.ones_like(p)
    value = basis @ nominal.ravel() + pulled_less * (basis @ (gain - nominal).ravel())
    return _Seen(basis, value, p * pulled_less)


def _log_evidence(
    seen: _Seen,
    nominal: Array,
    prior: float,
    hypotheses: Sequence[Hypothesis],
    spreads: Sequence[float],
) -> Array:
    """Logarithm of the marginal likelihood of each hypothesis, averaged over the spreads."""
    n, r = len(nominal), seen.value.size
    left = np.array([h.left for h in hypotheses])
    right = np.array([h.right for h in hypotheses])
    mean = (left @ nominal @ right).reshape(-1, 6 * n) @ seen.basis.T
    basis = seen.basis.reshape(r, n, 6)
    # vec(left Delta right) in the basis, per element of Delta
    factor = np.swapaxes(left, 1, 2)[:, None] @ basis @ np.swapaxes(right, 1, 2)[:, None]
    factor = factor.reshape(-1, r, 6 * n)
    spread = factor @ np.swapaxes(factor, 1, 2)
    drift = np.array([np.zeros((6, 6)) if h.drift is None else h.drift for h in hypotheses])
    along = (nominal @ drift).reshape(-1, 6 * n) @ seen.basis.T  # (H, r)
    misfit = seen.value - mean
    logs = np.full((len(spreads), len(hypotheses)), -np.inf)
    worth = np.arange(len(hypotheses))
    for k, relative in enumerate(spreads):
        total = (relative * prior) ** 2 * spread[worth]
        total += along[worth, :, None] * along[worth, None, :]
        total[:, np.arange(r), np.arange(r)] += seen.variance
        for i, covariance, d in zip(worth, total, misfit[worth], strict=True):
            root, _ = dpotrf(covariance.T, lower=1)  # symmetric; transposed it is in LAPACK's order
            white, _ = dtrtrs(root, d, lower=1)
            logs[k, i] = -0.5 * (white @ white) - np.log(np.diagonal(root)).sum()
        # a narrower spread raises the density by its volume at most
        worth = np.flatnonzero(logs[0] > logs[0].max() + r * math.log(min(spreads)) - NEGLIGIBLE)
    average: Array = np.logaddexp.reduce(logs, axis=0) - math.log(len(spreads))
    return average


def _axes(seen: _Seen, nominal: Array, prior: float, span: Array, channel_scale: Array) -> list[Hypothesis]:
    """The most likely signed permutations of the wrench axes and, with six channels, of the channels.

    A permutation of SI axes also rescales normalised ones, where their ranges differ. Whatever its spread, a
    family separates into one score per pair of axes, so that all permutations of it are compared at once,
    with the uncertainty of the data taken without its correlations. The best are then evaluated in full.
    """
    n = len(nominal)
    pseudo = np.linalg.pinv(nominal)  # (6, n)
    unseen = np.eye(6 * n) - seen.basis.T @ seen.basis
    estimate = (seen.basis.T @ seen.value + unseen @ nominal.ravel()).reshape(n, 6)
    covariance = ((seen.basis.T * seen.variance) @ seen.basis + unseen).reshape(n, 6, n, 6)
    families: list[tuple[Side, Array]] = [("axes", np.ones((6, 6)))]
    if np.ptp(span) > 0.0:
        families.append(("axes", span / span[:, None]))
    if n == 6 and not np.array_equal(nominal, np.eye(6)):
        families.append(("channels", np.ones((6, 6))))
    if n == 6 and np.ptp(channel_scale) > 0.0:
        families.append(("channels", channel_scale / channel_scale[:, None]))
    log_of_axes = math.log(PRIOR_ODDS["axes"] / len(families))
    found = []
    for side, factor in families:
        if side == "axes":  # T of C_nom T, which separates by columns, transposed
            T = (pseudo @ estimate).T
            variance = np.einsum("ia,ajbj,ib->ji", pseudo, covariance, pseudo)
            spread, factor = np.sum(pseudo**2, axis=1), factor.T
        else:  # T of T C_nom, which separates by rows
            T = estimate @ pseudo
            variance = np.einsum("jk,ijim,mk->ik", pseudo, covariance, pseudo)
            spread = np.sum(pseudo**2, axis=0)
        for signed in signed_axes.shortlist(T, variance, spread * prior**2, factor, SHORTLIST):
            log_prior = log_of_axes + signed_axes.log_prior(signed)
            if side == "axes":
                left, right, signed = np.eye(n), (signed * factor).T, signed.T
            else:
                left, right = signed * factor, np.eye(6)
            found.append(Hypothesis("axes", "", log_prior, left, right, signed))
    return found
