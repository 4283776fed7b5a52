"""What a motion tells of the gain when it is known: what is minimised (docs/method.md, (M16))."""

from collections import Counter
from typing import Any, Literal

import casadi as ca
import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.rig import Rig
from truewrench.planning.buffered import Buffered

PACKED = np.tril_indices(7)  # elements of the mean of [w; 1][w; 1]^T that are kept, w over the range


def packed(wrench: Array) -> Array:
    """(28,) mean of [w; 1][w; 1]^T over the rows of normalised wrenches (K, 6), its lower triangle."""
    rows = np.column_stack([wrench, np.ones(len(wrench))])
    return np.asarray((rows.T @ rows / len(rows))[PACKED])


class Criterion:
    """Logarithm of the predicted sigma, as a function of the mean of [w; 1][w; 1]^T, with derivatives.

    A: of the RMS sigma of the normalised gains, from the trace of their covariance. D: of the geometric mean
    of sigma along its principal axes, from its determinant. Offsets, where the rig has them, are unknown as
    well; priors are the rig's.
    """

    def __init__(self, rig: Rig, samples: float, kind: Literal["A", "D"]) -> None:
        sensor = rig.sensor
        noise = sensor.noise_array / sensor.channel_scale
        offset = sensor.offset_prior_array / sensor.channel_scale
        moments = ca.SX.sym("moments", PACKED[0].size)
        matrix = [[0.0] * 7 for _ in range(7)]
        for element, i, j in zip(ca.vertsplit(moments), *(x.tolist() for x in PACKED), strict=True):
            matrix[i][j] = matrix[j][i] = element
        total = 0.0
        channels = Counter((float(s), float(o)) for s, o in zip(noise, offset, strict=True))
        for (sigma, prior), count in channels.items():
            size = 7 if prior > 0.0 else 6
            information = [[samples / sigma**2 * matrix[i][j] for j in range(size)] for i in range(size)]
            for i in range(size):
                information[i][i] += (sensor.gain_prior if i < 6 else prior) ** -2.0
            total += count * (
                _trace_of_inverse(information) if kind == "A" else _log_determinant(information)
            )
        of_gains = total / (6 * sensor.n)
        value = 0.5 * ca.log(of_gains) if kind == "A" else -0.5 * of_gains
        hessian, gradient = ca.hessian(value, moments)
        both = [ca.densify(gradient), ca.densify(hessian)]
        self._value = Buffered(ca.Function("criterion", [moments], [value]))
        self._derivatives = Buffered(ca.Function("derivatives", [moments], [value, *both]))

    def __call__(self, moments: Array) -> float:
        """Value for the mean of [w; 1][w; 1]^T, packed (28,)."""
        return float(self._value(moments)[0].item())

    def derivatives(self, moments: Array) -> tuple[float, Array, Array]:
        """Value, gradient (28,) and Hessian (28, 28)."""
        value, gradient, hessian = self._derivatives(moments)
        return float(value.item()), gradient.ravel(), hessian


def _factor(matrix: list[list[Any]]) -> tuple[list[list[Any]], list[Any]]:
    """L and D of L D L^T; the matrix is positive definite, thanks to its priors."""
    n = len(matrix)
    lower: list[list[Any]] = [[0.0] * n for _ in range(n)]
    pivots: list[Any] = [0.0] * n
    for j in range(n):
        pivots[j] = matrix[j][j] - sum(lower[j][k] ** 2 * pivots[k] for k in range(j))
        for i in range(j + 1, n):
            rest = sum(lower[i][k] * lower[j][k] * pivots[k] for k in range(j))
            lower[i][j] = (matrix[i][j] - rest) / pivots[j]
    return lower, pivots


def _trace_of_inverse(information: list[list[Any]]) -> Any:
    """Trace of the first six rows and columns of the inverse."""
    lower, pivots = _factor(information)
    trace: Any = 0.0
    for column in range(6):
        solved: list[Any] = [0.0] * len(pivots)
        for i in range(column, len(pivots)):
            known = sum(lower[i][k] * solved[k] for k in range(column, i))
            solved[i] = (1.0 if i == column else 0.0) - known
            trace += solved[i] ** 2 / pivots[i]
    return trace


def _log_determinant(information: list[list[Any]]) -> Any:
    """Log determinant of the information on the first six, the seventh eliminated."""
    size = len(information)
    last_first = (
        [[information[i - 1][j - 1] for j in range(size)] for i in range(size)] if size == 7 else information
    )
    _, pivots = _factor(last_first)
    return sum(ca.log(pivot) for pivot in pivots[size - 6 :])
