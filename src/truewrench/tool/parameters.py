"""The parameters of an unknown tool, their order, and the turns and moments that they stand for.

    raw = C R w(body, motion) + b,     w with the sign of `sensor.feels`, at the sensor's origin

The body is stated in the axes of the sensor frame as the logged motion has them; R takes these to the axes
of the channels. theta = (gain row by row, log_mass, center_of_mass (3), S (6), offset (n), mounting (3),
tilt (2)).
"""

from dataclasses import dataclass

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.motion.spatial import cross
from truewrench.model.rig.sections import COLUMNS, ELEMENTS, ROWS, symmetric

__all__ = [
    "BELOW",
    "COLUMNS",
    "ELEMENTS",
    "ROWS",
    "Layout",
    "channel_turn",
    "inertia_of",
    "roll_pitch_yaw",
    "second_moments",
    "symmetric",
    "tilted",
]


_BODY = (
    "log_mass",
    *(f"center_of_mass_{axis}" for axis in "xyz"),
    *(f"S_{element}" for element in ELEMENTS),
)

BELOW = tuple(f"below_{name}" for name in _BODY)  # names of the ten of a body that a tool sits on


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the parameters of a tool on a sensor of n channels stand in theta and in its covariance."""

    n: int

    @property
    def gain(self) -> slice:
        """6n gains, row by row [raw units per N or N m]."""
        return slice(0, 6 * self.n)

    @property
    def log_mass(self) -> int:
        """The logarithm of the mass in kg."""
        return 6 * self.n

    @property
    def center_of_mass(self) -> slice:
        """Three [m]."""
        return slice(6 * self.n + 1, 6 * self.n + 4)

    @property
    def S(self) -> slice:
        """Six second moments per mass about the centre of mass, in the order of `ELEMENTS` [m^2]."""
        return slice(6 * self.n + 4, 6 * self.n + 10)

    @property
    def body(self) -> slice:
        """Log mass, centre of mass, S: ten."""
        return slice(6 * self.n, 6 * self.n + 10)

    @property
    def offset(self) -> slice:
        """One a channel [raw units]."""
        return slice(6 * self.n + 10, 7 * self.n + 10)

    @property
    def mounting(self) -> slice:
        """Roll, pitch, yaw [rad]."""
        return slice(7 * self.n + 10, 7 * self.n + 13)

    @property
    def tilt(self) -> slice:
        """Of gravity, about two axes of the root frame (`tilted`) [rad]."""
        return slice(7 * self.n + 13, 7 * self.n + 15)

    @property
    def size(self) -> int:
        """7n + 15."""
        return 7 * self.n + 15

    @property
    def names(self) -> tuple[str, ...]:
        """One name a parameter: `gain_0_0` ... (channel, wrench axis), `log_mass`, ..., `tilt_1`."""
        return (
            *(f"gain_{i}_{j}" for i in range(self.n) for j in range(6)),
            *_BODY,
            *(f"offset_{i}" for i in range(self.n)),
            *(f"mounting_{angle}" for angle in ("roll", "pitch", "yaw")),
            "tilt_0",
            "tilt_1",
        )

    @property
    def below(self) -> slice:
        """Ten of a body that this one sits on, where there is one: they come last."""
        return slice(self.size, self.size + 10)


def _elements(matrix: Array) -> Array:
    return np.asarray(matrix[ROWS, COLUMNS])


def inertia_of(mass: float, S: Array) -> Array:
    """(6,) elements of the inertia about the centre of mass, m (tr S E - S) [kg m^2], of (6,) S [m^2]."""
    moments = symmetric(S)
    return _elements(mass * (np.trace(moments) * np.eye(3) - moments))


def second_moments(mass: float, inertia: Array) -> Array:
    """(6,) S = (tr I / 2 E - I) / m [m^2] of (6,) elements of the inertia about the centre of mass."""
    tensor = symmetric(inertia)
    return _elements((0.5 * np.trace(tensor) * np.eye(3) - tensor) / mass)


def channel_turn(mounting: Array) -> tuple[Array, Array]:
    """R (3, 3), which takes vectors from sensor axes to those of the channels, and (3, 3, 3) its derivatives.

    R^T = Rz(yaw) Ry(pitch) Rx(roll): the channels' axes in the sensor frame. The mounting is (3,) roll,
    pitch, yaw [rad], about fixed axes x, then y, then z, by which the derivatives are.
    """
    (a, b, c), (s, t, u) = np.cos(mounting), np.sin(mounting)
    X = np.array([[1, 0, 0], [0, a, -s], [0, s, a]])
    Y = np.array([[b, 0, t], [0, 1, 0], [-t, 0, b]])
    Z = np.array([[c, -u, 0], [u, c, 0], [0, 0, 1]])
    dX = np.array([[0, 0, 0], [0, -s, -a], [0, a, -s]])
    dY = np.array([[-t, 0, b], [0, 0, 0], [-b, 0, -t]])
    dZ = np.array([[-u, -c, 0], [c, -u, 0], [0, 0, 0]])
    return (Z @ Y @ X).T, np.array([(Z @ Y @ dX).T, (Z @ dY @ X).T, (dZ @ Y @ X).T])


def roll_pitch_yaw(R: Array) -> Array:
    """The mounting (3,) whose `channel_turn` is R."""
    S = R.T
    return np.array(
        [np.arctan2(S[2, 1], S[2, 2]), np.arcsin(np.clip(-S[2, 0], -1.0, 1.0)), np.arctan2(S[1, 0], S[0, 0])]
    )


def tilted(gravity: Array, tilt: Array) -> tuple[Array, Array]:
    """Free fall in the root frame turned by two small angles, and its derivative (3, 2) by them.

    The axes are normal to gravity; the second is the first turned by a right angle about it. The same as
    the core's.
    """
    size = float(np.linalg.norm(gravity))
    if size == 0.0:
        return np.zeros(3), np.zeros((3, 2))
    e1 = cross(gravity, np.eye(3)[int(np.argmin(np.abs(gravity)))])
    e1 /= np.linalg.norm(e1)
    axes = np.column_stack([cross(e1, gravity), cross(cross(gravity, e1), gravity) / size])
    x = gravity + axes @ tilt
    square = float(x @ x)
    ratio = size / np.sqrt(square)
    return ratio * x, ratio * (axes - np.outer(x, x @ axes) / square)
