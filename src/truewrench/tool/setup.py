"""Which mistake of the set-up explains poses that do not fit: sign, axes, frame, inverse attitude.

Asked only where something does not fit. A walk of the offset that is fast enough swallows any mistake, so the
recipe with a fixed offset judges: the reading as stated against the same with one mistake undone.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np

from truewrench.estimation.static_poses import Poses, attitudes
from truewrench.model.arrays import Array
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.attitude import attitude_at, free_fall
from truewrench.tool.motion import measured_motions, on_rows, regressor
from truewrench.tool.recipe import Recipe, recipe

_FITS = 0.5  # of what is left as stated: an explanation leaves less
_CLEAR = 5.0  # of what is left, by RMS, from which on a weight stands out of it
_FEWEST = 6  # poses
_IN_ROOT = (
    "The wrench fits when turned from the root's axes to the sensor's: log the sensor's own channels, not "
    "what a driver has turned to the base (as `actual_TCP_force` of Universal Robots)."
)


def mistakes(rig: Rig, poses: Poses, gain_std: float) -> list[str]:
    """The likeliest mistake in words; none where no mistake explains the poses better than what is stated."""
    if len(poses) < _FEWEST or not rig.in_gravity:
        return []
    stated = recipe(rig, poses, np.arange(len(poses)))
    if stated.mass < 0.0 and _clear(rig, stated):
        return [_gains(2.0 / gain_std)]
    least = _FITS * _left(rig, stated)
    around = replace(poses, R_sensor_root=poses.R_sensor_root.transpose(0, 2, 1))
    found: list[tuple[float, str]] = []
    turned = recipe(rig, around, np.arange(len(poses)))
    if abs(turned.mass) > 0.0 and _left(rig, turned) < least:
        words = "The attitudes fit when taken the other way round (sensor to root, or root to sensor)."
        found.append((_left(rig, turned), words))
    raw = _to_sensor(rig, poses.raw, poses.R_sensor_root)
    own = recipe(rig, replace(poses, raw=raw), np.arange(len(poses)))
    if own.mass > 0.0 and _left(rig, own) < least:
        found.append((_left(rig, own), _IN_ROOT))
    back = np.linalg.pinv(rig.sensor.nominal_gain_array)
    for turn in _TURNS:
        six = np.kron(np.eye(2), turn)
        raw = poses.raw @ back.T @ six.T @ rig.sensor.nominal_gain_array.T
        fit = recipe(rig, replace(poses, raw=raw), np.arange(len(poses)))
        if fit.mass > 0.0 and _left(rig, fit) < least:
            found.append((_left(rig, fit), _gains(float(np.abs(six - np.eye(6)).max()) / gain_std)))
    return [min(found)[1]] if found else []


def mistakes_of_motion(rig: Rig, logs: Sequence[Log], gain_std: float) -> list[str]:
    """The same of a motion, by least squares on differentiated velocities; a subtracted weight, too."""
    stated = _moved(rig, logs)
    if stated is None or not rig.in_gravity:
        return []
    left, mass = stated
    found: list[tuple[float, str]] = []

    def ask(words: str, tried: tuple[float, float] | None) -> None:
        if tried is None or tried[1] <= 0.0:
            return
        # noise is in what is left of either: a weight that stands out of it speaks, too
        shown = tried[0] < left and _felt(rig, *tried) and not _felt(rig, *stated)
        if shown or tried[0] < _FITS * left:
            found.append((tried[0], words))

    ask(
        "The motion fits a tool whose weight is not felt: a weight already subtracted.",
        _moved(rig, logs, weightless=True),
    )
    if all(log.attitude is not None for log in logs):
        around = [_around(rig, log) for log in logs]
        words = "The attitudes fit when taken the other way round (sensor to root, or root to sensor)."
        ask(words, _moved(rig, around))
    own = [_of_sensor(rig, log) for log in logs]
    if all(log is not None for log in own):
        ask(_IN_ROOT, _moved(rig, [log for log in own if log is not None]))
    for turn in _TURNS:
        six = np.kron(np.eye(2), turn)
        words = _gains(float(np.abs(six - np.eye(6)).max()) / gain_std)
        ask(words, _moved(rig, logs, turn=lambda w, six=six: w @ six.T))  # type: ignore[misc]
    if not found and mass < 0.0 and _felt(rig, left, mass):
        return [_gains(2.0 / gain_std)]
    return [min(found)[1]] if found else []


def _felt(rig: Rig, left: float, mass: float) -> bool:
    """Whether a weight stands out of what is left, fraction of range, as in poses."""
    span = float(np.sqrt(np.mean(rig.sensor.range_array[:3] ** 2)))
    return abs(mass) * float(np.linalg.norm(rig.gravity_array)) > _CLEAR * left * span


_TURNS = [
    turn
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
    if not np.array_equal(turn := np.eye(3)[list(order)] * np.array(signs)[:, None], np.eye(3))
]


def _around(rig: Rig, log: Log) -> Log:
    """The log with its attitudes taken the other way round."""
    assert log.attitude is not None
    attitude = log.attitude * np.array([1.0, -1.0, -1.0, -1.0])
    return replace(log, attitude=attitude, gravity=free_fall(rig, attitude))


def _of_sensor(rig: Rig, log: Log) -> Log | None:
    """The log with channels turned from root axes to the sensor's; None where no attitude is told."""
    R_sensor_root = attitudes(rig, log)
    known = np.isfinite(R_sensor_root[:, 0, 0])
    if not known.any():
        return None
    turn = attitude_at(log.time[known], R_sensor_root[known], log.time)
    return replace(log, raw=_to_sensor(rig, log.raw, turn))


