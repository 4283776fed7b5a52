"""How well planned motions determine the gain, beside the paper's wrenches and random motions.

    python benchmarks/plans.py                      # the reference case, free of any arm
    python benchmarks/plans.py --arms               # every packaged arm, from rest to rest, in its own limits
    python benchmarks/plans.py --durations          # an arm like the SPDM's: 60 s, 10 min, an hour

Figures are RMS sigma of the normalised gains if the motion were known (oracle), payload and clock exact. How
much longer a motion takes to the same accuracy is the square of the ratio of its sigma to the optimal one's.
A is how much of its pose a motion can hide, the effect what a force of 0.1% of range that follows the pose
would move some gain by, unseen. Where `discrepancy` is 0, nothing does, and few frequencies are free.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from typing import Any, Literal

import runs

from truewrench import robots
from truewrench.model.rig import Rig, load_rig
from truewrench.planning.planner import plan
from truewrench.planning.result import Plan

REFERENCE: dict[str, Any] = {
    "sensor": {
        "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
        "feels": "payload_on_sensor",
        "noise": [0.5] * 3 + [0.05] * 3,
        "range": [500] * 3 + [50] * 3,
        "offset_prior": 0,
        "time_offset_prior": 0,
    },
    "payloads": {
        "default": {
            "mass": 50,
            "center_of_mass": [0.2, 0, 0],
            "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
            "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0},
        }
    },
    "motion": {"noise": [1e-3] * 6},
    "limits": {
        "velocity": [0.5] * 6,
        "acceleration": [1] * 3 + [1.5] * 3,
        "position": [0.5] * 3 + [0.8] * 3,
    },
    "plan": {"duration": 20, "rate": 40, "harmonics": 6, "rest_to_rest": False},
    "simulate": {"rate": 40, "sensor_rate": 40},
}
HEADER = (
    *("motion", "within limits", "oracle RMS", "time to the same accuracy"),
    *("A", "effect of 0.1%", "planning [s]"),
)


def reference(harmonics: int = 6, discrepancy: float | str = "auto") -> Rig:
    """The payload of [A00], free, periodic, 20 s at 40 Hz."""
    settings = {**REFERENCE, "plan": {**REFERENCE["plan"], "harmonics": harmonics}}
    settings["sensor"] = {**REFERENCE["sensor"], "discrepancy": discrepancy}
    if harmonics > 10:
        settings["plan"]["rate"] = 4.0 * harmonics
    return Rig.from_mapping(settings)


def rig_of(name: str, *, exact: bool = True, **changes: Any) -> Rig:
    """The rig of an arm, its section `plan` changed; payload and clock exact, or as packaged."""
    path = robots.path(name)
    settings = load_rig(path).to_mapping()
    if exact:
        for payload in settings["payloads"].values():
            payload["uncertainty"] = {"mass": 0, "center_of_mass": 0, "inertia": 0}
        settings["sensor"]["time_offset_prior"] = 0
        settings["gravity_tilt_prior"] = 0
    settings["plan"] |= changes
    return Rig.from_mapping(settings, path)


def oracle(found: Plan) -> float:
    """RMS sigma if the motion were known."""
    return float("nan") if found.prediction is None else found.prediction.oracle_rms


def compared(found: dict[str, Plan], best: Plan) -> list[list[Any]]:
    """Lines of the table: random motions of the best plan's own search, then the plans."""
    facts, least = best.design.facts or {}, oracle(best)
    lines = [
        [f"random, {kind} of those drawn", "yes", f"{sigma:.5f}", f"{(sigma / least) ** 2:.2f}", *"---"]
        for kind, sigma in (("median", facts["random_median"]), ("best", facts["random_best"]))
    ]
    for name, planned in found.items():
        sigma = oracle(planned)
        within = "yes" if planned.feasible else "no"
        times = f"{(sigma / least) ** 2:.2f}"
        hidden = ["-", "-"]
        if planned.prediction is not None:
            effect = planned.prediction.blind_to[0].effect
            hidden = [f"{planned.prediction.pose.A:.2f}", f"{effect:.2f}"]
        lines.append([name, within, f"{sigma:.5f}", times, *hidden, f"{planned.seconds:.0f}"])
    return lines


def reference_table() -> None:
    """The reference case."""
    kinds: tuple[tuple[str, Literal["A", "D"], int, float | str], ...] = (
        ("optimal, D", "D", 6, "auto"),
        ("optimal, A, discrepancy 0", "A", 6, 0.0),
        ("optimal, A", "A", 6, "auto"),
        ("optimal, A, discrepancy 1e-3", "A", 6, 1e-3),
        ("optimal, A, 10 harmonics", "A", 10, "auto"),
        ("optimal, A, 16 harmonics", "A", 16, "auto"),
    )
    found = {"wrench": plan(reference(), "wrench")}
    found |= {name: plan(reference(h, stated), criterion=kind) for name, kind, h, stated in kinds}
    runs.table(HEADER, compared(found, found["optimal, A"]))


def arms_table() -> None:
    """Every packaged arm."""
    lines = []
    for name in robots.NAMES:
        rig = rig_of(name)
        best = plan(rig)
        found = {"optimal": best}
        if not rig.in_gravity:
            found = {"wrench (not from rest)": plan(rig, "wrench")} | found
        lines += [[name, *line] for line in compared(found, best)]
    runs.table(("arm", *HEADER), lines)


def durations_table() -> None:
    """What an arm like the SPDM's reaches in a minute, ten and sixty."""
    lines = []
    for seconds in (60.0, 600.0, 3600.0):
        for words, exact in (("exact", True), ("as packaged", False)):
            found = plan(rig_of("spdm", exact=exact, duration=seconds))
            assert found.prediction is not None
            sources = ", ".join(
                f"{k.replace('_', ' ')} {v:.4f}" for k, v in found.prediction.limited_by.items()
            )
            largest = float(found.prediction.std.max())
            yes = "yes" if found.feasible else "no"
            lines.append(
                [f"{seconds:g}", words, yes, f"{found.predicted_rms:.4f}", f"{largest:.4f}", sources]
            )
    runs.table(("s", "payload and clock", "within limits", "RMS sigma", "largest", "by source"), lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", action="store_true")
    parser.add_argument("--durations", action="store_true")
    options = parser.parse_args()
    if options.arms:
        arms_table()
    if options.durations:
        durations_table()
    if not (options.arms or options.durations):
        reference_table()


if __name__ == "__main__":
    main()
