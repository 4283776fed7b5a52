"""What is known together: a normal distribution whose parts have names, and what others tell of some."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from truewrench.model.arrays import Array, Integers

EXACT = 1e-9  # of a unit: 1 sigma that holds a parameter
_NOTHING = 1e-17  # variance of one that is exact


def explained(covariance: Array, gains: int, at: Iterable[int]) -> Array:
    """What the others at some places account for of the variance of the first `gains` parameters.

    That is K P_vv K^T, K = P_gv P_vv^-1, of the covariance of all; those that are exact explain nothing.
    """
    known = [k for k in sorted(at) if covariance[k, k] > _NOTHING]
    if not known:
        return np.zeros(gains)
    inner, cross = covariance[np.ix_(known, known)], covariance[:gains, known]
    scale = np.sqrt(np.diag(inner))
    K = np.linalg.lstsq(inner / scale / scale[:, None], (cross / scale).T, rcond=1e-12)[0].T
    return np.asarray(np.einsum("ij,ij->i", K, cross / scale))


def body_part(payload: str) -> str:
    """The part that holds logarithm of the mass and centre of mass [m] of a payload."""
    return f"body {payload}"


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """N(mean, covariance) of parts that are called by name."""

    places: Mapping[str, slice]  # of each part
    mean: Array  # (p,)
    covariance: Array  # (p, p)

    @staticmethod
    def of_parts(parts: Mapping[str, Array], covariance: Array) -> Joint:
        """Of the mean of each part, in the order of the covariance."""
        places, start = {}, 0
        for name, mean in parts.items():
            places[name] = slice(start, start + len(mean))
            start += len(mean)
        return Joint(places, np.concatenate(list(parts.values())), covariance)

    def at(self, names: Sequence[str]) -> Integers:
        """Places of some parts, one part after the other."""
        none = np.zeros(0, np.int64)
        return np.concatenate(
            [none, *(np.arange(self.places[name].start, self.places[name].stop) for name in names)]
        )

    def of(self, names: Sequence[str]) -> tuple[Array, Array]:
        """Mean and covariance of some parts."""
        at = self.at(names)
        return self.mean[at], self.covariance[np.ix_(at, at)]

    def told(
        self, known: Sequence[str], mean: Array, covariance: Array, new: Mapping[str, int] | None = None
    ) -> Joint:
        """The same once others have told more of some parts, and of new ones with them.

        Mean and covariance are those of the `known` parts, then of the `new` ones, whose sizes are given. The
        rest is tied to the known parts by y = K x + what does not depend on x, K = P_yx P_xx^-1, which stays;
        through it the new parts hang together with the rest.
        """
        at = self.at(known)
        count = at.size
        P = self.covariance[np.ix_(at, at)]
        scale = np.sqrt(np.diag(P))
        K = np.linalg.solve(P / np.outer(scale, scale), self.covariance[at] / scale[:, None]).T / scale
        K[at] = np.eye(count)
        rest = self.covariance - K @ P @ K.T
        rest[at], rest[:, at] = 0.0, 0.0
        own = rest + K @ covariance[:count, :count] @ K.T
        cross = K @ covariance[:count, count:]
        whole = np.block([[own, cross], [cross.T, covariance[count:, count:]]])
        places = dict(self.places)
        start = self.mean.size
        for name, size in (new or {}).items():
            places[name] = slice(start, start + size)
            start += size
        moved = self.mean + K @ (mean[:count] - self.mean[at])
        return Joint(places, np.append(moved, mean[count:]), 0.5 * (whole + whole.T))
