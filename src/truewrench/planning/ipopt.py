"""IPOPT, through CasADi, on derivatives that are computed outside of CasADi's expressions."""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from truewrench.model.arrays import Array
from truewrench.planning.optimise import Problem, Rows


class _Call(ca.Callback):
    """A function of NumPy arrays, those of structural nonzeros column by column, as CasADi calls it."""

    def __init__(
        self, name: str, inputs: Sequence[Any], outputs: Sequence[Any], call: Callable[..., Sequence[Any]]
    ) -> None:
        super().__init__()
        self._inputs, self._outputs, self._call = inputs, outputs, call
        self.failure: Exception | None = None  # CasADi takes one for a point that cannot be evaluated
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> Any:
        return self._inputs[i]

    def get_sparsity_out(self, i: int) -> Any:
        return self._outputs[i]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Sequence[Any], results: Sequence[Any]) -> int:
        try:
            found = self._call(*(np.frombuffer(x or b"") for x in arguments))
            for place, value in zip(results, found, strict=True):
                if place is not None:
                    np.frombuffer(place)[:] = value
        except Exception as error:
            self.failure = error
            return 1
        return 0


def minimise(
    problem: Problem, rows: Rows, x: Array, lower: Array, upper: Array, *, iterations: int, warm: bool
) -> tuple[Array, int]:
    """A local minimum within constraints (G,), and the iterations it took, from x (size,).

    `warm`: x is nearly optimal already. Kept to are the constraints of the rows.
    """
    size = problem.size
    dense = np.ones((len(lower) - len(rows.linear), size), dtype=bool)
    pattern = np.concatenate([rows.linear != 0.0, dense])
    vector, parameters, scalar = ca.Sparsity.dense(size, 1), ca.Sparsity(0, 0), ca.Sparsity.dense(1, 1)
    values = ca.Sparsity.dense(len(lower), 1)
    row, column = np.nonzero(pattern.T)[::-1]  # column by column, as CasADi stores them
    jacobian = ca.Sparsity.triplet(len(lower), size, row.tolist(), column.tolist())
    upper_part = ca.Sparsity.upper(size)
    i, j = np.array(upper_part.row()), np.repeat(np.arange(size), np.diff(upper_part.colind()))

    def with_jacobian(at: Array, _: Array) -> Sequence[Any]:
        found, derivatives = problem.constraint_jacobian(at, rows)
        return found, derivatives[row, column]

    def hessian(at: Array, _: Array, of_value: Array, of_constraints: Array) -> Sequence[Any]:
        return (problem.hessian(at, float(of_value[0]), of_constraints, rows)[i, j],)

    evaluate = _Call(
        "problem",
        [vector],
        [scalar, values],
        lambda at: (problem.value(at), problem.constraints(at, rows)),
    )
    calls = {
        "grad_f": _Call(
            "gradient", [vector, parameters], [scalar, vector], lambda at, _: problem.gradient(at)
        ),
        "jac_g": _Call("jacobian", [vector, parameters], [values, jacobian], with_jacobian),
        "hess_lag": _Call("hessian", [vector, parameters, scalar, values], [upper_part], hessian),
    }
    options: dict[str, Any] = {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": iterations,
        "ipopt.tol": 1e-5,  # of the logarithm of a sigma
        "ipopt.acceptable_tol": 1e-3,
        "ipopt.acceptable_iter": 5,
        "ipopt.acceptable_obj_change_tol": 1e-5,
        "ipopt.mu_init": 1e-3,  # random motions are within the limits already
        "ipopt.constr_viol_tol": 1e-9,
        "ipopt.acceptable_constr_viol_tol": 1e-9,
        "print_time": False,
        "show_eval_warnings": False,
        "no_nlp_grad": True,  # which would differentiate the calls
    }
    if warm:
        near = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
        options |= {"ipopt.mu_init": 1e-4} | {f"ipopt.{name}": 1e-4 for name in near}
    unknown = ca.MX.sym("x", size)
    f, g = evaluate(unknown)
    solver = ca.nlpsol("solver", "ipopt", {"x": unknown, "f": f, "g": g}, options | calls)
    found = solver(x0=x, lbg=lower, ubg=upper)
    for call in (evaluate, *calls.values()):
        if call.failure is not None:
            raise call.failure
    stats = solver.stats()
    return np.array(found["x"]).ravel(), int(stats["iter_count"])
