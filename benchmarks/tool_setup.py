"""Mistakes that people make before they identify a tool: is each refused, in its own words? And healthy logs?

    python benchmarks/tool_setup.py
    python benchmarks/tool_setup.py --data motion --healthy 40

Tools, gains, offsets and walks as in unknown_tools.py; every mistake is made in the same logs. Refused is a
tool of status 3, or a log that is bad input (2); a word counts where the reason names the mistake. A force
scale that is off by 10% leaves no trace: there it counts that the result says so. The last mistakes are of
a second log; healthy logs are tried alone, and in pairs. Intervals are
Clopper-Pearson's, 95%. The recipe of ten linear parameters refuses nothing: by how much its mass is off, in
the median.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta
from tool_draws import LAYOUT, draw, motion, poses, rig_of
from tool_recipe import fitted

import truewrench as tw
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.robot.attitude import free_fall
from truewrench.tool.bodies import weight

Array = NDArray[np.float64]
Spoil = Callable[[np.random.Generator, Log, Array], Log]
GAIN_PRIOR = 0.02


@dataclass(frozen=True)
class Mistake:
    """What is done to a log, where, and a word of the reason that names it."""

    word: str
    spoil: Spoil
    data: tuple[str, ...] = ("poses", "motion")
    theta: Callable[[Array], Array] = lambda theta: theta
    rig: Callable[[Rig], Rig] = lambda rig: rig
    seen: bool = True
    second: Callable[[Array], Array] | None = None  # theta of a second log


def turned(log: Log, turn: Array) -> Log:
    return replace(log, raw=log.raw @ np.kron(np.eye(2), turn).T)


def scaled(log: Log, by: list[float]) -> Log:
    return replace(log, raw=log.raw * by)


def with_fall(log: Log, attitude: Array) -> Log:
    return replace(log, attitude=attitude, gravity=free_fall(RIG, attitude))


def subtracted(rng: np.random.Generator, log: Log, theta: Array) -> Log:
    assert log.gravity is not None
    w = weight(float(np.exp(theta[LAYOUT.log_mass])), theta[LAYOUT.center_of_mass], log.gravity)
    return replace(log, raw=log.raw - w)


def touched(rng: np.random.Generator, log: Log, theta: Array) -> Log:
    raw, at = log.raw.copy(), int(rng.integers(1, len(log.raw) - 1))
    raw[at] += np.append(rng.choice([-1.0, 1.0]) * np.array([4.0, -5.0, 8.0]), [0.3, 0.2, -0.1])
    return replace(log, raw=raw)


def inverted(rng: np.random.Generator, log: Log, theta: Array) -> Log:
    assert log.attitude is not None
    return with_fall(log, log.attitude * [1.0, -1.0, -1.0, -1.0])


def frozen(rng: np.random.Generator, log: Log, theta: Array) -> Log:
    assert log.attitude is not None
    return with_fall(log, np.tile(log.attitude[0], (len(log.attitude), 1)))


def equal(rng: np.random.Generator, log: Log, theta: Array) -> Log:
    assert log.attitude is not None
    first = replace(
        log,
        raw=log.raw[0] + RIG.sensor.noise_array * rng.normal(size=log.raw.shape),
    )
    return with_fall(first, np.tile(log.attitude[0], (len(log.attitude), 1)))


def slow_degrees(rng: np.random.Generator, log: Log, theta: Array) -> Log:
    """A motion ten times as slow, whose degrees could be radians."""
    assert log.twist is not None
    slow = replace(log, time_ns=log.time_ns[0] + 10 * (log.time_ns - log.time_ns[0]), twist=0.1 * log.twist)
    return degrees(rng, slow, theta)


def degrees(rng: np.random.Generator, log: Log, theta: Array) -> Log:
    assert log.twist is not None
    return replace(log, twist=np.hstack([log.twist[:, :3], np.degrees(log.twist[:, 3:])]))


def as_it_is(rng: np.random.Generator, log: Log, theta: Array) -> Log:
    return log


def first(count: int) -> Spoil:
    def cut(rng: np.random.Generator, log: Log, theta: Array) -> Log:
        assert log.twist is not None
        assert log.gravity is not None
        assert log.attitude is not None
        return replace(
            log,
            time_ns=log.time_ns[:count],
            raw=log.raw[:count],
            twist=log.twist[:count],
            gravity=log.gravity[:count],
            attitude=log.attitude[:count],
        )

    return cut


def light(theta: Array) -> Array:
    theta = theta.copy()
    theta[LAYOUT.log_mass] = np.log(0.002)
    return theta


def other_gravity(rig: Rig) -> Rig:
    return tool_rig({**rig.to_mapping(), "gravity": [0, 0, -3.71]})


def without_attitude(rng: np.random.Generator, log: Log, theta: Array) -> Log:
    return replace(log, attitude=None)


def heavier(theta: Array) -> Array:
    theta = theta.copy()
    theta[LAYOUT.log_mass] += np.log(1.03)
    return theta


def shifted(theta: Array) -> Array:
    theta = theta.copy()
    theta[LAYOUT.center_of_mass.start] += 5e-3
    return theta


def another_gain(theta: Array) -> Array:
    theta, span = theta.copy(), RIG.sensor.range_array
    change = 0.02 * np.random.default_rng(0).normal(size=(6, 6)) * span[:, None] / span
    theta[LAYOUT.gain] += change.ravel()
    return theta


SWAP = np.eye(3)[[1, 0, 2]]
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
MISTAKES: dict[str, Mistake] = {
    "weight already subtracted": Mistake("already subtracted", subtracted),
    "wrong sign": Mistake("sign", lambda rng, log, theta: replace(log, raw=-log.raw)),
    "swapped axes": Mistake("axes", lambda rng, log, theta: turned(log, SWAP)),
    "a turn of 90 deg": Mistake("axes", lambda rng, log, theta: turned(log, QUARTER)),
    "moments in N mm": Mistake("units", lambda rng, log, theta: scaled(log, [1, 1, 1, 1e3, 1e3, 1e3])),
    "attitudes inverted": Mistake("other way round", inverted),
    "attitude frozen": Mistake("direction", frozen),
    "degrees for radians": Mistake("degrees", degrees, ("motion",)),
    "degrees, a slow motion": Mistake("degrees", slow_degrees, ("motion",)),
    "gravity of another planet": Mistake("free fall of", without_attitude, rig=other_gravity),
    "one pose": Mistake("directions of gravity", first(1), ("poses",)),
    "two poses": Mistake("directions of gravity", first(2), ("poses",)),
    "poses all equal": Mistake("directions of gravity", equal, ("poses",)),
    "lighter than the noise": Mistake("No weight is felt", as_it_is, ("poses",), theta=light),
    "contact in a pose": Mistake("contact during the poses", touched, ("poses",)),
    "force scale 10% low": Mistake(
        "force scale", lambda rng, log, theta: scaled(log, [0.9, 0.9, 0.9, 1, 1, 1]), seen=False
    ),
    "a second log, 3% heavier": Mistake("different tools", as_it_is, second=heavier),
    "a second log, 5 mm off": Mistake("different tools", as_it_is, second=shifted),
    "a second log, 2% another gain": Mistake("different tools", as_it_is, second=another_gain),
}
RIG = rig_of(GAIN_PRIOR)


def verdict(rig: Rig, logs: Sequence[Log]) -> tuple[bool, str, str]:
    """Whether it is refused, the reasons, and the words for what is not determined."""
    try:
        tool = tw.identify_tool(rig, logs)
    except InputError as error:
        return True, str(error), ""
    unknown = " ".join(one.words for one in tool.verdict.undetermined)
    return not tool.verdict.usable, " ".join(tool.verdict.reasons), unknown


def plain_error(rig: Rig, logs: Sequence[Log], theta: Array, *, moving: bool) -> float:
    """Of the recipe's mass, relative; NaN where a log has no gravity."""
    if any(log.gravity is None for log in logs):
        return np.nan
    mass = float(np.exp(theta[LAYOUT.log_mass]))
    return abs(float(fitted(rig, logs, moving=moving).x[0]) / mass - 1.0)


