"""The paper's motions: sinusoidal forces and moments, and what becomes of the body ([A00] 13-17)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid

from truewrench.model.arrays import Array, Integers
from truewrench.model.errors import UnsupportedError
from truewrench.model.motion.spatial import at_point
from truewrench.model.motion.trajectory import Body, WrenchSinusoids, integrate_wrench
from truewrench.model.rig import PlanSpec, Rig
from truewrench.planning.criterion import Criterion, packed
from truewrench.planning.limits import Limits
from truewrench.planning.period import ROWS, plan_rows
from truewrench.planning.result import Design
from truewrench.planning.search import Progress
from truewrench.planning.sinusoids import Batch, Motions, integrated, without_drift
from truewrench.planning.twist_plan import twist_design

ONE_FREQUENCY = (
    "every force has one frequency, and the moment about its axis the same: a delay turns one into the other "
    "and passes for gain, and so may what follows the pose (a cable); `optimal` motions have several"
)
"""What is to be known of the paper's motions."""

_OFFSETS = ((0, 1, 2), (2, 1, 0), (1, 0, 2), (0, 2, 4))  # of the three integers
_RATIOS = np.geomspace(0.1, 4.0, 6)  # of moment to force, each in units of what it may be alone
_SIZES = np.geomspace(0.04, 1.0, 12)  # of the amplitudes, in those units
_GIVEN_UP = 2  # sizes beyond the limits after which larger ones are not tried
_DEFAULT_K = 5  # where no limit says what frequency is good
_SHRINK = 0.98
_TRIES = 40


@dataclass(frozen=True, slots=True, eq=False)
class Sinusoids:
    """A wrench and the initial twist (6,) that keeps its body from drifting."""

    wrench: WrenchSinusoids  # as a function of time
    body: Body  # the payload
    initial: Array  # twist of the centre of mass at time 0
    value: float  # the criterion
    feasible: bool  # whether the motion is within the limits


def design_wrench(rig: Rig, payload: str, progress: Progress) -> Design:
    """Sinusoidal wrenches whose motion stays within the limits where that is possible; not in gravity."""
    if rig.in_gravity:
        found, expected = "a rig in gravity", "`optimal`: sinusoidal wrenches are those of a free body"
        raise UnsupportedError.at(rig.path, "--method wrench", found, expected)
    limits = Limits.of(rig, 6)
    best = best_sinusoids(rig, payload, limits, progress)
    for _ in range(_TRIES):
        twist, acceleration = twist_of(rig, best)
        design = twist_design(rig, payload, limits, twist, acceleration, rig.plan.duration)
        if not best.feasible or max(use.share for use in design.preview.usage) <= 1.0:
            break
        best = scaled(best, _SHRINK)
    notes = [
        "the motion neither starts nor ends at rest: it has to be led into its initial twist",
        ONE_FREQUENCY,
    ]
    return replace(design, notes=tuple(notes), facts=facts_of(best))


def twist_of(rig: Rig, found: Sinusoids) -> tuple[Array, Array]:
    """Twist (N, 6) of the rig's point, and its derivative, at the rows of the plan."""
    body, rows = found.body, plan_rows(rig)
    motion = integrate_wrench(found.wrench, body, rig.plan.duration, found.initial)
    blocks = [motion.twist(rows), motion.acceleration(rows)]
    if rig.motion.of == "sensor":  # v_S = v_C - Omega x c
        blocks = [at_point(six, -body.center_of_mass) for six in blocks]
    return blocks[0], blocks[1]


def best_sinusoids(rig: Rig, payload: str, limits: Limits, progress: Progress) -> Sinusoids:
    """The wrench with the least predicted sigma among many, of the largest amplitudes within the limits."""
    body, duration = _body(rig, payload), rig.plan.duration
    measure = Criterion(rig, duration * rig.simulate.sensor_rate, "A")
    whole = _shapes(rig, body, limits)
    initial, before = whole.scaled(_SIZES[0]).slow_twist(), _SIZES[0]
    best: Sinusoids | None = None
    least: tuple[float, Sinusoids] | None = None
    over = np.zeros(len(whole.k), dtype=np.int64)
    for s, size in enumerate(_SIZES):
        progress("wrenches", s / _SIZES.size)
        batch = whole.scaled(size)
        initial = without_drift(batch, initial * size / before)
        before = size
        motions = integrated(batch, initial)
        used = _used(rig, limits, batch, motions)
        for b in range(used.size):
            wrench = WrenchSinusoids(batch.force[b], batch.moment[b], batch.k[b], duration)
            if used[b] <= 1.0:
                sampled = wrench.wrench(motions.time[:-1]) / rig.sensor.range_array
                value = measure(packed(sampled))
                if best is None or value < best.value:
                    best = Sinusoids(wrench, body, initial[b], value, True)
            elif least is None or used[b] < least[0]:
                least = (float(used[b]), Sinusoids(wrench, body, initial[b], np.inf, False))
        over = np.where(used > 1.0, over + 1, 0)
        go_on = over < _GIVEN_UP
        if not go_on.any():
            break
        whole, initial, over = whole.chosen(go_on), initial[go_on], over[go_on]
    if best is not None:
        return best
    assert least is not None
    return least[1]


