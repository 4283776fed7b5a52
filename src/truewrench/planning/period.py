"""How long one period of a planned motion is, and how fast it typically gets."""

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.errors import InputError
from truewrench.model.rig import Rig
from truewrench.planning.limits import SMALLEST, Limits
from truewrench.planning.series import SeriesBasis

_SPEED = 1.0  # [m/s, rad/s] where nothing is said
ROWS = 20.0  # of the table per period of the highest harmonic: a quintic spline then follows it to 1e-6


def check_harmonics(rig: Rig) -> None:
    """Refuse series that cannot rest at both ends, and tables too coarse for them."""
    plan = rig.plan
    if plan.rest_to_rest and plan.harmonics < 2:
        raise InputError.at(rig.path, "plan.harmonics", "1", "at least 2, to start and end at rest")
    highest = plan.harmonics / plan.duration
    if plan.rate < ROWS * highest:
        expected = f"at least {ROWS * highest:.4g} Hz: {ROWS:g} rows per period of the highest harmonic"
        raise InputError.at(rig.path, "plan.rate", f"{plan.rate:g}", expected)


def cycles_of(rig: Rig, limits: Limits) -> int:
    """How often a motion repeats itself in its duration.

    The highest harmonic is to have the frequency at which a sinusoid reaches the limits of velocity and
    acceleration, or of acceleration and jerk, together: below it acceleration is given away, and above it
    velocity. A plan of an hour is then a motion of seconds, many times.
    """
    plan = rig.plan
    with np.errstate(invalid="ignore"):
        corners = np.minimum(limits.acceleration / limits.velocity, limits.jerk / limits.acceleration) / (
            2.0 * np.pi
        )
    known = corners[np.isfinite(corners) & (corners > 0.0) & (limits.velocity > SMALLEST)]
    if not known.size:
        return 1
    highest = min(float(np.median(known)), plan.rate / ROWS)
    return max(1, int(np.floor(plan.duration * highest / plan.harmonics + 0.5)))


def plan_rows(rig: Rig) -> Array:
    """Times of the rows of a plan, both ends included [s]."""
    return np.linspace(0.0, rig.plan.duration, 1 + max(6, round(rig.plan.duration * rig.plan.rate)))


def typical_velocity(limits: Limits, basis: SeriesBasis) -> Array:
    """(n,) what the limits leave of the velocity at the middle of the spectrum."""
    rate = np.pi * basis.harmonics / basis.period
    room = 0.5 * (limits.upper - limits.lower)
    bounds = [limits.velocity, limits.acceleration / rate, limits.jerk / rate**2, room * rate]
    smallest = np.min([*bounds, np.full(limits.velocity.size, _SPEED)], axis=0)
    return np.asarray(smallest / np.sqrt(basis.harmonics))
