"""What a plan promises of a tool before anything moves: sigma of the body and of the contact wrench.

By the model of the identification itself (`truewrench.tool`): the information of the poses at the gain, the
body and the rates of drift that are believed beforehand; of a motion, that of a log simulated without faults.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from truewrench.estimation.static_poses import REPEATABILITY, SETTLE, WALK, Poses
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.model.log import Log
from truewrench.model.rig import PayloadSpec, Rig
from truewrench.tool.bodies import inertia_std
from truewrench.tool.identify import DETERMINED, identify_tool
from truewrench.tool.model_rows import Problem
from truewrench.tool.parameters import ELEMENTS, second_moments
from truewrench.tool.prior import Prior, make_prior, widening
from truewrench.tool.solve import solve

CONTACT_AVERAGE = 0.02  # [s] over which a contact wrench is taken: the kernel of `apply --tool`
LATER = 3600.0  # [s] after the last pose, for what drift adds


@dataclass(frozen=True, slots=True, eq=False)
class ToolPrediction:
    """1 sigma of what an identification will say."""

    mass: float  # that is expected [kg]
    mass_std: float  # [kg]
    center_of_mass_std: Array  # (3,) [m]
    inertia_std: Array | None  # (6,) in the order of `ELEMENTS` [kg m^2]; None where nothing is accelerated
    offset_std: Array  # (n,) at the end [raw units]
    gain_std: Array  # (n, 6) [raw units per N or N m]
    determined: Mapping[str, Any]  # `mass`, `center_of_mass` (3), `inertia` (6), as tool.yaml says it
    # (6,) of a contact wrench at rest, right after the last pose, RMS over the poses [N, N m]
    contact_std: Array
    contact_std_later: Array  # (6,) an hour after it, without a tare

    def to_mapping(self) -> dict[str, Any]:
        """As PLAN.plan.yaml holds it."""
        told = self.inertia_std
        return {
            "mass_std": self.mass_std,
            "center_of_mass_std": self.center_of_mass_std.tolist(),
            "inertia_std": None if told is None else dict(zip(ELEMENTS, told.tolist(), strict=True)),
            "offset_std": self.offset_std.tolist(),
            "determined": {
                "mass": bool(self.determined["mass"]),
                "center_of_mass": [bool(one) for one in self.determined["center_of_mass"]],
                "inertia": dict(zip(ELEMENTS, map(bool, self.determined["inertia"]), strict=True)),
            },
            "contact_std": self.contact_std.tolist(),
            "contact_std_after_an_hour": self.contact_std_later.tolist(),
        }


def pose_problem(
    rig: Rig, prior: Prior, dwells: Array, R_sensor_root: Array, end: float, samples: float
) -> Problem:
    """The problem that `identify_tool` will solve of T poses, its readings all zero.

    The rig is that of `settings_of`. Dwells (T, 2) are begin and end of each, `end` that of the log [s];
    there are `samples` of the sensor a second.
    """
    count, n = len(dwells), rig.sensor.n
    read = np.maximum(1.0, np.round((dwells[:, 1] - dwells[:, 0] - SETTLE) * samples))
    middle = 0.5 * (dwells[:, 0] + SETTLE + dwells[:, 1])
    poses = Poses(
        np.zeros(count, dtype=np.int64),
        np.round(1e9 * middle).astype(np.int64),
        read / samples,
        np.zeros((count, n)),
        rig.sensor.noise_array**2 / read[:, None],
        R_sensor_root,
        np.full(count, np.nan),
        np.full((count, n), np.nan),
    )
    return Problem(rig, prior, poses, (round(1e9 * end),))


def predict_poses(
    source: Rig | Calibration, rig: Rig, body: PayloadSpec, dwells: Array, R_sensor_root: Array, end: float
) -> ToolPrediction:
    """Sigma after poses; arguments as for `pose_problem`, `body` the tool that is expected."""
    prior = make_prior(source, rig)
    problem = pose_problem(rig, prior, dwells, R_sensor_root, end, rig.simulate.sensor_rate)
    x = _expected(problem, body)
    readings = problem.of_poses(x)[0]  # what this body would be read as: the information at it is wanted
    problem = replace(problem, poses=replace(problem.poses, raw=readings))
    solution = solve(problem, x, sizes=np.log([WALK, REPEATABILITY]))
    P = solution.covariance * widening(prior.gain_std)
    return _prediction(problem, x, P, rig, body, moved=False)


def predict_motion(source: Rig | Calibration, rig: Rig, body: PayloadSpec, log: Log) -> ToolPrediction:
    """Sigma after a motion, by a log of it that was simulated with the expected tool and no faults."""
    tool = identify_tool(source, log)
    prior = make_prior(source, rig)
    R = _directions(rig)
    problem = pose_problem(rig, prior, np.tile([0.0, 2.0 * SETTLE], (len(R), 1)), R, 2.0 * SETTLE, 1.0)
    return _prediction(problem, _expected(problem, body), tool.covariance, rig, body, moved=True)


def _directions(rig: Rig) -> Array:
    """Attitudes R_sensor_root (K, 3, 3) in which a contact is looked at: all about; one without gravity."""
    if not rig.in_gravity:
        return np.eye(3)[None]
    from truewrench.planning.tool.directions import axes_of, spread

    down = rig.gravity_array / np.linalg.norm(rig.gravity_array)
    return np.array([axes_of(fall) @ axes_of(down).T for fall in spread(12, down, np.pi)])


def _expected(problem: Problem, body: PayloadSpec) -> Array:
    x, layout = problem.prior_of_all()[0], problem.vector.layout
    elements = np.array([getattr(body.inertia, name) for name in ELEMENTS])
    x[layout.log_mass] = np.log(body.mass)
    x[layout.center_of_mass] = body.center_of_mass_array
    x[layout.S] = second_moments(body.mass, elements)
    return x


def _prediction(
    problem: Problem, x: Array, P: Array, rig: Rig, body: PayloadSpec, *, moved: bool
) -> ToolPrediction:
    layout, n = problem.vector.layout, rig.sensor.n
    before = np.sqrt(np.diag(problem.prior_of_all()[1]))
    std = np.sqrt(np.diag(P))
    place = layout.body
    inertia, inertia_before = (
        _inertia_std(x[place], covariance[place, place]) for covariance in (P, np.diag(before**2))
    )
    contact, later = _contact(problem, x, P, rig)
    return ToolPrediction(
        mass=body.mass,
        mass_std=body.mass * float(std[layout.log_mass]),
        center_of_mass_std=std[layout.center_of_mass],
        inertia_std=inertia if moved else None,
        offset_std=std[layout.offset],
        gain_std=std[layout.gain].reshape(n, 6),
        determined={
            "mass": std[layout.log_mass] < DETERMINED * before[layout.log_mass],
            "center_of_mass": std[layout.center_of_mass] < DETERMINED * before[layout.center_of_mass],
            "inertia": (inertia < DETERMINED * inertia_before) & moved,
        },
        contact_std=contact,
        contact_std_later=later,
    )


def _inertia_std(body: Array, P: Array) -> Array:
    """(6,) of the inertia's elements: of the mass where P holds it, else of S alone."""
    told = np.array([P[0, 0] < 1.0, *[True] * 9])
    return inertia_std(body, P * np.outer(told, told))


