"""Independent fits that share some of their parameters: information adds (METHOD 9).

Of y, what they share less its prior mean, with N(0, D) beforehand and N(m_i, V_i) after fit i alone,

    V^-1 = D^-1 + sum_i (V_i^-1 - D_i^-1),     V^-1 y = sum_i V_i^-1 m_i.

D and D_i differ in the size of the channels' departure from linear alone, which each fit finds anew (10.6).
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from truewrench import _core
from truewrench.model.arrays import Array, Integers, Mask

_LEAST = 1e-9  # share of a gain that a fit has at least: tolerance
_TOLD = 1e-3  # of a direction's variance, 1/4 where halves tell it alike: what less of it moves is not asked
_ROUNDS = 200  # of the size of a departure
_SETTLED = 1e-3  # its relative change


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What one fit says."""

    keys: Mapping[int, Hashable]  # what stands at those places of theta that are shared, the gain first
    first: int  # how many of the first parameters are shared by all, but for those without a key
    u: slice  # the places of the quadratic term, among them; of none empty
    theta: Array  # (p,) estimate
    mean: Array  # (p,) beforehand
    prior: Array  # (p,) variances beforehand, as the fit has them
    covariance: Array  # (p, p)
    added: Array  # (6n, 6n) of the gain by (10.9)


class Shared:
    """What fits that share parameters say together."""

    def __init__(self, fits: Sequence[Told]) -> None:
        self.places = {  # where each shared parameter stands
            key: i for i, key in enumerate(dict.fromkeys(key for fit in fits for key in fit.keys.values()))
        }
        size = len(self.places)
        unit, mean, D = np.full(size, np.inf), np.zeros(size), np.full(size, np.inf)
        for fit in fits:
            at, to = self._at(fit)
            unit[to] = np.minimum(unit[to], np.sqrt(np.diag(fit.covariance)[at]))
            mean[to], D[to] = fit.mean[at], np.minimum(D[to], fit.prior[at])
        self._unit = unit  # in which nothing is much larger than 1
        self._information, self._pulls, bare = [], [], []
        for fit in fits:
            wide = fit.covariance.copy()
            wide[: len(fit.added), : len(fit.added)] += fit.added
            information, pull = self._of(fit, wide)
            self._information.append(information)
            self._pulls.append(pull)
            bare.append(self._of(fit, fit.covariance)[0] if fit.added.any() else information)
        L, pull = np.sum(self._information, axis=0), np.sum(self._pulls, axis=0)
        places = [self.places[fits[0].keys[j]] for j in range(fits[0].u.start, fits[0].u.stop)]
        u = np.array(places, dtype=np.int64)
        # variance of the channels' departures from linear beforehand, as found
        D[u] = self.departure = _departure(L, pull, D / unit**2, u, unit)
        prior = np.diag(unit**2 / D)
        self._P = _inverse(L + prior)
        self._y = self._P @ pull
        self.mean = mean + unit * self._y  # (s,)
        self.covariance = self._P * np.outer(unit, unit)  # with (10.9), and
        self.without_added = _inverse(np.sum(bare, axis=0) + prior) * np.outer(unit, unit)

    def _at(self, fit: Told) -> tuple[Integers, Integers]:
        return np.array(list(fit.keys)), np.array([self.places[key] for key in fit.keys.values()])

    def _of(self, fit: Told, covariance: Array) -> tuple[Array, Array]:
        """V_i^-1 - D_i^-1 and V_i^-1 m_i at the places of all, in `unit`."""
        at, to = self._at(fit)
        information, pull = np.zeros((len(self.places),) * 2), np.zeros(len(self.places))
        unit = self._unit[to]
        V_inverse = _inverse(covariance[np.ix_(at, at)] / np.outer(unit, unit))
        value, vector = np.linalg.eigh(V_inverse - np.diag(unit**2 / fit.prior[at]))
        # rounding, or (10.9) in directions that nothing tells, leaves some below zero
        information[np.ix_(to, to)] = (vector * np.maximum(value, 0.0)) @ vector.T
        pull[to] = V_inverse @ ((fit.theta[at] - fit.mean[at]) / unit)
        return information, pull

    def of_all(self, fit: Told) -> Integers:
        """Where those of the first parameters of a fit that are shared by all stand."""
        return np.array([self.places[fit.keys[j]] for j in range(fit.first) if j in fit.keys])

    def first_of(self, fit: Told) -> Array:
        """The first parameters of a fit: as they are best for all, or its own."""
        out = fit.theta[: fit.first].copy()
        out[[j for j in range(fit.first) if j in fit.keys]] = self.mean[self.of_all(fit)]
        return out

    def weights(self, gains: int) -> Array:
        """How much of each of the first parameters rests on each of the fits (N, gains): diag P L_i, to 1."""
        share = np.array([np.einsum("ij,ji->i", self._P[:gains], L[:, :gains]) for L in self._information])
        share = np.maximum(share, _LEAST)
        return np.asarray(share / share.sum(axis=0))

    def agreement(self, first: Mask, gains: int) -> float:
        """How likely the gain, the first parameters, moves as far by some of the (N,) fits (10.11).

        That is P s, with s = sum (V_i^-1 m_i - L_i y) over them, which is N(0, L - L P L).
        """
        if first.all() or not first.any():
            return 1.0
        P, y = self._P, self._y
        some = np.flatnonzero(first)
        L = np.sum([self._information[i] for i in some], axis=0)
        moved = P @ (np.sum([self._pulls[i] for i in some], axis=0) - L @ y)
        V = P @ (L - L @ P @ L) @ P
        scale = np.sqrt(np.diag(P)[:gains])
        value, vector = np.linalg.eigh(V[:gains, :gains] / np.outer(scale, scale))
        along, told = vector.T @ (moved[:gains] / scale), value > _TOLD
        if not told.any():
            return 1.0
        return float(chdtrc(int(told.sum()), float(np.sum(along[told] ** 2 / value[told]))))

    def with_own(self, fits: Sequence[Told]) -> tuple[Array, Array, list[Integers]]:
        """The same with what some fits have of their own, and where that stands.

        The covariance is that without (10.9). What is their own hangs on the shared by x = K y + what does
        not depend on y, K = P_xy P_yy^-1, as in the fit.
        """
        known = len(self.places)
        mean, blocks, rest, places = [self.mean], [np.eye(known)], [], []
        start = known
        for fit in fits:
            at, to = self._at(fit)
            own = np.setdiff1d(np.arange(len(fit.theta)), at)
            P = fit.covariance
            K = P[np.ix_(own, at)] @ _inverse(P[np.ix_(at, at)])
            mean.append(fit.theta[own] + K @ (self.mean[to] - fit.theta[at]))
            block = np.zeros((own.size, known))
            block[:, to] = K
            blocks.append(block)
            rest.append(P[np.ix_(own, own)] - K @ P[np.ix_(at, own)])
            place = np.zeros(len(fit.theta), np.int64)
            place[at], place[own] = to, start + np.arange(own.size)
            places.append(place)
            start += own.size
        T = np.vstack(blocks)
        covariance = T @ self.without_added @ T.T
        row = known
        for own_share in rest:
            to_row = row + len(own_share)
            covariance[row:to_row, row:to_row] += own_share
            row = to_row
        return np.concatenate(mean), covariance, places


