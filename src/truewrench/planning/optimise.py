"""The nonlinear programme behind every optimal motion, by IPOPT with exact derivatives.

Unknown are the coefficients of the series and, where it is free, the start. What happens at a node depends on
coordinates, velocities and accelerations there and on nothing else: CasADi differentiates that one function,
and sums over the nodes with the basis give gradient, Jacobian and Hessian, at a cost that IPOPT's own linear
algebra exceeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from truewrench.planning.criterion import PACKED, Criterion, packed
from truewrench.planning.ipopt import minimise
from truewrench.planning.limits import Limits
from truewrench.planning.series import SeriesBasis

__all__ = ["Bounds", "Problem", "Solution", "Space"]

Array = NDArray[np.float64]

_FACTORS = 2.0 ** np.arange(2.0, -5.0, -0.25)  # sizes of a random motion that are tried
_FEWEST_NODES = 48
_NODES_PER_HARMONIC = 12
_FINE = 4  # times between two nodes at which the series themselves are looked at
_FREE = 1e3  # [rad, m] stands for no limit
_FEASIBLE = 1e-6  # of a limit
_LARGE = 0.3  # use of a limit by a random motion from which on an optimum may reach it
_CLOSE = 0.85  # use of a limit from which on a constraint is looked at


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """What is kept to, as arrays; infinite where there is no limit.

    Attributes:
        lower: (n,) of the coordinates.
        upper: (n,).
        velocity: (n,) of their absolute derivatives.
        acceleration: (n,).
        jerk: (n,).
        node_lower: (y,) of what the node function returns after the wrench.
        node_upper: (y,).
        wrench: (6,) largest shares of the range.
        integral_lower: (c,) of the integral from time 0 of what is to vanish on average.
        integral_upper: (c,).
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    node_lower: Array
    node_upper: Array
    wrench: Array
    integral_lower: Array
    integral_upper: Array


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """Coordinates that a motion is planned in.

    Attributes:
        n: number of coordinates.
        node: SX function of (z, zdot, zddot), (n,) each, to wrench over range (6,), bounded quantities (y,)
            and quantities whose mean over the period is to vanish (c,).
        bounds: what limits mean for these coordinates.
        scale: (n,) typical velocities.
        free_start: whether z(0) is chosen, too.
    """

    n: int
    node: ca.Function
    bounds: Callable[[Limits], Bounds]
    scale: Array
    free_start: bool


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Start (n,), coefficients (m, n), the criterion that they reach, and the largest use of a limit."""

    start: Array
    coefficients: Array
    value: float
    status: str
    iterations: int
    worst: float = 0.0


class Problem:
    """One period of a motion, at K nodes, as IPOPT sees it."""

    def __init__(self, space: Space, basis: SeriesBasis, criterion: Criterion, limits: Limits) -> None:
        self._space, self._basis, self._criterion = space, basis, criterion
        self._nodes = nodes = max(_FEWEST_NODES, _NODES_PER_HARMONIC * basis.harmonics)
        time, fine = (
            np.linspace(0.0, basis.period, count, endpoint=False) for count in (nodes, _FINE * nodes)
        )
        self._tables = np.stack([basis.table(time, d) for d in range(3)], axis=1)  # (K, 3, m)
        self._fine = [basis.table(fine, d) for d in range(4)]
        n = space.n
        self._scale = space.scale
        self._start_size = n if space.free_start else 0
        self.size = self._start_size + n * basis.size
        z = ca.SX.sym("z", 3 * n)
        w, y, c = space.node(*ca.vertsplit(z, n))
        self._y, self._c = y.numel(), c.numel()
        out = ca.vertcat(w, y, c)
        self._out = 6 + self._y + self._c
        weight, multiplier = ca.SX.sym("weight", 7, 7), ca.SX.sym("multiplier", self._out)
        one = ca.vertcat(w, 1.0)
        lagrangian = ca.dot(one, ca.mtimes(weight, one)) + ca.dot(multiplier, out)
        self._values = ca.Function("values", [z], [out]).map(nodes)
        self._jacobian = ca.Function("jacobian", [z], [out, ca.densify(ca.jacobian(out, z))]).map(nodes)
        hessian = ca.densify(ca.hessian(lagrangian, z)[0])
        self._hessian = ca.Function("hessian", [z, weight, multiplier], [hessian]).map(
            "hessians", "serial", nodes, [1], []
        )
        bounds = space.bounds(limits)
        self._linear = self._linear_rows(bounds)
        self._summed = np.flatnonzero(np.isfinite(bounds.integral_upper))
        self._integration = _integration(nodes, basis.period)

    # -- what is linear: limits on the series themselves -----------------------------------------------

    def _linear_rows(self, b: Bounds) -> tuple[Array, list[tuple[int, int]]]:
        """Constant Jacobian (L, size) of the limits on coordinates and derivatives, and which each row is."""
        limits = [np.maximum(np.abs(b.lower), np.abs(b.upper)), b.velocity, b.acceleration, b.jerk]
        rows, which = [], []
        for d, limit in enumerate(limits):
            for j in np.flatnonzero(np.isfinite(limit)):
                block = np.zeros((len(self._fine[d]), self.size))
                first = self._start_size + j * self._basis.size
                block[:, first : first + self._basis.size] = self._fine[d] * self._scale[j]
                if d == 0 and self._space.free_start:
                    block[:, j] = 1.0
                rows.append(block)
                which += [(d, int(j))] * len(block)
        return (np.concatenate(rows) if rows else np.zeros((0, self.size))), which

    def _limits(self, bounds: Bounds) -> tuple[Array, Array]:
        """Lower and upper limits of all constraints."""
        symmetric = [bounds.velocity, bounds.acceleration, bounds.jerk]
        upper = [bounds.upper, *symmetric]
        lower = [bounds.lower, *(-limit for limit in symmetric)]
        which = self._linear[1]
        node = np.concatenate([bounds.wrench, bounds.node_upper])
        node_lower = np.concatenate([-bounds.wrench, bounds.node_lower])
        closed, summed, K = np.zeros(self._c), self._summed, self._nodes
        below, above = bounds.integral_lower[summed], bounds.integral_upper[summed]
        return (
            np.concatenate(
                [[lower[d][j] for d, j in which], np.tile(node_lower, K), closed, np.tile(below, K)]
            ),
            np.concatenate([[upper[d][j] for d, j in which], np.tile(node, K), closed, np.tile(above, K)]),
        )

    @property
    def pattern(self) -> NDArray[np.bool_]:
        """(G, size) where the Jacobian of the constraints may be other than zero."""
        nodal = self._nodes * (6 + self._y + self._summed.size) + self._c
        return np.concatenate([self._linear[0] != 0.0, np.ones((nodal, self.size), dtype=bool)])

    # -- values and derivatives --------------------------------------------------------------------------

    def pack(self, start: Array, coefficients: Array) -> Array:
        """The unknowns of a motion."""
        scaled = (coefficients / self._scale).T.ravel()
        return np.concatenate([start, scaled]) if self._space.free_start else scaled

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """Start (n,) and coefficients (m, n) of the unknowns."""
        n = self._space.n
        start = x[:n] if self._space.free_start else np.zeros(n)
        return start, x[self._start_size :].reshape(n, self._basis.size).T * self._scale

    def _at_nodes(self, x: Array) -> Array:
        """(3n, K) coordinates, velocities and accelerations."""
        start, coefficients = self.unpack(x)
        states = self._tables @ coefficients  # (K, 3, n)
        states[:, 0] += start
        return np.asarray(states.reshape(self._nodes, -1).T)

    def value(self, x: Array) -> float:
        """The criterion."""
        w = np.array(self._values(self._at_nodes(x)))[:6].T
        return self._criterion(packed(w)) if np.isfinite(w).all() else np.nan

    def constraints(self, x: Array) -> Array:
        """Linear rows, node by node wrench and bounded quantities, means that vanish, and integrals."""
        out = np.array(self._values(self._at_nodes(x))).T
        return self._stacked(x, out)

    def _stacked(self, x: Array, out: Array) -> Array:
        bounded, closed = out[:, : 6 + self._y].ravel(), out[:, 6 + self._y :]
        sums = self._integration @ closed[:, self._summed]
        return np.concatenate([self._linear[0] @ x, bounded, closed.mean(axis=0), sums.ravel()])

    def _node_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Outputs (K, out) of the node function, and their Jacobian (K, out, size) by the unknowns."""
        n, K = self._space.n, self._nodes
        out, flat = self._jacobian(self._at_nodes(x))
        by_state = np.array(flat).reshape(self._out, K, 3, n).transpose(1, 0, 2, 3)
        by_coefficients = np.einsum("kodj,kdm->kojm", by_state, self._tables, optimize=True)
        by_coefficients *= self._scale[:, None]
        jacobian = by_coefficients.reshape(K, self._out, -1)
        if self._space.free_start:
            jacobian = np.concatenate([by_state[:, :, 0], jacobian], axis=2)
        return np.array(out).T, jacobian

    def _moments_jacobian(self, out: Array, jacobian: Array) -> Array:
        """(28, size) of the packed mean of [w; 1][w; 1]^T."""
        one = np.column_stack([out[:, :6], np.ones(self._nodes)])
        by = np.concatenate([jacobian[:, :6], np.zeros((self._nodes, 1, self.size))], axis=1)
        half = np.einsum("ki,kjx->ijx", one, by, optimize=True) / self._nodes
        return np.asarray((half + half.transpose(1, 0, 2))[PACKED])

    def gradient(self, x: Array) -> tuple[float, Array]:
        """Criterion and its gradient."""
        out, jacobian = self._node_jacobian(x)
        value, by_moments, _ = self._criterion.derivatives(packed(out[:, :6]))
        return value, by_moments @ self._moments_jacobian(out, jacobian)

    def constraint_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Constraints and their Jacobian (G, size)."""
        out, jacobian = self._node_jacobian(x)
        bounded = jacobian[:, : 6 + self._y].reshape(-1, self.size)
        closed = jacobian[:, 6 + self._y :]
        sums = np.tensordot(self._integration, closed[:, self._summed], axes=1).reshape(-1, self.size)
        return self._stacked(x, out), np.concatenate([self._linear[0], bounded, closed.mean(axis=0), sums])

    def hessian(self, x: Array, of_value: float, of_constraints: Array) -> Array:
        """Hessian (size, size) of the Lagrangian."""
        n, K = self._space.n, self._nodes
        out, jacobian = self._node_jacobian(x)
        _, first, second = self._criterion.derivatives(packed(out[:, :6]))
        by_x = self._moments_jacobian(out, jacobian)
        total = of_value * by_x.T @ second @ by_x
        weight = np.zeros((7, 7))
        weight[PACKED] = of_value * first / K
        weight = 0.5 * (weight + weight.T)
        linear, nodal = len(self._linear[0]), K * (6 + self._y)
        multiplier = np.empty((self._out, K))
        multiplier[: 6 + self._y] = of_constraints[linear : linear + nodal].reshape(K, -1).T
        last = linear + nodal + self._c
        multiplier[6 + self._y :] = of_constraints[linear + nodal : last, None] / K
        multiplier[6 + self._y + self._summed] += of_constraints[last:].reshape(K, -1).T @ self._integration
        blocks = np.array(self._hessian(self._at_nodes(x), weight, multiplier))
        H = blocks.reshape(3, n, K, 3, n).transpose(2, 0, 1, 3, 4)  # (K, d, j, e, l)
        right = np.einsum("kdjel,kem->kdjlm", H, self._tables, optimize=True)
        both = np.einsum("kdp,kdjlm->jplm", self._tables, right, optimize=True)
        both *= self._scale[:, None, None, None] * self._scale[:, None]
        s = self._start_size
        total[s:, s:] += both.reshape(self.size - s, -1)
        if s:
            cross = right[:, 0].sum(axis=0) * self._scale[:, None]  # (j, l, m)
            total[:s, s:] += cross.reshape(n, -1)
            total[s:, :s] += cross.reshape(n, -1).T
            total[:s, :s] += H[:, 0, :, 0].sum(axis=0)
        return np.asarray(total)

    # -- solving -----------------------------------------------------------------------------------------

    def candidates(self, limits: Limits, seed: int, count: int) -> Iterator[Solution]:
        """Random motions, as large as the limits allow at the nodes."""
        bounds = self._space.bounds(limits)
        lower, upper = self._limits(bounds)
        rng = np.random.default_rng([seed, 11])
        room = 0.9 * np.minimum(bounds.upper - bounds.lower, 2.0 * np.pi)
        middle = 0.5 * (np.maximum(bounds.lower, -_FREE) + np.minimum(bounds.upper, _FREE))
        for _ in range(count):
            drawn = (
                rng.uniform(-0.5, 0.5, self._space.n),
                rng.standard_normal((self._basis.size, self._space.n)),
            )
            start = middle + room * drawn[0] if self._space.free_start else np.zeros(self._space.n)
            for factor in _FACTORS:
                x = self.pack(start, factor * drawn[1] * self._scale)
                g = self.constraints(x)
                if np.all((g >= lower) & (g <= upper) | (lower == upper)):
                    yield Solution(start, factor * drawn[1] * self._scale, self.value(x), "random", 0)
                    break

    def solve(
        self,
        start: Array,
        coefficients: Array,
        limits: Limits,
        *,
        iterations: int,
        warm: bool = False,
        rounds: int = 5,
    ) -> Solution:
        """A local optimum within limits, from a motion.

        Args:
            start: (n,).
            coefficients: (m, n).
            limits: no wider than those that the problem was made with.
            iterations: at most.
            warm: whether the motion is nearly optimal already.
            rounds: at most, each with the constraints that the one before came near.
        """
        lower, upper = self._limits(self._space.bounds(limits))
        x, count = self.pack(start, coefficients), 0
        kept = self._first_rows(_share(self.constraints(x), lower, upper)) | (lower == upper)
        for _ in range(rounds):
            g = self.constraints(x)
            kept |= _share(g, lower, upper) > _CLOSE
            part = _Part(self, kept)
            x, status, used = minimise(part, x, lower[kept], upper[kept], iterations=iterations, warm=warm)
            count, warm = count + used, True
            worst = float(_share(self.constraints(x), lower, upper).max())

            if worst <= 1.0 + _FEASIBLE:
                break
        found_start, found = self.unpack(x)
        return Solution(found_start, found, self.value(x), status, count, worst)

    def _first_rows(self, share: Array) -> NDArray[np.bool_]:
        """Constraints to begin with; the others are looked at where a solution comes near them."""
        linear, nodal = len(self._linear[0]), self._nodes * (6 + self._y)
        kept = np.zeros(share.size, dtype=bool)
        kept[:linear:_FINE] = True
        large = share[linear : linear + nodal].reshape(self._nodes, -1).max(axis=0) > _LARGE
        even = np.arange(self._nodes) % 2 == 0
        kept[linear : linear + nodal] = even.repeat(large.size) & np.tile(large, self._nodes)
        kept[linear + nodal + self._c :] = even.repeat(self._summed.size)
        return kept


def _share(g: Array, lower: Array, upper: Array) -> Array:
    """How much of its interval each constraint uses; above 1 it is violated."""
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    equal = half == 0.0
    used = np.abs(g - middle) / np.where(equal, 1.0, half)
    return np.where(equal, used * (used > _FEASIBLE), used)


def _integration(nodes: int, period: float) -> Array:
    """(K, K) integral from time 0 to every node of what has these values at the nodes and no mean."""
    k = np.fft.rfftfreq(nodes, 1.0 / nodes)
    kept = (k > 0) & (2 * k < nodes)
    factor = np.where(kept, -0.5j * period / (np.pi * np.where(kept, k, 1.0)), 0.0)
    whole = np.fft.irfft(np.fft.rfft(np.eye(nodes), axis=0) * factor[:, None], nodes, axis=0)
    return np.asarray(whole - whole[0])


class _Part:
    """A problem with some of its constraints."""

    def __init__(self, whole: Problem, kept: NDArray[np.bool_]) -> None:
        self._whole, self._kept = whole, kept
        self.size, self.pattern = whole.size, whole.pattern[kept]
        self.value, self.gradient = whole.value, whole.gradient

    def constraints(self, x: Array) -> Array:
        return self._whole.constraints(x)[self._kept]

    def constraint_jacobian(self, x: Array) -> tuple[Array, Array]:
        g, jacobian = self._whole.constraint_jacobian(x)
        return g[self._kept], jacobian[self._kept]

    def hessian(self, x: Array, of_value: float, of_constraints: Array) -> Array:
        multipliers = np.zeros(self._kept.size)
        multipliers[self._kept] = of_constraints
        return self._whole.hessian(x, of_value, multipliers)