def _shapes(rig: Rig, body: Body, limits: Limits) -> Batch:
    """Wrenches whose amplitudes, all in the same proportion, can be no larger than these.

    The unit of an amplitude is what the limits allow this sinusoid alone, were the body slow; forces and
    moments have several shares of it, for each axis its own or, as in the paper, equal ones.
    """
    k, force, moment, duration = [], [], [], rig.plan.duration
    for triple in _triples(limits, rig.plan):
        own = _alone(body, limits, np.array(triple), duration)
        for ratio in _RATIOS:
            f, n = own[:3] * min(1.0, ratio), own[3:] * min(1.0, 1.0 / ratio)
            for f0, n0 in ((f, n), (np.full(3, f.min()), np.full(3, n.min()))):
                k.append(triple)
                force.append(f0)
                moment.append(n0)
    return Batch(body, np.array(force), np.array(moment), np.array(k, dtype=np.int64), duration)


def _alone(body: Body, limits: Limits, k: Integers, duration: float) -> Array:
    """(6,) amplitude of each sinusoid at which it reaches a limit by itself."""
    rate = np.tile(2.0 * np.pi * k / duration, 2)
    skew = np.cross(np.eye(3), body.center_of_mass)  # rows e_i x c
    inverse = np.linalg.inv(body.inertia)
    linear = np.vstack([np.eye(3) / body.mass, np.zeros((3, 3))])
    acceleration = np.hstack([linear, np.vstack([-skew @ inverse.T, inverse.T])])  # (6 of w, 6 of a) per unit
    allowed = np.min(
        [limits.acceleration[None] + 0.0 * rate[:, None], limits.velocity * rate[:, None]]
        + [limits.upper * rate[:, None] ** 2],
        axis=0,
    )
    with np.errstate(divide="ignore"):
        alone = np.min(allowed / np.abs(acceleration), axis=1)
    return np.asarray(np.minimum(alone, limits.wrench))


def scaled(found: Sinusoids, factor: float) -> Sinusoids:
    """Other amplitudes, and the initial twist that goes with them."""
    w = found.wrench
    batch = Batch(found.body, factor * w.force[None], factor * w.moment[None], w.k[None], w.tau)
    initial = without_drift(batch, factor * found.initial[None])[0]
    wrench = WrenchSinusoids(batch.force[0], batch.moment[0], w.k, w.tau)
    return replace(found, wrench=wrench, initial=initial)


def _triples(limits: Limits, settings: PlanSpec) -> list[tuple[int, int, int]]:
    """Distinct integers about the frequency at which velocity and acceleration meet their limits together."""
    duration = settings.duration
    with np.errstate(invalid="ignore"):
        corners = limits.acceleration / limits.velocity / (2.0 * np.pi) * duration
    known = corners[np.isfinite(corners)]
    center = float(np.median(known)) if known.size else _DEFAULT_K
    center = round(min(center, settings.rate * duration / ROWS))  # what the table can follow
    lows = sorted({max(1, round(share * center) - 1) for share in (0.5, 0.8, 1.2)})
    return [(low + a, low + b, low + c) for low in lows for a, b, c in _OFFSETS]


def _used(rig: Rig, limits: Limits, batch: Batch, motions: Motions) -> Array:
    """(B,) largest use of any limit, at the steps of the integration."""
    body, nu, a = batch.body, motions.twist, motions.acceleration
    if rig.motion.of == "sensor":
        nu, a = (at_point(six, -body.center_of_mass) for six in (nu, a))
    step = motions.time[1]
    integral = cumulative_trapezoid(nu, dx=step, axis=0, initial=0)
    shares = [
        np.abs(nu) / limits.velocity,
        np.abs(a) / limits.acceleration,
        np.abs(np.gradient(a, step, axis=0)) / limits.jerk,
        np.abs(integral) / limits.upper,
        (np.concatenate([np.abs(batch.force), np.abs(batch.moment)], axis=1) / limits.wrench)[None],
    ]
    worst = np.max([share.max(axis=(0, 2)) for share in shares], axis=0)
    center = body.center_of_mass
    low, high = limits.workspace.T
    if np.isfinite(low).all():
        mass_at = center + motions.place
        sensor_at = mass_at - motions.rotation @ center
        for place in (sensor_at, mass_at):
            used = np.abs(2.0 * place - low - high) / (high - low)
            worst = np.maximum(worst, used.max(axis=(0, 2)))
    return np.where(np.isfinite(worst), worst, np.inf)


def _body(rig: Rig, payload: str) -> Body:
    spec = rig.payloads[payload]
    return Body(spec.mass, spec.center_of_mass_array, spec.inertia_matrix)


def facts_of(found: Sinusoids) -> dict[str, Any]:
    """What the wrench is, as PLAN.plan.yaml holds it."""
    w = found.wrench
    return {
        "force": w.force.tolist(),
        "moment": w.moment.tolist(),
        "k": w.k.tolist(),
        "tau": w.tau,
        "initial_twist": np.asarray(found.initial).tolist(),
    }