def interval(k: int, n: int) -> str:
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return f"{100 * low:.0f}-{100 * high:.0f}%"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--healthy", type=int, default=100)
    parser.add_argument("--data", choices=("poses", "motion"), default="poses")
    parser.add_argument("--only", help="a part of a mistake's name")
    parser.add_argument(
        "--reasons", action="store_true", help="print what those say that are not in their words"
    )
    asked = parser.parse_args()
    make = poses if asked.data == "poses" else motion
    print(
        f"| {asked.data} | refused | named | of | 95% of named | seconds a log | recipe's mass off by |\n"
        "|---|---|---|---|---|---|---|"
    )
    for name, mistake in MISTAKES.items():
        if not asked.seeds or asked.data not in mistake.data or (asked.only and asked.only not in name):
            continue
        refused, named, seconds, off = 0, 0, 0.0, []
        for seed in range(asked.seeds):
            rng = np.random.default_rng(seed)
            theta = mistake.theta(draw(rng, RIG, seed))
            logs = [mistake.spoil(rng, make(rng, RIG, theta), theta)]
            if mistake.second is not None:
                logs.append(make(rng, RIG, mistake.second(theta)))
            started = time.perf_counter()
            no, reasons, unknown = verdict(mistake.rig(RIG), logs)
            seconds += time.perf_counter() - started
            off.append(plain_error(mistake.rig(RIG), logs, theta, moving=asked.data == "motion"))
            told = mistake.word in (reasons if mistake.seen else unknown)
            refused, named = refused + no, named + told
            if asked.reasons and not told:
                print(f"    seed {seed}: {'refused' if no else 'usable'}: {reasons[:300]}")
        cells = (
            name,
            refused,
            named,
            asked.seeds,
            interval(named, asked.seeds),
            f"{seconds / asked.seeds:.2f}",
            f"{100 * np.median(off):.2g}%",
        )
        print(f"| {' | '.join(map(str, cells))} |", flush=True)
    for count, name in ((1, "healthy"), (2, "healthy, two logs")):
        if not asked.healthy or asked.only:
            continue
        alarms, started = 0, time.perf_counter()
        for seed in range(asked.healthy):
            rng = np.random.default_rng(10_000 + seed)
            theta = draw(rng, RIG, seed)
            no, reasons, _ = verdict(RIG, [make(rng, RIG, theta) for _ in range(count)])
            alarms += no
            if no and asked.reasons:
                print(f"    {name} {seed}: {reasons[:300]}")
        took = (time.perf_counter() - started) / asked.healthy
        print(f"| {name} | {alarms} | | {asked.healthy} | {interval(alarms, asked.healthy)} | {took:.2f} | |")


if __name__ == "__main__":
    main()