def _to_sensor(rig: Rig, raw: Array, R_sensor_root: Array) -> Array:
    """Channels (T, n) of a wrench in root axes as they would be in sensor axes, by the nominal gain."""
    gain = rig.sensor.nominal_gain_array
    parts = (raw @ np.linalg.pinv(gain).T).reshape(-1, 2, 3)
    turned = np.einsum("tij,tkj->tki", R_sensor_root, parts).reshape(-1, 6)
    return np.asarray(turned @ gain.T)


def _moved(
    rig: Rig,
    logs: Sequence[Log],
    *,
    weightless: bool = False,
    turn: Callable[[Array], Array] | None = None,
) -> tuple[float, float] | None:
    """RMS of what a rigid body leaves, fraction of range, and its mass; None where little moves."""
    rows, target = [], []
    back = np.linalg.pinv(rig.sensor.nominal_gain_array)
    for k, log in enumerate(logs):
        for at, nu, a, g in measured_motions(rig, log):
            w = rig.sensor.sign * on_rows(log, log.raw, at) @ back.T
            known = np.isfinite(np.column_stack([w, g])).all(axis=1)
            w = w[known] if turn is None else turn(w[known])
            Y = regressor(nu[known], a[known], 0.0 * g[known] if weightless else g[known])
            own = np.zeros((len(Y), 6, 6 * len(logs)))
            own[:, :, 6 * k : 6 * k + 6] = np.eye(6)
            weight = 1.0 / rig.sensor.range_array
            both = np.concatenate([Y, own], axis=2) * weight[:, None]
            step = max(1, len(Y) // 500)
            rows.append(both[::step].reshape(-1, both.shape[2]))
            target.append((w * weight)[::step].ravel())
    if not rows:
        return None
    A, b = np.vstack(rows), np.concatenate(target)
    x = np.linalg.lstsq(A, b, rcond=1e-10)[0]
    return float(np.sqrt(np.mean((b - A @ x) ** 2))), float(x[0])


def _gains(sigmas: float) -> str:
    return (
        f"The gains would have to be {sigmas:.0f} of their stated sigma away: sign, axes or units of the log "
        "are not as stated."
    )


def _left(rig: Rig, fit: Recipe) -> float:
    return float(np.sqrt(np.mean((fit.residual / rig.sensor.range_array) ** 2)))


def _clear(rig: Rig, fit: Recipe) -> bool:
    """Whether the weight stands out of what is left."""
    weight = abs(fit.mass) * float(np.linalg.norm(rig.gravity_array))
    return weight > _CLEAR * float(np.sqrt(np.mean(fit.residual[:, :3] ** 2)))
