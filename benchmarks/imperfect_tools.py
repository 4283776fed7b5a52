"""Tools on imperfect hardware: identified from one part of a record, the contact-free wrench of the other.

    python benchmarks/imperfect_tools.py --runs 200 --workers 2 --out out/imperfect_tools

Kinds of docs/imperfections.md in turn, at ordinary sizes, log-uniform; tools, gains, mounting and the tilt
of gravity as in tool_draws.py, clocks from their prior. Of four records two move at six frequencies an
axis, 10 s and 10 s, one visits 12 planned poses, of which 8 are fitted, and one is that of a packaged arm
(MuJoCo). A step or a push happens in the first part; nothing touches the tool in the rest. Wrong: mass,
centre of mass or an inertia that is determined is more than 5 sigma away, or an axis of the wrench in half
of the rows. Coverage: of 95% intervals, of the body, and of the wrench in every tenth row; figures of
usable tools, and beside them those of the recipe of ten linear parameters, of the same records.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
import runs
import tool_joints
from imperfect import RANGES, SIX, imperfection
from numpy.typing import NDArray
from runs import interval
from scipy.spatial.transform import Rotation
from tool_draws import LAYOUT, draw, rig_of
from tool_recipe import fitted

import truewrench as tw
from truewrench import _core
from truewrench.correction.contact.log import contact
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist, Trajectory, attitude
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import UNKNOWN, tool_rig
from truewrench.model.split import rows_of
from truewrench.planning.tool.plan import plan_tool
from truewrench.robot.track import track
from truewrench.tool.parameters import ELEMENTS, channel_turn, inertia_of

Array = NDArray[np.float64]
RECORDS = ("six", "six", "poses", "joints")
GAIN_PRIOR = 0.02
POSES, FITTED = 12, 8
FIRST, WHOLE = 10.0, 20.0  # [s] of a motion
WITHIN, FAR = 1.959964, 5.0
CONTACT = float(_core.contact_limit)


@dataclass(frozen=True)
class Record:
    """A rig as its owner has it, its motion, and when [s] what is fitted ends."""

    rig: Rig
    trajectory: Trajectory | None
    end: float


@cache
def planned() -> tuple[Trajectory, float]:
    """Poses of a sensor without an arm, and the end of the last one that is fitted."""
    limits = {"velocity": [0.5] * 3 + [1.5] * 3, "acceleration": [1.0] * 3 + [3.0] * 3}
    rig = tool_rig({**rig_of(GAIN_PRIOR).to_mapping(), "limits": limits})
    plan = plan_tool(rig, poses=POSES, dwell=tool_joints.DWELL)
    return plan.design.motion, float(plan.dwells[FITTED - 1, 1])


def record_of(rng: np.random.Generator, kind: str, index: int) -> Record:
    """What is moved, and how."""
    if kind == "joints":
        rig = tool_joints.rig_of(tool_joints.ARMS[index // 64 % 2], GAIN_PRIOR)
        data = rig.to_mapping()
        data["sensor"].pop("discrepancy")
        data["plan"]["duration"] = WHOLE
        return Record(tool_rig(data, rig.path), None, FIRST)
    data = rig_of(GAIN_PRIOR).to_mapping()
    for key in ("discrepancy", "time_offset_prior"):  # imperfect hardware has both
        data["sensor"].pop(key)
    rate = float(np.exp(rng.uniform(np.log(100.0), np.log(250.0))))
    data["simulate"] = {"rate": rate, "sensor_rate": rate}
    rig = tool_rig(data)
    if kind == "poses":
        return Record(rig, *planned())
    amplitude = np.repeat([0.25, 1.0], 3) * rng.uniform(0.2, 0.7, (6, 6))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 6))
    return Record(rig, HarmonicTwist(amplitude, np.tile(SIX[:, None], (1, 6)), phase, WHOLE), FIRST)


def real_of(rng: np.random.Generator, record: Record, theta: Array, kind: str, size: float) -> Rig:
    """The rig that is simulated: the true body and gain, and what is imperfect."""
    data, mass = record.rig.to_mapping(), float(np.exp(theta[LAYOUT.log_mass]))
    elements = inertia_of(mass, theta[LAYOUT.S]).tolist()
    center = theta[LAYOUT.center_of_mass].tolist()
    data["payloads"] = {
        UNKNOWN: {
            "mass": mass,
            "center_of_mass": center,
            "inertia": dict(zip(ELEMENTS, elements, strict=True)),
        }
    }
    R6 = np.kron(np.eye(2), channel_turn(theta[LAYOUT.mounting])[0])
    data["simulate"] |= {"gain": (theta[LAYOUT.gain].reshape(6, 6) @ R6).tolist(), "time_offset": "random"}
    stated = imperfection(kind, size, rng)
    imperfections = {"gravity_tilt": "random"} | stated.pop("imperfections", {})
    if kind == "step":
        imperfections["step"]["time"] = float(rng.uniform(0.15, 0.85) * record.end)
    if kind == "contact":
        imperfections["contact"] |= {"start": float(rng.uniform(0.15, 0.7) * record.end), "duration": 1.0}
    data["simulate"] |= stated | {"imperfections": imperfections}
    return Rig.from_mapping(data, record.rig.path)


def part(rig: Rig, log: Log, chosen: NDArray[np.bool_]) -> Log:
    """Some rows, as a log of their own."""
    cut = rows_of(replace(log, tracking=None), chosen)
    if rig.motion.source == "joints":
        return track(rig, replace(cut, twist=None, gravity=None))
    return cut


def run_one(seed: int, index: int) -> runs.Row:
    """One record."""
    rng, kinds = np.random.default_rng((seed, index)), list(RANGES)
    kind, how = kinds[index % len(kinds)], RECORDS[index // len(kinds) % len(RECORDS)]
    record = record_of(rng, how, index)
    theta = draw(rng, record.rig, index)
    low, middle, _ = np.log(RANGES[kind])
    size = float(np.exp(rng.uniform(*sorted((low, middle)))))
    real = real_of(rng, record, theta, kind, size)
    simulate = tw.simulate_arm if how == "joints" else tw.simulate
    log = simulate(real, record.trajectory, seed=int(rng.integers(2**31))).log
    if record.trajectory is not None:  # a controller tells the attitude, too
        turns = Rotation.from_matrix(attitude(record.trajectory, log.time)).as_quat()
        log = replace(log, attitude=turns[:, [3, 0, 1, 2]])
    early = log.time < record.end
    before, after = part(record.rig, log, early), part(record.rig, log, ~early)
    tool = tw.identify_tool(record.rig, before, threads=1)
    found = contact(after, tool)
    rows = np.isfinite(found.chi2)
    sigma = np.sqrt(np.diagonal(found.covariance[rows], axis1=1, axis2=2))
    wrench = np.abs(found.wrench[rows] / sigma)
    body = np.abs(deviations(tool, theta))
    return {
        "outcome": "found",
        "kind": kind,
        "record": how,
        "size": size,
        "usable": tool.verdict.usable,
        "reasons": list(tool.verdict.reasons),
        "worst": float(body.max()),
        "body": float(np.mean(body < WITHIN)),
        "wrench": float(np.mean(wrench[::10] < WITHIN)),
        "worst_wrench": float(np.median(wrench, axis=0).max()),
        "contacts": float(np.mean(found.chi2[rows] > CONTACT)),
        "wrong": bool(body.max() > FAR or np.median(wrench, axis=0).max() > FAR),
        **by_recipe(record.rig, before, after, tool, theta),
    }


def by_recipe(rig: Rig, before: Log, after: Log, tool: tw.Tool, theta: Array) -> dict[str, float]:
    """Coverage of body and wrench by the recipe; inertia where the tool has it determined."""
    plain = fitted(rig, [before], moving=True)
    x, sigma = plain.body()
    mass = float(np.exp(theta[LAYOUT.log_mass]))
    true = np.concatenate([[mass], theta[LAYOUT.center_of_mass], inertia_of(mass, theta[LAYOUT.S])])
    told = np.append(np.ones(4, dtype=bool), tool.determined["inertia"])
    wrench, P = plain.contact_of(after)
    z = wrench / np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    return {
        "recipe body": float(np.mean(np.abs((x[:10] - true) / sigma[:10])[told] < WITHIN)),
        "recipe wrench": float(np.mean(np.abs(z[np.isfinite(z).all(axis=1)][::10]) < WITHIN)),
    }


def deviations(tool: tw.Tool, theta: Array) -> Array:
    """Errors of the body in sigma; inertia where it is determined."""
    error, std = tool.theta - theta, np.sqrt(np.diag(tool.covariance))
    place = np.r_[LAYOUT.log_mass, LAYOUT.center_of_mass]
    mass = float(np.exp(theta[LAYOUT.log_mass]))
    inertia = (tool.inertia - inertia_of(mass, theta[LAYOUT.S])) / tool.inertia_std
    return np.append((error / std)[place], inertia[np.array(tool.determined["inertia"])])


def line(name: str, rows: Sequence[runs.Row]) -> list[str]:
    """Of the table."""
    usable = [row for row in rows if row["usable"]]

    def share(key: str) -> str:
        return f"{100 * np.mean([row[key] for row in usable]):.1f}%" if usable else "-"

    wrong = sum(row["wrong"] for row in usable)
    return [
        name,
        str(len(rows)),
        interval(len(usable), len(rows)),
        interval(wrong, len(rows)),
        share("body"),
        share("wrench"),
        share("contacts"),
        share("recipe body"),
        share("recipe wrench"),
    ]


def main() -> None:
    options = runs.arguments(__doc__, runs=200).parse_args()
    settings = ["imperfect tools", options.seed]
    work = partial(run_one, options.seed)
    rows = runs.gather(work, range(options.runs), options.out, options.workers, settings)
    told = [row for row in rows if row["outcome"] == "found"]
    header = "kind|runs|usable|wrong and usable|body covered|wrench covered|rows called contact"
    header += "|recipe: body|wrench"
    groups = [(kind, [row for row in told if row["kind"] == kind]) for kind in RANGES]
    groups += [(f"all, {how}", [row for row in told if row["record"] == how]) for how in RECORDS[1:]]
    runs.table(header.split("|"), [line(name, of) for name, of in [*groups, ("all", told)] if of])
    for row in rows:
        if row["outcome"] != "found":
            print(f"- run {row['index']}: {row['reasons'][0]}")
        elif row["usable"] and row["wrong"]:
            where = f"run {row['index']}, {row['kind']} {row['size']:.2g}, {row['record']}"
            how = f"body {row['worst']:.1f}, wrench {row['worst_wrench']:.1f} sigma"
            print(f"- wrong and usable: {where}: {how}")


if __name__ == "__main__":
    main()
