"""What the uncertainty of a gain is made of, and what would make it smaller (docs/method.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["NOISE", "Sources"]

Array = NDArray[np.float64]

NOISE = "noise"
_SMALLEST = 1e-6  # factor on a prior or on the noise that is looked for
_STEPS = 60  # of the bisection


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """Variance of the normalised gain, split into noise and what is uncertain of payload and clock.

    P_gg = P_g|nu + K P_nu K^T with K = P_g,nu P_nu^-1: neither P_g|nu nor K depends on the priors of nu, and
    P_nu^-1 is what the data say of nu plus these priors.

    Attributes:
        noise: (6n,) variance with payload and clock known.
        gain_prior: 1 sigma of every gain beforehand.
        sensitivity: (6n, m) K, per prior sigma.
        covariance: (m, m) P_nu, per prior sigma.
        groups: which of the m belong to mass, center_of_mass, inertia, timing.
        bent: (6n,) variance beyond the first order, by an uncertain payload.
        bent_alone: (6n,) of it that each source alone accounts for.
    """

    noise: Array
    gain_prior: float
    sensitivity: Array
    covariance: Array
    groups: Mapping[str, Sequence[int]] = field(default_factory=dict)
    bent: Array | None = None
    bent_alone: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        covariance: Array,
        gains: int,
        groups: Mapping[str, Sequence[int]],
        prior: Array,
        gain_prior: float,
    ) -> Sources:
        """Split the covariance of all common parameters.

        Args:
            covariance: (p, p), the gains first.
            gains: 6n.
            groups: indices among the p parameters by source.
            prior: (p,) 1 sigma of every parameter beforehand.
            gain_prior: 1 sigma of every gain beforehand.
        """
        uncertain = [k for group in groups.values() for k in group]
        total = covariance[:gains, :gains].diagonal()
        if not uncertain:
            none = np.zeros((gains, 0))
            return cls(np.array(total), gain_prior, none, np.zeros((0, 0)))
        inner = covariance[np.ix_(uncertain, uncertain)] / np.outer(prior[uncertain], prior[uncertain])
        cross = covariance[uncertain, :gains] / prior[uncertain, None]
        sensitivity = np.asarray(np.linalg.solve(inner, cross).T, dtype=np.float64)
        explained = np.einsum("ij,jk,ik->i", sensitivity, inner, sensitivity)
        return cls(
            np.asarray(np.maximum(total - explained, 0.0), dtype=np.float64),
            gain_prior,
            sensitivity,
            np.asarray(inner),
            {name: [uncertain.index(k) for k in group] for name, group in groups.items()},
        )

    def sigma(self) -> dict[str, Array]:
        """1 sigma (n, 6) of the normalised gain that each source alone accounts for."""
        found = {NOISE: np.sqrt(self.noise).reshape(-1, 6)}
        for name, at in self.groups.items():
            part = self.sensitivity[:, at]
            variance = np.einsum("ij,jk,ik->i", part, self.covariance[np.ix_(at, at)], part)
            variance += self.bent_alone.get(name, 0.0)
            found[name] = np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 6)
        return found

    def remedy(self, gains: NDArray[np.bool_], target: float) -> dict[str, float]:
        """What takes the sigma of every gain to a target: the largest sources, down to one level.

        Args:
            gains: (6n,) those that count.
            target: 1 sigma, below that of one of them at present.

        Returns:
            The factor on the prior sigma of each source that has to become smaller, the largest source first;
            noise falls by it in a record 1 / factor^2 times as long.
        """
        share = {name: float(sigma.ravel()[gains].max()) for name, sigma in self.sigma().items()}
        largest = max(share.values())

        def factors(level: float) -> dict[str, float]:
            return {name: level / s if s > level else 1.0 for name, s in share.items()}

        low, high = np.log(_SMALLEST * largest), np.log(largest)
        for _ in range(_STEPS):
            middle = 0.5 * (low + high)
            if self._variance(factors(float(np.exp(middle))))[gains].max() > target**2:
                high = middle
            else:
                low = middle
        found = factors(float(np.exp(low)))
        return {name: found[name] for name in sorted(share, key=lambda s: -share[s]) if found[name] < 1.0}

    def _variance(self, factors: Mapping[str, float]) -> Array:
        """(6n,) with smaller priors, and a longer record for less noise."""
        longer = factors[NOISE] ** -2.0
        prior = self.gain_prior**-2.0
        seen = np.maximum(1.0 / np.maximum(self.noise, np.finfo(np.float64).tiny) - prior, 0.0)
        variance: Array = 1.0 / (longer * seen + prior)
        if self.covariance.size:
            size = len(self.covariance)
            priors = np.ones(size)
            for name, at in self.groups.items():
                priors[list(at)] = factors[name] ** -2.0
            # a longer record is not counted on to tell payload and clock: mass and gain look alike
            by_data = np.linalg.inv(self.covariance) - np.eye(size)
            known = np.linalg.inv(by_data + np.diag(priors))
            variance += np.einsum("ij,jk,ik->i", self.sensitivity, known, self.sensitivity)
        if self.bent is not None:  # of second order: at least with the square of the worst prior
            variance += self.bent * max((factors[name] for name in self.bent_alone), default=1.0) ** 2
        return variance
