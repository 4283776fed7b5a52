"""The nonlinear programme behind every optimal motion, by IPOPT with exact derivatives.

Unknown are the coefficients of the series and, where it is free, the start. What happens at a node depends on
coordinates, velocities and accelerations there and on nothing else: CasADi differentiates that one function,
and sums over the nodes with the basis give gradient, Jacobian and Hessian, at a cost that IPOPT's own linear
algebra exceeds.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from truewrench.model.arrays import Array, Integers, Mask
from truewrench.planning.buffered import Buffered
from truewrench.planning.criterion import PACKED, Criterion, packed
from truewrench.planning.limits import Limits
from truewrench.planning.series import SeriesBasis
from truewrench.planning.spread import Spread

FINE = 4  # times between two nodes at which the series themselves are looked at
_FEWEST_NODES = 48
_NODES_PER_HARMONIC = 12


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """What is kept to, as arrays; infinite where there is no limit."""

    lower: Array  # (n,) of the coordinates
    upper: Array  # (n,)
    velocity: Array  # (n,) of their absolute derivatives
    acceleration: Array  # (n,)
    jerk: Array  # (n,)
    node_lower: Array  # (y,) of what the node function returns after the wrench
    node_upper: Array  # (y,)
    wrench: Array  # (6,) largest shares of the range
    integral_lower: Array  # (c,) of the integral from time 0 of what is to vanish on average
    integral_upper: Array  # (c,)


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """Coordinates that a motion is planned in."""

    n: int  # number of coordinates
    # SX function of (z, zdot, zddot), (n,) each, to wrench over range (6,), bounded quantities (y,) and
    # quantities whose mean over the period is to vanish (c,)
    node: ca.Function
    bounds: Callable[[Limits], Bounds]  # what limits mean for these coordinates
    scale: Array  # (n,) typical velocities
    free_start: bool  # whether z(0) is chosen, too


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Some of the constraints."""

    linear: Array  # (L, size) their constant Jacobian
    node: Integers  # (R,) nodes of those that hold at a node,
    output: Integers  # (R,) and which of its outputs they limit
    sums: Array  # (S, K) weights of the nodes in integrals
    kept: Mask  # (G,) which of all they are


@dataclass(frozen=True, slots=True, eq=False)
class _Derivatives:
    by_moments: Array  # (28,) gradient of the criterion
    second: Array  # (28, 28) and Hessian
    jacobian: Array  # (K, out, size) of the node function
    moments: Array  # (28, size) of the packed mean of [w; 1][w; 1]^T