def _contact(problem: Problem, x: Array, P: Array, rig: Rig) -> tuple[Array, Array]:
    """RMS sigma (6,) over the poses at rest, at the time of the offset and `LATER`: J P J^T and noise."""
    layout, sensor = problem.vector.layout, rig.sensor
    back = np.linalg.pinv(x[layout.gain].reshape(sensor.n, 6) / sensor.noise_array[:, None])
    back = back / sensor.noise_array  # weighted by the noise
    _, J = problem.of_poses(x)
    at = np.einsum("in,ntp->tip", back, J[:, :, : len(P)])
    own = np.einsum("tip,pq,tiq->ti", at, P, at)
    own += (back**2) @ (sensor.noise_array**2) * _kernel_square(CONTACT_AVERAGE, rig.simulate.sensor_rate)
    drift = (back**2) @ ((WALK * sensor.channel_scale) ** 2 * LATER)
    squares = own.mean(axis=0)
    return np.sqrt(squares), np.sqrt(squares + drift)


def _kernel_square(window: float, rate: float) -> float:
    """|k|^2 of the kernel of the contact wrench, on samples of the sensor."""
    n = 1 + 2 * max(1, round(0.5 * window * rate))
    j = np.arange(1, n)
    weights = 6.0 * j * (n - j) / (n * (n**2 - 1.0))
    k = 0.5 * (np.append(weights, 0.0) + np.append(0.0, weights))
    return float(k @ k)
