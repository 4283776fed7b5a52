"""How far a motion is from one frequency a coordinate, where what follows the pose passes for gain.

Of a coordinate with velocities sum_k a_k cos(k w t) + b_k sin(k w t), c_k^2 = a_k^2 + b_k^2, the R^2 of its
position on its own acceleration is

    r = ( sum c_k^2 )^2 / ( sum c_k^2 / k^2  sum c_k^2 k^2 ),

1 where it has one frequency: position is then minus acceleration. Without a price on it the best motions have
one in some coordinates, for a fraction of a percent of sigma.
"""

import numpy as np

from truewrench.model.arrays import Array
from truewrench.model.rig import Rig
from truewrench.planning.series import SeriesBasis

_SLACK = 0.05  # the price of one frequency is log(1 / slack), and finite
_AUTO = 0.02  # costs 0.8 % of sigma where the payload of [A00] flies free, and takes A from 0.87 to 0.47
_STATED = 0.2  # 7 % there; no coordinate is then left with one frequency
_STILL = 1e-12  # sum of squares of a coordinate that does not move


def spread_weight(rig: Rig) -> float:
    """What one frequency costs: nothing where the rig states that nothing follows the pose."""
    stated = rig.sensor.discrepancy
    if stated == "auto":
        return _AUTO
    return _STATED if stated > 0.0 else 0.0


class Spread:
    """Mean over the coordinates of -log(1 + slack - r), with derivatives, of coefficients (n, m) row by row.

    Coordinates that do not move cost nothing.
    """

    def __init__(self, basis: SeriesBasis, n: int) -> None:
        # the coefficients' powers at every harmonic, weighted with k^-2, 1, k^2: r has no unit of time
        period = basis.period
        time = np.linspace(0.0, period, 4 * basis.harmonics + 4, endpoint=False)
        rate = 2.0 * np.pi / period
        tables = [rate ** (1 - d) * basis.table(time, d) for d in range(3)]
        tables[0] = tables[0] - tables[0].mean(axis=0)
        self._forms = [table.T @ table / len(time) for table in tables]
        self._n, self._m = n, basis.size

    def __call__(self, coefficients: Array) -> float:
        """The price."""
        total = 0.0
        for c in coefficients.reshape(self._n, self._m):
            p, v, q = (float(c @ form @ c) for form in self._forms)
            total -= np.log(1.0 + _SLACK - v * v / (p * q)) if p > _STILL else np.log(1.0 + _SLACK)
        return total / self._n

    def derivatives(self, coefficients: Array) -> tuple[Array, Array]:
        """Gradient (n m,) and Hessian (n m, n m)."""
        gradient, hessian = np.zeros(coefficients.size), np.zeros((coefficients.size,) * 2)
        for j, c in enumerate(coefficients.reshape(self._n, self._m)):
            power = [float(c @ form @ c) for form in self._forms]
            if power[0] <= _STILL:
                continue
            # log r = 2 log v - log p - log q
            slope, curvature = np.zeros(self._m), np.zeros((self._m,) * 2)
            for factor, form, x in zip((-1.0, 2.0, -1.0), self._forms, power, strict=True):
                first = 2.0 * form @ c / x
                slope += factor * first
                curvature += factor * (2.0 * form / x - np.outer(first, first))
            r = power[1] ** 2 / (power[0] * power[2])
            left = 1.0 + _SLACK - r
            at = slice(j * self._m, (j + 1) * self._m)
            gradient[at] = r * slope / left / self._n
            bent = r * (np.outer(slope, slope) + curvature) / left
            hessian[at, at] = (bent + np.outer(r * slope, r * slope) / left**2) / self._n
        return gradient, hessian
