"""What follows the pose, and a delay: how much of either a motion can hide in the gain (docs/method.md).

Misfit that lies in the span of the wrench is taken for gain and leaves nothing in the residuals. A cable's
pull follows the pose; where every axis moves at one frequency the pose is minus the acceleration, and the
cable's stiffness IS a gain. Wrenches are normalised throughout: over the range of their axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from truewrench.model.arrays import Array
from truewrench.model.calibration_parts import BlindTo

FORCE = 1e-3  # fraction of range: the force that follows the pose whose effect is told
DELAY = 1e-3  # [s] whose effect is told
HIDDEN_DELAY = 0.9
"""Share of what a delay does to the raw channels, from which on the gain is said to hide it."""

_STILL = 1e-6  # [m, rad] a component of the pose with a smaller standard deviation does not move
_TURNS = 1.0  # [rad] about the mean, beyond which the components of the twist are not integrated one by one
_RANK = 1e-10  # of singular values, relative to the largest: a tolerance


@dataclass(frozen=True, slots=True, eq=False)
class PoseShare:
    """How much of the pose a motion can hide, and how much it excites."""

    # A, mean R^2 of the components of the pose that move on (w, 1); 1 where none moves: at rest the pose is
    # the wrench
    share: float
    moment: Array  # (6, 6) E w w^T, w normalised

    @property
    def unit_covariance(self) -> Array:
        """A / (1 - A) (E w w^T)^-1 / 6 (6, 6), of (10.10): of a row of C, for a force of unit size."""
        value, vector = np.linalg.eigh(self.moment)
        value = np.maximum(value, _RANK * max(float(value[-1]), np.finfo(np.float64).tiny))
        leverage = self.share / max(1.0 - self.share, _RANK)
        return np.asarray((vector * (leverage / value / 6.0)) @ vector.T)


@dataclass(frozen=True, slots=True, eq=False)
class DelayShare:
    """What a small delay tau of the sensor looks like: raw changes by -tau C dw/dt."""

    share: float  # R^2 of dw/dt on (w, 1), all axes together
    slope: Array  # (6, 6) M of the regression dw/dt = M w + const [1/s]: the gain moves by -tau C M


def pose_share(time: Array, twist: Array, wrench: Array) -> PoseShare:
    """A of (10.10) and E w w^T of one gap-free record: its twist (N, 6) and normalised wrench (N, 6)."""
    return pooled_pose_share([pose_of_twist(time, twist)], [wrench])


def pooled_pose_share(poses: Sequence[Array], wrenches: Sequence[Array]) -> PoseShare:
    """The same of several records, poses (N, 6) [m, rad] and normalised wrenches at the same samples.

    Each has a mean pose and an offset of its own.
    """
    w = np.concatenate(wrenches)
    pose = np.concatenate([_centred(x) for x in poses])
    share = 1.0
    moving = np.std(pose, axis=0) > _STILL if len(pose) else np.zeros(6, dtype=np.bool_)
    if moving.any():
        basis = _basis(np.concatenate([_centred(x) for x in wrenches]))
        moved = pose[:, moving]
        share = float(np.mean(np.sum((basis.T @ moved) ** 2, axis=0) / np.sum(moved**2, axis=0)))
    return PoseShare(min(share, 1.0), w.T @ w / max(len(w), 1))


def pose_of_twist(time: Array, twist: Array) -> Array:
    """Pose (N, 6) about its mean [m, rad]: the integral of the twist (N, 6) in sensor axes by component.

    A body that turns by more than a radian about its mean has a position and a rotation vector instead.
    """
    pose = _centred(cumulative_trapezoid(twist, time, axis=0, initial=0))
    if len(pose) and np.linalg.norm(pose[:, 3:], axis=1).max() > _TURNS:
        rotation = _attitude(time, twist[:, 3:])
        velocity = np.einsum("kij,kj->ki", rotation, twist[:, :3])
        return pose_about_mean(cumulative_trapezoid(velocity, time, axis=0, initial=0), rotation)
    return pose


def pose_about_mean(position: Array, rotation: Array) -> Array:
    """Position and rotation vector (N, 6) about the mean pose [m, rad].

    The rotation (N, 3, 3) turns sensor axes into those of the position (N, 3) [m].
    """
    turned = Rotation.from_matrix(rotation)
    return np.column_stack([_centred(position), (turned.mean().inv() * turned).as_rotvec()])


def delay_share(time: Array, wrench: Array) -> DelayShare:
    """What a delay looks like in one gap-free record; arguments as for `pose_share`."""
    return pooled_delay_share([np.gradient(wrench, time, axis=0)], [wrench])


def pooled_delay_share(rates: Sequence[Array], wrenches: Sequence[Array]) -> DelayShare:
    """The same of several records, from dw/dt (N, 6) [1/s] and w (N, 6) of each."""
    rate, w = (np.concatenate([_centred(x) for x in rows]) for rows in (rates, wrenches))
    total = float(np.sum(rate**2))
    if not total > 0.0:
        return DelayShare(0.0, np.zeros((6, 6)))
    slope = np.linalg.lstsq(w, rate, rcond=_RANK)[0].T
    return DelayShare(1.0 - float(np.sum((rate - w @ slope.T) ** 2)) / total, slope)


def blind_to(
    pose: PoseShare,
    delay: DelayShare,
    *,
    gain: Array | None = None,
    ceiling: float = np.inf,
) -> tuple[BlindTo, ...]:
    """What would move some gain and leave no trace.

    A delay is named where the normalised gain (n, 6), the identity if left out, hides most of it: elsewhere
    the data show it. Nothing moves a gain beyond `ceiling`, 1 sigma that is known of it beforehand.
    """
    # (10.10): f sqrt( largest diagonal of A / (1 - A) (E w w^T)^-1 / 6 )
    effect = min(FORCE * float(np.sqrt(np.diag(pose.unit_covariance).max())), ceiling)
    found = [
        BlindTo(
            "cable",
            FORCE,
            effect,
            f"a force of {100 * FORCE:.2g} % of range that follows the pose (a cable) would move some gain "
            f"by {100 * effect:.2g} % and leave no trace: the motion can hide {100 * pose.share:.0f} % of "
            "its pose",
        )
    ]
    if delay.share >= HIDDEN_DELAY:
        moved = delay.slope if gain is None else gain @ delay.slope
        effect = min(DELAY * float(np.abs(moved).max()), ceiling)
        found.append(
            BlindTo(
                "delay",
                DELAY,
                effect,
                f"a delay of {1e3 * DELAY:.2g} ms between sensor and motion would move some gain by "
                f"{100 * effect:.2g} % and leave no trace: {100 * delay.share:.0f} % of it looks like a gain",
            )
        )
    return tuple(found)


def with_pose(covariance: Array, pose: PoseShare, size: Array, prior: Array) -> Array:
    """The covariance of the gain with what may follow the pose unseen, (10.10); none rises above its prior.

    Covariance (6n, 6n) and prior variance (6n,) are of the normalised gain, row by row; `size` (n,) is 1
    sigma of the force in every channel, fraction of range.
    """
    added = np.kron(np.diag(size**2), pose.unit_covariance)
    room = np.maximum(prior - np.diag(covariance), 0.0)
    most = np.diag(added)
    # g_i^2 = min(1, (Pi_i - P_i) / added_i): clipping the sum instead makes some directions narrower
    g = np.sqrt(np.minimum(1.0, room / np.maximum(most, np.finfo(np.float64).tiny)))
    return np.asarray(covariance + added * np.outer(g, g))


def _centred(values: Array) -> Array:
    return np.asarray(values - values.mean(axis=0)) if len(values) else values


def _attitude(time: Array, omega: Array) -> Array:
    """R (N, 3, 3) from sensor axes to those of the first sample; between samples the mean of Omega holds."""
    steps = 0.5 * (omega[1:] + omega[:-1]) * np.diff(time)[:, None]
    turned = Rotation.from_rotvec(np.concatenate([np.zeros((1, 3)), steps])).as_quat()
    reach = 1
    while reach < len(turned):  # every row then holds the product of its last 2 reach steps
        later = Rotation.from_quat(turned[:-reach]) * Rotation.from_quat(turned[reach:])
        turned = np.concatenate([turned[:reach], later.as_quat()])
        reach *= 2
    return np.asarray(Rotation.from_quat(turned).as_matrix())


def _basis(columns: Array) -> Array:
    """Orthonormal columns that span the given ones."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > _RANK * size[0]]) if size.size and size[0] > 0.0 else left[:, :0]