def _inverse(matrix: Array) -> Array:
    scale = np.sqrt(np.diag(matrix))
    out = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(0.5 * (out + out.T))


def _departure(L: Array, pull: Array, D: Array, u: Integers, unit: Array) -> float:
    """The variance of the channels' departures from linear: (10.6) with R = E, as in the core.

    Information L (s, s), its pull (s,) and the prior variances D (s,) of all are in `unit` (s,); those of the
    departures, at the places u, do not count.
    """
    others = np.setdiff1d(np.arange(len(D)), u)
    inner = L[np.ix_(others, others)] + np.diag(1.0 / D[others])
    K = L[np.ix_(u, others)] @ _inverse(inner)
    told = (L[np.ix_(u, u)] - K @ L[np.ix_(others, u)]) / np.outer(unit[u], unit[u])
    pull = (pull[u] - K @ pull[others]) / unit[u]
    size = 1.0
    for _ in range(_ROUNDS):
        P = np.linalg.inv(told + np.eye(u.size) / size)
        freedom = max(u.size - np.trace(P) / size, 0.05)
        to = max(float(np.sum((P @ pull) ** 2)) / freedom, _core.DEPARTURE_FLOOR**2)
        ratio, size = to / size, to
        if abs(np.log(ratio)) < _SETTLED:
            break
    return size
