"""Logs of motion and logs of static poses in one calibration.

What motion told, gain, bodies and, where all logs share a root frame, gravity's tilt together, is the prior
of the poses (still_poses.py). Both have offsets of their own, so what the poses add to motion can be tested:
where they follow the same sensor,

    d = x - x_motion  ~  N(0, P_motion - P),

with the walk of the offset that the poses by themselves show: another would follow what does not agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from truewrench.calibrating.reference_body import Known
from truewrench.calibrating.still_agreement import agreement_of_still
from truewrench.calibrating.still_poses import (
    StillEstimate,
    compare_still,
    differing_poses,
    estimate_still,
    misfit_of_still,
    still_figures,
    still_reports,
)
from truewrench.estimation.estimate import AGREE, Estimate, no_rows, of_joint
from truewrench.estimation.estimator import estimate as estimate_motion
from truewrench.estimation.joint import Joint, body_part, explained
from truewrench.estimation.parts import InParts, is_long
from truewrench.estimation.static_poses import stands_still
from truewrench.model.arrays import Array
from truewrench.model.calibration import Assumed, LogReport
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.attitude import own_roots

T = TypeVar("T")

_TOLD = 0.05  # share of a variance that the poses take, from which on they are held against motion: tolerance


@dataclass(frozen=True, slots=True, eq=False)
class Pooled:
    """What logs of motion and of static poses say together."""

    estimate: Estimate  # of all logs, in their order
    moving: tuple[int, ...]  # which of them move
    still: StillEstimate | None = None  # what the poses of the others said beyond it; None without any
    agreement: float = 1.0  # p of the poses' departure from what motion told; 1 without poses
    alone: StillEstimate | None = None  # what the poses say by themselves
    parts: InParts | None = None  # of the logs that move, where they are long

    def reports(self, logs: Sequence[Log], reports: Sequence[LogReport]) -> tuple[LogReport, ...]:
        """Those of motion, with the poses' in their places."""
        out = list(reports)
        if self.still is not None:
            places = [k for k in range(len(logs)) if k not in self.moving]
            for k, report in zip(places, still_reports([logs[k] for k in places], self.still), strict=True):
                out[k] = report
        return tuple(out)

    def assumed(self) -> tuple[Assumed, ...]:
        """What the poses need beside the rig as stated."""
        return () if self.still is None else self.still.hidden.assumed()

    def figures(self) -> dict[str, Any]:
        """What there is to say of the poses in calibration.yaml."""
        if self.still is None:
            return {}
        return {**still_figures(self.still), "poses_agree": self.agreement}

    def worse(self, rig: Rig, logs: Sequence[Log], held_out: bool) -> list[str]:
        """What the poses have against the result."""
        if self.still is None:
            return []
        at_rest = [k for k in range(len(logs)) if k not in self.moving]
        poses = [logs[k] for k in at_rest]
        if self.agreement >= AGREE:
            reasons = misfit_of_still(self.still)
        else:
            reasons = [
                f"the static poses tell another sensor than the motion (p = {self.agreement:.1g}): something "
                "touched a pose, a payload is another than stated, or a cable pulls"
            ]
        # where the offset has taken up a slip, it agrees with motion
        if self.alone is not None and not any(rig.payloads[log.payload].unknown for log in poses):
            of_logs, of_halves = np.ones(len(logs)), np.ones(len(logs))
            of_logs[at_rest], of_halves[at_rest] = agreement_of_still(rig, poses, self.alone)
            reasons += differing_poses(logs, (of_logs, of_halves))
        return [*reasons, *compare_still(rig, poses, self.still, held_out).reasons]


def estimate_pooled(rig: Rig, logs: Sequence[Log], *, threads: int, online: bool) -> Pooled:
    """Estimate from motion, of which one log at least has some, and go on with those that are static poses.

    Threads and `online` are as of `estimate`.
    """
    moving = moving_logs(rig, logs)
    in_motion, parts = [logs[k] for k in moving], None
    if not online and is_long(rig, in_motion):
        parts = InParts(rig, in_motion, threads)
        found = parts.estimate()
    else:
        found = estimate_motion(rig, in_motion, threads=threads, online=online)
    if len(moving) == len(logs):
        return Pooled(found, moving, parts=parts)
    at_rest = [k for k in range(len(logs)) if k not in moving]
    if found.joint is None:
        offsets = np.zeros((len(at_rest), rig.sensor.n))
        std = np.tile(rig.sensor.offset_prior_array, (len(at_rest), 1))
        return Pooled(_spread(found, len(logs), moving, offsets, std), moving, parts=parts)
    largest = logs[max(zip(moving, found.rows, strict=True), key=lambda pair: pair[1].samples)[0]]
    one_root = not any(len(own_roots(rig, log, twists=online)) for log in in_motion)
    one_root &= not any(len(own_roots(rig, logs[k])) for k in at_rest)
    before = Known.of_motion(rig, found.joint, largest.payload, one_root=one_root)
    still_logs = [logs[k] for k in at_rest]
    still = estimate_still(rig, still_logs, before)
    whole = _spread(found, len(logs), moving, still.estimate.offsets, still.estimate.offsets_std)
    joint = still.known.plain(rig)
    places = {k: f"offset {j}" for j, k in enumerate(moving)}
    places |= {k: f"pose offset {j}" for j, k in enumerate(at_rest)}
    roots = {"tilt": [*range(len(logs))]}
    if not one_root:
        roots = {f"tilt {tilt.logs[0]}": [moving[j] for j in tilt.logs] for tilt in found.tilts}
        roots["tilt"] = at_rest
    told = of_joint(rig, joint, [places[k] for k in range(len(logs))], roots)
    if found.offset_temperature is None:
        told["slope_covariance"] = still.estimate.slope_covariance
    whole = replace(
        whole,
        **told,
        offset_temperature=found.offset_temperature
        if found.offset_temperature is not None
        else still.estimate.offset_temperature,
        sources=_sources(rig, joint, told["normalised_covariance"]),
        joint=joint,
    )
    whole = still.hidden.beside(rig, whole, at_rest)
    alone = estimate_still(rig, still_logs)
    agreement = _agreement(estimate_still(rig, still_logs, before, alone.sizes))
    return Pooled(whole, moving, still, agreement, alone, parts)


