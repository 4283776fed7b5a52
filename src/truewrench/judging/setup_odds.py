"""Gross set-up errors that a free gain absorbs: units, axes, signs, a wrong payload (METHOD 8).

Kilonewtons for newtons or swapped axes fit as well as the truth, as another gain. What betrays them is the
nominal gain: C = (C_nom + Delta) T with a T that somebody could have set up is weighed against T = 1, by the
posterior odds of the two given what the data alone say of the gain,

    odds = prior odds * N(c; vec(C_nom T), Sigma_T + P) / N(c; vec(C_nom), Sigma_1 + P)

P holds what the stated uncertainty of the payload leaves open, Sigma_T the spread of the departures Delta T.
Under a correct set-up these are of whatever size up to `gain_prior` explains the gain best, so that a wider
prior never brings a suspicion; a rig that was set up wrongly has a sensor as good as others are.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from truewrench import _core
from truewrench.estimation.estimate import Estimate
from truewrench.judging.setup_mistakes import (
    PRIOR_ODDS,
    Hypothesis,
    Kind,
    axes_in_words,
    drifts,
    mixed_axes,
    payload_directions,
    payload_units,
    scales,
    turns,
)
from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.rig import Rig

COMMON = 0.3  # departures of other sensors, where `gain_prior` says more; its rates are those of `PRIOR_ODDS`
SPREADS = (1.0, 0.5, 0.25)  # of them, equally likely
WIDEST = 1e100  # whose square is a number: tolerance
LADDER = 2.0 ** np.arange(-7.0, 24.0)  # spreads that are tried, up to `gain_prior`: tolerance
WIDE = 10.0  # spread, in gain priors, of a departure that none of the named mistakes explains
DEPARTURE = 0.01  # prior odds of one
UNSEEN = 0.98  # of the prior variance: a direction that uncertain has not been seen in the data: tolerance
NAMED = 0.05  # share of the odds from which on a hypothesis is worth naming
MOST = 3  # hypotheses that are named
NEGLIGIBLE = 20.0  # nats: what is less likely by so much is not pursued: tolerance
GROSS, FAR = 1.5, 6.0  # of nominal, and of the prior's sigma, that some gain is off: no turn, no late clock
MORE = 0.1  # of what is uncertain along a payload's error, below which the payload is not what is: tolerance
LOST = 10.0  # times the stated noise of the sensor, from which on the estimate describes nothing: tolerance
SAME = 1e-9  # of a determinant: tolerance
SHORTLIST = 12  # signed permutations of each family that are evaluated in full: tolerance

PAYLOAD_PARAMETERS = (
    "mass",
    *(f"centre of mass along {axis}" for axis in "xyz"),
    *(f"inertia {element}" for element in ("xx", "yy", "zz", "xy", "xz", "yz")),
)
"""What the ten departures of a payload are."""


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A set-up error that explains the estimate better than a correct set-up does."""

    kind: Kind  # what was set up wrongly
    words: str  # the same for a person, with the odds
    log_odds: float  # natural logarithm of the posterior odds against a correct set-up


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What the data alone say: basis @ vec(C) ~ N(value, variance), basis (r, 6n) orthonormal."""

    basis: Array
    value: Array
    variance: Array  # (r, r)
    open: Array  # (r, k) where to relative errors of payloads, as large as what they turn, turn the estimate
    width: Array  # (k, k) covariance of such errors in `variance`
    turned: Array  # (k, 6, 6) by what one sigma of them turns gains, where it is not in `variance`

    def stretched(self, solved: Array) -> float:
        """What the payloads' errors that are in `variance` cost, in nats, beyond what it says.

        To first order a gain of zero is one error away, and all others are known as well there as at the
        estimate: masses known to 10 to 30% were grams in 24 of 24 records. A share x of what was found takes
        an error of x / (1 - x), and the 3n gains that it turns are 1 - x as large there, and known so well.
        What is solved (r,) is the misfit by its covariance.
        """
        share = np.maximum(self.width @ (self.open.T @ solved), 0.0)
        if not (share < 1.0).all():
            return math.inf
        error, variance = share / (1.0 - share), np.diag(self.width)
        cost = 0.5 * np.sum((error**2 - share**2) / np.where(variance > 0.0, variance, 1.0))
        return float(cost - (self.basis.shape[1] / 2 - 1) * np.sum(np.log1p(-share)))


def setup_errors(
    estimate: Estimate,
    rig: Rig,
    logs: Sequence[Log],
    plain: Callable[[], tuple[Array, Array] | None] | None = None,
) -> tuple[Suspicion, ...]:
    """Set-up errors that an estimate suggests, most likely first; empty when none does.

    The logs name the payloads. `plain` is gain (n, 6) and covariance (6n, 6n) by least squares, SI, for an
    exact payload and without a prior; None where there is none. It is asked for where a record in the wrong
    units leaves the estimate lost: what is a thousand times as large as it may be is noise to it.
    """
    n = rig.sensor.n
    names = [name for name in dict.fromkeys(log.payload for log in logs) if name in rig.payloads]
    prior = float(np.median(estimate.gain_prior))
    if not _lost(estimate, rig):
        P = estimate.normalised_covariance[: 6 * n, : 6 * n]
        found = _of_gain(estimate.gain, P, estimate.before_pose, prior, rig, names)
        for name, departure in estimate.payloads.items():
            if name in rig.payloads:
                stated = rig.payloads[name].uncertainty.of_each
                # what the data have not told they have not moved, whatever a short record makes of it
                told = departure.std**2 < UNSEEN * stated**2
                found += payload_errors(name, departure.mean, np.where(told, stated, 0.0))
        return found
    if plain is None or (known := plain()) is None:
        return ()
    gain, covariance = known
    unit = 1.0 / rig.sensor.gain_unit.ravel()
    return _of_gain(gain, covariance[: 6 * n, : 6 * n] * np.outer(unit, unit), None, prior, rig, names)


def gross_errors(rig: Rig, logs: Sequence[Log], gain: Array, covariance: Array) -> tuple[Suspicion, ...]:
    """Set-up errors so gross that no sensor is so wrong by itself; empty where there is none.

    No prior has pulled the gain (n, 6), SI; its covariance (6n, 6n) is for an exact payload.
    """
    sensor, names = rig.sensor, list(dict.fromkeys(log.payload for log in logs))
    unit = 1.0 / sensor.gain_unit
    apart = float(np.abs((gain - sensor.nominal_gain_array) * unit).max())
    if not apart > max(GROSS, FAR * sensor.gain_prior):
        return ()
    n = sensor.n
    P = covariance[: 6 * n, : 6 * n] * np.outer(unit, unit)
    found = _of_gain(gain, P, None, sensor.gain_prior, rig, names)
    return found if found and found[0].kind in ("scale", "axes") and found[0].log_odds > NEGLIGIBLE else ()


def _of_gain(
    gain: Array, P: Array, before_pose: Array | None, prior: float, rig: Rig, names: Sequence[str]
) -> tuple[Suspicion, ...]:
    sensor = rig.sensor
    unit = 1.0 / sensor.gain_unit  # normalised gain per SI gain
    return suspected_setup_errors(
        gain * unit,
        P,
        sensor.nominal_gain_array * unit,
        prior,
        sensor.range_array,
        sensor.channel_scale,
        centers_of_mass=[rig.payloads[name].center_of_mass_array for name in names],
        relative=[(u.mass, u.inertia) for u in (rig.payloads[name].uncertainty for name in names)],
        before_pose=before_pose,
        prior_in_estimate=before_pose is not None,
        unknown=_unknown(rig, names) if before_pose is None else (),
    )


def _lost(estimate: Estimate, rig: Rig) -> bool:
    """Whether the record is noise to the estimate, and says nothing of the gain."""
    if not estimate.solved or not estimate.follows:
        return True
    # no gain of channels that are noise to it is known
    n = rig.sensor.n
    known = np.sqrt(np.diag(estimate.before_pose)) <= _core.UNDETERMINED * estimate.gain_prior
    of = {"force": slice(0, 3), "moment": slice(3, 6), "channels": slice(0, n)}
    loud = [f.what for found in estimate.noise for f in found if f.what in of and f.of_sample > LOST]
    return any(not known.reshape(n, 6)[of[what]].any() for what in loud)


def _unknown(rig: Rig, names: Sequence[str]) -> list[Array]:
    """(6, 6) each: by what 1 sigma of the payloads turns normalised gains, C (1 + unknown)."""
    found = []
    for name in names:
        u, at = rig.payloads[name].uncertainty, rig.payloads[name].center_of_mass_array
        sigma = (u.mass, u.inertia, *[u.center_of_mass] * 3)
        directions = payload_directions(rig.sensor.range_array, at)
        found += [s * direction for s, direction in zip(sigma, directions, strict=True)]
    return found


def suspected_setup_errors(
    gain: Array,
    covariance: Array,
    nominal: Array,
    prior: float,
    span: Array,
    channel_scale: Array,
    *,
    centers_of_mass: Sequence[Array] = (),
    relative: Sequence[tuple[float, float]] = (),
    before_pose: Array | None = None,
    prior_in_estimate: bool = True,
    unknown: Sequence[Array] = (),
) -> tuple[Suspicion, ...]:
    """Set-up errors that a gain suggests, most likely first; empty when none does.

    Gains (n, 6) are normalised, gain_ij span_j / channel_scale_i; `prior` is 1 sigma of their departure from
    nominal, and False for `prior_in_estimate` means that it has not pulled them there (least squares). The
    covariance (6n, 6n), row by row, has what the payload's uncertainty leaves open, or `unknown` (6, 6) each
    are by what 1 sigma of the payloads turns gains; `before_pose` is that before (10.10), if the other is
    after it. A wrong mass, centre of mass or inertia is looked for in payloads with these centres [m], known
    to as much, `relative` of mass and inertia.
    """
    known = all(np.all(np.abs(x) < WIDEST) for x in (gain, covariance, nominal))  # NaN is not
    if not known or not prior > 0.0:
        return ()
    prior = min(prior, WIDEST)
    P = covariance if before_pose is None or not np.isfinite(before_pose).all() else before_pose
    by = [d for c in centers_of_mass for d in payload_directions(span, c)[:2]]
    known_to = np.array(relative, np.float64).ravel()
    seen = _seen_in_data(gain, P, covariance - P, nominal, prior, prior_in_estimate, by, known_to, unknown)
    if seen.value.size == 0:
        return ()
    n, spread = len(nominal), min(prior, COMMON)
    correct = Hypothesis("departure", "", 0.0, np.eye(n), np.eye(6))
    upto = [*LADDER[prior > LADDER], min(prior, LADDER[-1])]
    sound = max(float(_log_evidence(seen, nominal, [correct], s)[0]) for s in upto)
    words = f"the gain departs from nominal by far more than the stated {prior:g}"
    wide = float(_log_evidence(seen, nominal, [correct], WIDE * min(prior, LADDER[-1]))[0])
    odds: dict[tuple[Kind, str], float] = {("departure", words): math.log(DEPARTURE) + wide - sound}
    hypotheses = [
        *scales(n),
        *payload_units(n, span, centers_of_mass),
        *drifts(n, span, centers_of_mass),
        *_axes(seen, nominal, spread, span, channel_scale),
    ]
    log_prior = np.array([h.log_prior for h in hypotheses])
    first = _beside_sound(seen, nominal, hypotheses, spread, sound) + log_prior
    # a narrower spread raises the density by its volume at most
    least = max(first.max(), 0.0) - NEGLIGIBLE - seen.value.size * math.log(1.0 / min(SPREADS))
    worth = np.flatnonzero(first > least)
    pursued = [hypotheses[k] for k in worth]
    rows = [
        first[worth],
        *(_beside_sound(seen, nominal, pursued, s * spread, sound) + log_prior[worth] for s in SPREADS[1:]),
    ]
    for h, average in zip(pursued, np.logaddexp.reduce(rows) - math.log(len(SPREADS)), strict=True):
        key = h.kind, h.words
        odds[key] = float(np.logaddexp(odds.get(key, -math.inf), average))
    total = float(np.logaddexp.reduce(list(odds.values())))
    if not total > 0.0:
        return ()
    named = sorted((item for item in odds.items() if item[1] > total + math.log(NAMED)), key=lambda x: -x[1])
    return tuple(_suspicion(kind, words, value) for (kind, words), value in named[:MOST])


def payload_errors(name: str, departure: Array, stated: Array) -> tuple[Suspicion, ...]:
    """Properties of a payload that the data moved further from what is stated than its uncertainty allows.

    The departure (10,) is posterior less stated, in the units of `stated` (10,), 1 sigma; what is exact, 0,
    cannot depart.
    """
    found = []
    for what, moved, sigma in zip(PAYLOAD_PARAMETERS, departure, stated, strict=True):
        if not sigma > 0.0 or not np.isfinite(moved):
            continue
        z = abs(float(moved)) / float(sigma)
        # odds of an uncertainty that was stated ten times too small: even at 3.9 sigma, 1 in 1,000 a payload
        log_odds = math.log(PRIOR_ODDS["payload"] / len(departure) / WIDE) + 0.5 * z**2 * (1.0 - WIDE**-2.0)
        if log_odds > 0.0:
            words = f"{what} of payload `{name}` is {z:.1f} sigma from what the rig states"
            found.append(_suspicion("payload", words, log_odds))
    return tuple(sorted(found, key=lambda suspicion: -suspicion.log_odds)[:MOST])


def _suspicion(kind: Kind, words: str, log_odds: float) -> Suspicion:
    decades = log_odds / math.log(10.0)
    odds = f"1e{math.floor(decades)}" if decades > 6.0 else f"{math.exp(log_odds):.2g}"
    return Suspicion(kind, f"suspected set-up error: {words} (posterior odds {odds} to 1)", log_odds)


def _seen_in_data(
    gain: Array,
    P: Array,
    added: Array,
    nominal: Array,
    prior: float,
    prior_in_estimate: bool,
    relative: Sequence[Array],
    known_to: Array,
    unknown: Sequence[Array],
) -> _Seen:
    """Likelihood of the data alone. The prior is isotropic, so it leaves along the axes of the covariance."""
    p, axes = np.linalg.eigh(0.5 * (P + P.T))
    p = np.maximum(p, (1e-9 * min(prior, 1.0)) ** 2)
    # beside a prior the data's own variance is infinite there; without one it is what it is
    seen = p < UNSEEN * prior**2 if prior_in_estimate else p < (1e6 * prior) ** 2
    p, basis = p[seen], axes[:, seen].T
    pulled_less = 1.0 / (1.0 - p / prior**2) if prior_in_estimate else np.ones_like(p)
    value = basis @ nominal.ravel() + pulled_less * (basis @ (gain - nominal).ravel())
    variance = p * pulled_less
    open_ = np.array([gain @ by for by in relative if prior_in_estimate]).reshape(-1, gain.size)
    # where a payload is known less well than gains, they are known along it as well as the payload is:
    # badly, but not so badly that they may be a thousandth
    for along in open_:
        rest = along - basis.T @ (basis @ along)
        if np.linalg.norm(rest) > 0.5 * np.linalg.norm(along):
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
            value = np.append(value, basis[-1] @ gain.ravel())
            variance = np.append(variance, prior**2 * UNSEEN / (1.0 - UNSEEN))
    V, E = np.diag(variance) + basis @ added @ basis.T, basis @ open_.T
    inverse = np.linalg.pinv(E)
    width = inverse @ V @ inverse.T
    if known_to.size == len(width):  # what else is uncertain along them is no error of a payload
        less = known_to / np.sqrt(np.maximum(np.diag(width), np.finfo(np.float64).tiny))
        less = np.where(less < MORE, less, 1.0)
        width *= np.outer(less, less)
    return _Seen(basis, value, V, E, width, np.reshape(unknown, (-1, 6, 6)))


def _beside_sound(
    seen: _Seen, nominal: Array, hypotheses: Sequence[Hypothesis], spread: float, sound: float
) -> Array:
    """What the data say for each hypothesis beside a correct set-up, whose evidence is `sound`.

    A mistake that makes gains smaller makes their departures smaller, too. Where those of a sound sensor
    happen to be that small, it is its departures that are, and not its gains: it is given them, about C_nom.
    Else forces without crosstalk to moments, none of which was loaded, were moments in micro-units.
    """
    found = _log_evidence(seen, nominal, hypotheses, spread)
    size = np.array([abs(np.linalg.det(h.left) * np.linalg.det(h.right)) for h in hypotheses])
    narrow = np.flatnonzero(size < 1.0 - SAME).tolist()
    level = np.full(len(hypotheses), sound)
    about = _log_evidence(seen, nominal, [hypotheses[k] for k in narrow], spread, moved=False)
    level[narrow] = np.maximum(sound, about)
    return np.asarray(found - level)


def _log_evidence(
    seen: _Seen, nominal: Array, hypotheses: Sequence[Hypothesis], spread: float, *, moved: bool = True
) -> Array:
    """Log marginal likelihood of each, for departures of a spread; about C_nom or, `moved`, C_nom T."""
    n, r = len(nominal), seen.value.size
    if not hypotheses:
        return np.zeros(0)
    left, right = (np.array([getattr(h, side) for h in hypotheses]) for side in ("left", "right"))
    means = left @ nominal @ right if moved else nominal
    misfit = np.broadcast_to(seen.value - means.reshape(-1, 6 * n) @ seen.basis.T, (len(hypotheses), r))
    # vec(left Delta right) in the basis, per element of Delta
    factor = (
        np.swapaxes(left, 1, 2)[:, None] @ seen.basis.reshape(r, n, 6) @ np.swapaxes(right, 1, 2)[:, None]
    )
    factor = spread * factor.reshape(-1, r, 6 * n)
    along = means[..., None, :, :] @ seen.turned
    along = along.reshape(*along.shape[:-2], 6 * n) @ seen.basis.T
    totals = factor @ np.swapaxes(factor, 1, 2) + seen.variance + np.swapaxes(along, -2, -1) @ along
    found = np.full(len(hypotheses), -np.inf)
    for k, (h, total) in enumerate(zip(hypotheses, totals, strict=True)):
        if h.drift is not None:
            along = seen.basis @ (nominal @ h.drift).ravel()
            total += np.outer(along, along)
        root, fault = dpotrf(total.T, lower=1)  # symmetric; transposed it is in LAPACK's order
        if fault == 0:
            white, _ = dtrtrs(root, misfit[k], lower=1)
            found[k] = -0.5 * (white @ white) - np.log(np.diagonal(root)).sum()
            if seen.open.size and moved and h.kind != "departure":  # a sound rig has the benefit of the doubt
                found[k] -= seen.stretched(dtrtrs(root, white, lower=1, trans=1)[0])
    return found


def _axes(
    seen: _Seen, nominal: Array, spread: float, span: Array, channel_scale: Array
) -> Iterator[Hypothesis]:
    """A rotation of the axes, and the most likely signed permutations of axes and, of six, of channels.

    A permutation of SI axes also rescales normalised ones, where their ranges differ. A family separates into
    one score per pair of axes, so that all permutations of it are compared at once, with the uncertainty of
    the data taken without its correlations.
    """
    n = len(nominal)
    pseudo = np.linalg.pinv(nominal)  # (6, n)
    unseen = np.eye(6 * n) - seen.basis.T @ seen.basis
    estimate = (seen.basis.T @ seen.value + unseen @ nominal.ravel()).reshape(n, 6)
    covariance = (seen.basis.T @ seen.variance @ seen.basis + unseen).reshape(n, 6, n, 6)
    yield from turns(n, pseudo @ estimate, span, spread)
    families: list[tuple[Literal["axes", "channels"], Array]] = [("axes", np.ones((6, 6)))]
    if np.ptp(span) > 0.0:
        families.append(("axes", span / span[:, None]))
    if n == 6 and not np.array_equal(nominal, np.eye(6)):
        families.append(("channels", np.ones((6, 6))))
    if n == 6 and np.ptp(channel_scale) > 0.0:
        families.append(("channels", channel_scale / channel_scale[:, None]))
    log_of_axes = math.log(PRIOR_ODDS["axes"] / len(families))
    for side, factor in families:
        if side == "axes":  # T of C_nom T, which separates by columns, transposed
            T, squares, factor = (pseudo @ estimate).T, np.sum(pseudo**2, axis=1), factor.T
            variance = np.einsum("ia,ajbj,ib->ji", pseudo, covariance, pseudo)
        else:  # T of T C_nom, which separates by rows
            T, squares = estimate @ pseudo, np.sum(pseudo**2, axis=0)
            variance = np.einsum("jk,ijim,mk->ik", pseudo, covariance, pseudo)
        for signed, log_prior in mixed_axes(T, variance, squares * spread**2, factor, SHORTLIST):
            right, left = ((signed * factor).T, np.eye(n)) if side == "axes" else (np.eye(6), signed * factor)
            words = axes_in_words(signed.T if side == "axes" else signed)
            yield Hypothesis("axes", words, log_of_axes + log_prior, left, right)