class Problem:
    """One period of a motion, at K nodes, as IPOPT sees it.

    What is minimised is the criterion, and `spread` times what one frequency a coordinate costs (spread.py).
    """

    def __init__(
        self,
        space: Space,
        basis: SeriesBasis,
        criterion: Criterion,
        limits: Limits,
        *,
        spread: float = 0.0,
    ) -> None:
        self.space, self.basis, self._criterion = space, basis, criterion
        self.nodes = nodes = max(_FEWEST_NODES, _NODES_PER_HARMONIC * basis.harmonics)
        time, self._fine = (
            np.linspace(0.0, basis.period, count, endpoint=False) for count in (nodes, FINE * nodes)
        )
        self._tables = np.stack([basis.table(time, d) for d in range(3)], axis=1)  # (K, 3, m)
        n = space.n
        self._scale = space.scale
        self._spread, self._price = Spread(basis, n), spread
        self._start_size = n if space.free_start else 0
        self.size = self._start_size + n * basis.size
        z = ca.SX.sym("z", 3 * n)
        w, y, c = space.node(*ca.vertsplit(z, n))
        # how many quantities are limited at every node, besides the wrench, and how many vanish on average
        self.bounded, self._closed = y.numel(), c.numel()
        out = ca.vertcat(w, y, c)
        self._out = 6 + self.bounded + self._closed
        weight, multiplier = ca.SX.sym("weight", 7, 7), ca.SX.sym("multiplier", self._out)
        one = ca.vertcat(w, 1.0)
        lagrangian = ca.dot(one, ca.mtimes(weight, one)) + ca.dot(multiplier, out)
        self._values = Buffered(ca.Function("values", [z], [ca.densify(out)]).map(nodes))
        by_state = ca.Function("jacobian", [z], [ca.densify(ca.jacobian(out, z))])
        self._jacobian = Buffered(by_state.map(nodes))
        hessian = ca.densify(ca.hessian(lagrangian, z)[0])
        second = ca.Function("hessian", [z, weight, multiplier], [hessian])
        self._hessian = Buffered(second.map("hessians", "serial", nodes, [1], []))
        bounds = space.bounds(limits)
        self.linear, self.linear_of = self._linear_rows(bounds)
        self.summed = np.flatnonzero(np.isfinite(bounds.integral_upper))
        self._integration = _integration(nodes, basis.period)
        self._last: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
        self._last_derivatives: tuple[Array, _Derivatives | None] = (np.zeros(0), None)

    # -- constraints, row by row -------------------------------------------------------------------------

    def _linear_rows(self, b: Bounds) -> tuple[Array, list[tuple[int, int]]]:
        """Constant Jacobian (L, size) of the limits on coordinates and derivatives, and which each row is."""
        limits = [np.maximum(np.abs(b.lower), np.abs(b.upper)), b.velocity, b.acceleration, b.jerk]
        rows, which = [np.zeros((0, self.size))], []
        for d, limit in enumerate(limits):
            table = self.basis.table(self._fine, d)
            for j in np.flatnonzero(np.isfinite(limit)):
                block = np.zeros((len(table), self.size))
                first = self._start_size + j * self.basis.size
                block[:, first : first + self.basis.size] = table * self._scale[j]
                if d == 0 and self._start_size:
                    block[:, j] = 1.0
                rows.append(block)
                which += [(d, int(j))] * len(block)
        return np.concatenate(rows), which

    @property
    def count(self) -> int:
        """Number of all constraints."""
        nodal = self.nodes * (6 + self.bounded + self.summed.size)
        return len(self.linear) + nodal + self._closed

    def rows(self, kept: Mask) -> Rows:
        """Some of the constraints; means that vanish always belong to them, integrals node by node."""
        L, nodal = len(self.linear), self.nodes * (6 + self.bounded)
        node, output = np.divmod(np.flatnonzero(kept[L : L + nodal]), 6 + self.bounded)
        integrals = kept[L + nodal + self._closed :].reshape(self.nodes, -1).any(axis=1)
        return Rows(self.linear[kept[:L]], node, output, self._integration[integrals], self._widened(kept))

    def _widened(self, kept: Mask) -> Mask:
        last = len(self.linear) + self.nodes * (6 + self.bounded)
        wide = kept.copy()
        wide[last : last + self._closed] = True
        by_node = wide[last + self._closed :].reshape(self.nodes, -1)
        by_node |= by_node.any(axis=1, keepdims=True)
        return wide

    def limits(self, bounds: Bounds) -> tuple[Array, Array]:
        """Lower and upper limits of all constraints."""
        symmetric = [bounds.velocity, bounds.acceleration, bounds.jerk]
        sides = []
        for series, wrench, node, integral in (
            (
                [bounds.lower, *(-s for s in symmetric)],
                -bounds.wrench,
                bounds.node_lower,
                bounds.integral_lower,
            ),
            ([bounds.upper, *symmetric], bounds.wrench, bounds.node_upper, bounds.integral_upper),
        ):
            of_node = np.tile(np.concatenate([wrench, node]), self.nodes)
            sums = np.tile(integral[self.summed], self.nodes)
            linear = np.array([series[d][j] for d, j in self.linear_of])
            sides.append(np.concatenate([linear, of_node, np.zeros(self._closed), sums]))
        return sides[0], sides[1]

    # -- values and derivatives --------------------------------------------------------------------------

    def pack(self, start: Array, coefficients: Array) -> Array:
        """The unknowns of a motion."""
        scaled = (coefficients / self._scale).T.ravel()
        return np.concatenate([start, scaled]) if self._start_size else scaled

    def unpack(self, x: Array) -> tuple[Array, Array]:
        """Start (n,) and coefficients (m, n) of the unknowns."""
        n = self.space.n
        start = x[:n] if self._start_size else np.zeros(n)
        return start, x[self._start_size :].reshape(n, self.basis.size).T * self._scale

    def criterion(self, x: Array) -> float:
        """The criterion."""
        w = self._outputs(x)[:, :6]
        return self._criterion(packed(w)) if np.isfinite(w).all() else np.nan

    def value(self, x: Array) -> float:
        """What is minimised."""
        return self.criterion(x) + self._price * self._spread(x[self._start_size :])

    def gradient(self, x: Array) -> tuple[float, Array]:
        """What is minimised, and its gradient."""
        found = self._derivatives(x)
        gradient = found.by_moments @ found.moments
        gradient[self._start_size :] += self._price * self._spread.derivatives(x[self._start_size :])[0]
        return self.value(x), gradient

    def constraints(self, x: Array, rows: Rows) -> Array:
        """Constraints (G,) of some rows: linear ones, then of the nodes, then over all nodes."""
        out = self._outputs(x)
        closed = out[:, 6 + self.bounded :]
        sums = rows.sums @ closed[:, self.summed]
        return np.concatenate(
            [rows.linear @ x, out[rows.node, rows.output], closed.mean(axis=0), sums.ravel()]
        )

    def constraint_jacobian(self, x: Array, rows: Rows) -> tuple[Array, Array]:
        """Constraints and their Jacobian (G, size)."""
        jacobian = self._derivatives(x).jacobian
        closed = jacobian[:, 6 + self.bounded :]
        sums = np.tensordot(rows.sums, closed[:, self.summed], axes=1).reshape(-1, self.size)
        parts = [rows.linear, jacobian[rows.node, rows.output], closed.mean(axis=0), sums]
        return self.constraints(x, rows), np.concatenate(parts)

    def hessian(self, x: Array, of_value: float, of_constraints: Array, rows: Rows) -> Array:
        """Hessian (size, size) of the Lagrangian."""
        n, K = self.space.n, self.nodes
        at = self._derivatives(x)
        total = of_value * at.moments.T @ at.second @ at.moments
        weight = np.zeros((7, 7))
        weight[PACKED] = of_value * at.by_moments / K
        weight = 0.5 * (weight + weight.T)
        nodal, closed, sums = np.split(
            of_constraints[len(rows.linear) :], np.cumsum([rows.node.size, self._closed])
        )
        multiplier = np.zeros((self._out, K))
        multiplier[rows.output, rows.node] = nodal
        multiplier[6 + self.bounded :] = closed[:, None] / K
        of_sums = sums.reshape(len(rows.sums), self.summed.size)
        multiplier[6 + self.bounded + self.summed] += of_sums.T @ rows.sums
        (blocks,) = self._hessian(self._at_nodes(x), weight, multiplier)
        H = blocks.reshape(3, n, K, 3, n).transpose(2, 0, 1, 3, 4)  # (K, d, j, e, l)
        right = np.einsum("kdjel,kem->kdjlm", H, self._tables, optimize=True)
        both = self._tables.reshape(3 * K, -1).T @ right.reshape(3 * K, -1)  # (p, j l m)
        both = both.reshape(-1, n, n, self.basis.size).transpose(1, 0, 2, 3)
        both = both * self._scale[:, None, None, None] * self._scale[:, None]
        s = self._start_size
        total[s:, s:] += both.reshape(self.size - s, -1)
        total[s:, s:] += of_value * self._price * self._spread.derivatives(x[s:])[1]
        if s:
            cross = right[:, 0].sum(axis=0) * self._scale[:, None]  # (j, l, m)
            total[:s, s:] += cross.reshape(n, -1)
            total[s:, :s] += cross.reshape(n, -1).T
            total[:s, :s] += H[:, 0, :, 0].sum(axis=0)
        return np.asarray(total)

    def _at_nodes(self, x: Array) -> Array:
        """(3n, K) coordinates, velocities and accelerations."""
        start, coefficients = self.unpack(x)
        states = self._tables @ coefficients  # (K, 3, n)
        states[:, 0] += start
        return np.asarray(states.reshape(self.nodes, -1).T)

    def _outputs(self, x: Array) -> Array:
        """(K, out) of the node function."""
        if not np.array_equal(x, self._last[0]):
            self._last = (x.copy(), self._values(self._at_nodes(x))[0].T)
        return self._last[1]

    def _derivatives(self, x: Array) -> _Derivatives:
        """First derivatives, kept for the next call at the same point."""
        at, found = self._last_derivatives
        if found is None or not np.array_equal(x, at):
            found = self._differentiate(x)
            self._last_derivatives = (x.copy(), found)
        return found

    def _differentiate(self, x: Array) -> _Derivatives:
        n, K = self.space.n, self.nodes
        (by_state,) = self._jacobian(self._at_nodes(x))
        by_state = by_state.reshape(self._out, K, 3, n).transpose(1, 0, 3, 2)  # (K, out, n, 3)
        jacobian = ((by_state @ self._tables[:, None]) * self._scale[:, None]).reshape(K, self._out, -1)
        if self._start_size:
            jacobian = np.concatenate([by_state[..., 0], jacobian], axis=2)
        w = self._outputs(x)[:, :6]
        one = np.column_stack([w, np.ones(K)]) / K
        by = np.concatenate([jacobian[:, :6], np.zeros((K, 1, self.size))], axis=1)
        half = (one.T @ by.reshape(K, -1)).reshape(7, 7, self.size)
        moments = (half + half.transpose(1, 0, 2))[PACKED]
        _, first, second = self._criterion.derivatives(packed(w))
        return _Derivatives(first, second, jacobian, moments)


def _integration(nodes: int, period: float) -> Array:
    """(K, K) integral from time 0 to every node of what has these values at the nodes and no mean."""
    k = np.fft.rfftfreq(nodes, 1.0 / nodes)
    kept = (k > 0) & (2 * k < nodes)
    factor = np.where(kept, -0.5j * period / (np.pi * np.where(kept, k, 1.0)), 0.0)
    whole = np.fft.irfft(np.fft.rfft(np.eye(nodes), axis=0) * factor[:, None], nodes, axis=0)
    return np.asarray(whole - whole[0])