def moving_logs(rig: Rig, logs: Sequence[Log]) -> tuple[int, ...]:
    """Which logs are no static poses; all, if none moves."""
    every = tuple(range(len(logs)))
    if len(logs) == 1 or not rig.in_gravity:
        return every
    return tuple(k for k in every if not stands_still(rig, logs[k])) or every


def _sources(rig: Rig, joint: Joint, normalised: Array) -> dict[str, Array]:
    """1 sigma (n, 6) of the normalised gain that each source accounts for; clocks are within the noise."""
    n = rig.sensor.n
    bodies = [joint.places[name] for name in map(body_part, rig.payloads) if name in joint.places]
    places = {
        "mass": [body.start for body in bodies],
        "center_of_mass": [k for body in bodies for k in range(body.start + 1, body.stop)],
        "inertia": [
            k for name, at in joint.places.items() if name.startswith("inertia ") for k in _range(at)
        ],
        "gravity": [k for name, at in joint.places.items() if name.startswith("tilt") for k in _range(at)],
    }
    unit = 1.0 / rig.sensor.gain_unit.ravel() ** 2
    found = {name: unit * explained(joint.covariance, 6 * n, at) for name, at in places.items()}
    every = unit * explained(joint.covariance, 6 * n, [k for at in places.values() for k in at])
    found["noise"] = np.diag(normalised)[: 6 * n] - every
    sigma = {name: np.sqrt(np.maximum(v, 0.0)).reshape(n, 6) for name, v in found.items()}
    return {name: s for name, s in sigma.items() if name == "noise" or s.max() > 1e-9}


def _range(place: slice) -> range:
    return range(place.start, place.stop)


def _agreement(still: StillEstimate) -> float:
    """P of d = x - x_motion, of the parts that motion told, over the directions that the poses tell."""
    parts = list(still.before.joint.places)
    (before, P), (after, P_after) = still.before.joint.of(parts), still.known.joint.of(parts)
    scale = np.sqrt(np.diag(P))
    value, vector = np.linalg.eigh(P / np.outer(scale, scale))
    kept = value > 1e-9 * value[-1]
    white = (vector[:, kept] / np.sqrt(value[kept])).T / scale  # L^-1
    share, turn = np.linalg.eigh(np.eye(kept.sum()) - white @ P_after @ white.T)
    told = share > _TOLD
    d = (turn.T @ (white @ (after - before)))[told]
    return float(chdtrc(int(told.sum()), float(np.sum(d**2 / share[told])))) if told.any() else 1.0


def _spread(found: Estimate, count: int, moving: Sequence[int], offsets: Array, std: Array) -> Estimate:
    """The estimate of the logs that move, as one of all logs, of which the others hold no motion."""
    n = found.gain.shape[0]

    def per_log(values: Sequence[T], nothing: T) -> tuple[T, ...]:
        out = [nothing] * count
        for k, value in zip(moving, values, strict=True):
            out[k] = value
        return tuple(out)

    def column(values: NDArray[Any], nothing: Any) -> Any:
        out = np.full((count, *values.shape[1:]), nothing, dtype=values.dtype)
        out[list(moving)] = values
        return out

    at_rest = [k for k in range(count) if k not in moving]
    all_offsets, all_std = column(found.offsets, 0.0), column(found.offsets_std, 0.0)
    all_offsets[at_rest], all_std[at_rest] = offsets, std
    return replace(
        found,
        offsets=all_offsets,
        offsets_std=all_std,
        tilts=tuple(replace(tilt, logs=tuple(moving[k] for k in tilt.logs)) for tilt in found.tilts),
        clocks=per_log(found.clocks, ()),
        noise=per_log(found.noise, ()),
        slow=per_log(found.slow, ()),
        events=per_log(found.events, ()),
        steps=per_log(found.steps, ()),
        spacing=column(found.spacing, np.nan),
        unexplained=column(found.unexplained, 0.0),
        unresolved=column(found.unresolved, False),
        dropped=column(found.dropped, 0),
        p_logs=column(found.p_logs, 1.0),
        rows=per_log(found.rows, no_rows(n)),
        history_log=np.asarray(moving, np.int64)[found.history_log],
    )
