"""Results that are wrong although the verdict calls them usable: sought where a model is likely to be wrong.

    python benchmarks/confident.py --runs 200 --out out/confident

A result is wrong when any normalised gain is off by more than 6 stated sigma, or its NEES lies beyond the
1e-8 tail of chi-square. `--runs` is per kind of disturbance; `clean` has none. Rates of 100 Hz to 1 kHz, 10
to 20 s, the payload and noise cells of the case `scenario`, gain prior 0.3 and truth drawn from it,
offsets; payload and clock exact. No accuracy is required of the rigs. Where the mass is off by 5 to 10%,
the gain prior is 0.01 and the payload stated to 0.1%; `mass as stated` is the control. `contacts on a vague
rig` are in logs of 6 s with little known: gain prior 0.5, clock to 5 ms, payload to 1%, 2 mm and 5%.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import cases
import motions
import numpy as np
import runs
from numpy.typing import NDArray
from scipy.signal import lfilter

from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import SimulatedRun, simulate

Array = NDArray[np.float64]
Settings = dict[str, Any]

CELLS = ((0.02, 1e-4), (0.1, 1e-4), (0.5, 1e-4), (0.5, 1e-3), (5.0, 1e-3))
MASS = 0.05, 0.1  # error of the stated mass, relative


def settings_of(rng: np.random.Generator) -> tuple[Settings, str]:
    """A rig, and the kind of its motion."""
    cell = CELLS[rng.integers(len(CELLS))]
    rate = float(np.exp(rng.uniform(np.log(100.0), np.log(1000.0))))
    settings = cases.rig_of("scenario", cell).to_mapping()
    settings["required"] = 10.0
    settings["plan"]["duration"] = float(rng.uniform(10.0, 20.0))
    del settings["sensor"]["offset_prior"]
    settings["simulate"] |= {"gain": "random", "offset": "random", "rate": rate, "sensor_rate": rate}
    return settings, str(rng.choice(["sinusoids", "fourier"]))


def wrench_push(rig: Rig, rng: np.random.Generator, gain: Array) -> Array:
    """(n,) channels of a random wrench over their noise, 1 in the one that feels it most."""
    push = gain @ (rig.sensor.range_array * rng.standard_normal(6)) / rig.sensor.noise_array
    return np.asarray(push / np.abs(push).max())


def contacts(log: Log, rig: Rig, rng: np.random.Generator, gain: Array) -> tuple[Log, Settings]:
    """1 to 5 pulses of 3 to 30 x noise and 50 ms to 2 s, on one channel or as a wrench on all."""
    raw, noise = log.raw.copy(), rig.sensor.noise_array
    time = log.time
    size = _logarithmic(rng, 3.0, 30.0)
    length = _logarithmic(rng, 0.05, 2.0)
    for _ in range(rng.integers(1, 6)):
        start = rng.uniform(0.0, time[-1] - length)
        inside = (time >= start) & (time < start + length)
        shape = np.ones(inside.sum())
        if rng.uniform() < 0.5:
            shape = np.sin(np.pi * (time[inside] - start) / length)
        if rng.uniform() < 0.5:
            push = np.zeros(rig.sensor.n)
            push[rng.integers(rig.sensor.n)] = rng.choice([-1.0, 1.0])
        else:
            push = wrench_push(rig, rng, gain)
        raw[inside] += size * shape[:, None] * push * noise
    return replace(log, raw=raw), {"size": size, "length": length}


def offset_step(log: Log, rig: Rig, rng: np.random.Generator, gain: Array) -> tuple[Log, Settings]:
    """The offset of one channel or of all jumps, at 5 to 95% of the record, by 0.3 to 100 x noise."""
    raw, size = log.raw.copy(), _logarithmic(rng, 0.3, 100.0)
    push = _one_or_all(rng, rig.sensor.n)
    at = rng.uniform(0.05, 0.95)
    raw[log.time > at * log.time[-1]] += size * push * rig.sensor.noise_array
    return replace(log, raw=raw), {"size": size, "at": at}


def offset_drift(log: Log, rig: Rig, rng: np.random.Generator, gain: Array) -> tuple[Log, Settings]:
    """Offsets that drift, as a line or a random walk, by 0.3 to 100 x noise over the record."""
    size, walk = _logarithmic(rng, 0.3, 100.0), bool(rng.uniform() < 0.5)
    ramp = log.time / log.time[-1]
    shape = np.repeat(ramp[:, None], rig.sensor.n, axis=1)
    if walk:
        shape = np.cumsum(rng.standard_normal(log.raw.shape), axis=0) / np.sqrt(len(log.raw))
    raw = log.raw + size * shape * _one_or_all(rng, rig.sensor.n) * rig.sensor.noise_array
    return replace(log, raw=raw), {"size": size, "walk": walk}


def coloured(log: Log, rig: Rig, rng: np.random.Generator, gain: Array) -> tuple[Log, Settings]:
    """Autoregressive sensor noise of the stated size, correlated by 0.5 to 0.98 from sample to sample."""
    rho = float(1.0 - _logarithmic(rng, 0.02, 0.5))
    white = rng.standard_normal(log.raw.shape)
    white[0] /= np.sqrt(1.0 - rho**2)
    noise = np.sqrt(1.0 - rho**2) * lfilter([1.0], [1.0, -rho], white, axis=0)
    # `log` came without sensor noise
    return replace(log, raw=log.raw + rig.sensor.noise_array * noise), {"rho": rho}


def filtered(log: Log, rig: Rig, rng: np.random.Generator, gain: Array) -> tuple[Log, Settings]:
    """A sensor behind a first-order low-pass of 10 to 100 Hz, noise as large after it as stated."""
    corner = _logarithmic(rng, 10.0, 100.0)
    period = float(np.median(np.diff(log.time)))
    a = float(np.exp(-2.0 * np.pi * corner * period))
    start = a * log.raw[:1]
    signal = lfilter([1.0 - a], [1.0, -a], log.raw, axis=0, zi=start)[0]
    white = rng.standard_normal(log.raw.shape)
    white[0] /= np.sqrt(1.0 - a**2)
    noise = np.sqrt(1.0 - a**2) * lfilter([1.0], [1.0, -a], white, axis=0)
    return replace(log, raw=signal + rig.sensor.noise_array * noise), {"corner": corner}


def filtered_twist(log: Log, rig: Rig, rng: np.random.Generator, gain: Array) -> tuple[Log, Settings]:
    """Velocities behind a first-order low-pass of 10 to 100 Hz, white noise after it."""
    corner = _logarithmic(rng, 10.0, 100.0)
    a = float(np.exp(-2.0 * np.pi * corner * np.median(np.diff(log.time))))
    assert log.twist is not None
    # the noise, filtered too, is replaced: only its lag matters here
    twist = lfilter([1.0 - a], [1.0, -a], log.twist, axis=0, zi=a * log.twist[:1])[0]
    lost = rig.motion.noise_array * np.sqrt(1.0 - (1.0 - a) / (1.0 + a))
    return replace(log, twist=twist + lost * rng.standard_normal(twist.shape)), {"corner": corner}


def unchanged(log: Log, rig: Rig, rng: np.random.Generator, gain: Array) -> tuple[Log, Settings]:
    """As it is."""
    return log, {}


def sensor_noise(stated: Settings, true: Settings, rng: np.random.Generator) -> Settings:
    """The sensor's true noise is 0.3 to 3 times the stated one."""
    factor = _logarithmic(rng, 0.3, 3.0)
    true["sensor"]["noise"] = [factor * x for x in stated["sensor"]["noise"]]
    return {"factor": factor}


def twist_noise(stated: Settings, true: Settings, rng: np.random.Generator) -> Settings:
    """That of the velocities likewise."""
    factor = _logarithmic(rng, 0.3, 3.0)
    true["motion"]["noise"] = [factor * x for x in stated["motion"]["noise"]]
    return {"factor": factor}


def no_sensor_noise(stated: Settings, true: Settings, rng: np.random.Generator) -> Settings:
    """None yet: it is put on with its colour."""
    true["sensor"]["noise"] = [1e-12 * x for x in stated["sensor"]["noise"]]
    return {}


def mass(stated: Settings, true: Settings, rng: np.random.Generator) -> Settings:
    """The true mass is 5 to 10% off what is stated, and the gain trusted to 1%."""
    error = float(rng.uniform(*MASS) * rng.choice([-1.0, 1.0]))
    trusted_gain(stated, true, rng)
    true["payloads"]["default"]["mass"] *= 1.0 + error
    return {"error": error}


def trusted_gain(stated: Settings, true: Settings, rng: np.random.Generator) -> Settings:
    """The gain is trusted to 1%, and the mass is as stated."""
    known = {"mass": 1e-3, "center_of_mass": 5e-4, "inertia": 1e-2}
    for settings in (stated, true):
        settings["sensor"]["gain_prior"] = 0.01
        settings["payloads"]["default"]["uncertainty"] = known
    return {}


def vague(stated: Settings, true: Settings, rng: np.random.Generator) -> Settings:
    """Little is known beforehand, and 6 s have to do."""
    payload = {"mass": 0.01, "center_of_mass": 2e-3, "inertia": 0.05}
    for settings in (stated, true):
        settings["sensor"] |= {"gain_prior": 0.5, "time_offset_prior": 5e-3}
        settings["payloads"]["default"]["uncertainty"] = payload
        settings["plan"]["duration"] = 6.0
        settings["simulate"] |= {"payload": "random", "time_offset": "random"}
    return {}


def as_stated(stated: Settings, true: Settings, rng: np.random.Generator) -> Settings:
    """Nothing but what the rig says."""
    return {}


Prepare = Callable[[Settings, Settings, np.random.Generator], Settings]
Disturb = Callable[[Log, Rig, np.random.Generator, Array], tuple[Log, Settings]]
KINDS: dict[str, tuple[Prepare, Disturb]] = {
    "clean": (as_stated, unchanged),
    "contacts": (as_stated, contacts),
    "offset step": (as_stated, offset_step),
    "offset drift": (as_stated, offset_drift),
    "coloured noise": (no_sensor_noise, coloured),
    "low-pass sensor": (no_sensor_noise, filtered),
    "low-pass velocities": (as_stated, filtered_twist),
    "sensor noise misstated": (sensor_noise, unchanged),
    "velocity noise misstated": (twist_noise, unchanged),
    "mass off by 5-10%": (mass, unchanged),
    "mass as stated": (trusted_gain, unchanged),
    "contacts on a vague rig": (vague, contacts),
}


def problem(kind: str, campaign: int, index: int) -> tuple[Rig, Log, SimulatedRun, Settings]:
    """The rig as stated, the disturbed log, the run behind it and what was done."""
    rng = np.random.default_rng([campaign, list(KINDS).index(kind), index])
    prepare, disturb = KINDS[kind]
    stated, motion_kind = settings_of(rng)
    true = Rig.from_mapping(stated).to_mapping()
    about = {"noise": stated["sensor"]["noise"][0], "rate": stated["simulate"]["rate"], "motion": motion_kind}
    about |= prepare(stated, true, rng)
    motion, _ = motions.draw_motion(motion_kind, rng, stated["plan"]["duration"], 0.25, cases.TABLE_1)
    simulated = simulate(Rig.from_mapping(true), motion, seed=int(rng.integers(2**60)))
    rig = Rig.from_mapping(stated)
    log, more = disturb(simulated.log, rig, rng, simulated.truth.gain)
    return rig, log, simulated, about | more


def run(kind: str, campaign: int, estimator: str, index: int) -> runs.Row:
    """One row."""
    rig, log, simulated, about = problem(kind, campaign, index)
    return about | runs.calibrate_row(rig, log, simulated.truth.gain, estimator=estimator)


def _logarithmic(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _one_or_all(rng: np.random.Generator, n: int) -> Array:
    push = rng.choice([-1.0, 1.0], n)
    if rng.uniform() < 0.5:
        push *= np.arange(n) == rng.integers(n)
    return np.asarray(push)


def line(kind: str, rows: list[runs.Row]) -> list[Any]:
    """A row of the table."""
    usable = [r for r in rows if r["usable"]]
    bad = [r for r in usable if r["wrong_and_confident"]]
    reasons = runs.reasons_of(r for r in rows if not r["usable"]).most_common(3)
    return [
        kind,
        len(rows),
        len(usable),
        len(bad),
        len(rows) - len(usable),
        f"{max((r['largest_deviation'] for r in usable), default=np.nan):.1f}",
        f"{max((r['nees'] for r in usable), default=np.nan):.2f}",
        f"{np.mean([r['nees'] for r in usable]):.2f}" if usable else "-",
        " ".join(str(r["index"]) for r in bad[:6]),
        ", ".join(f"{name} {count}" for name, count in reasons),
    ]


def main() -> None:
    parser = runs.arguments(__doc__, runs=1000)
    parser.add_argument("--kind", default=",".join(KINDS))
    parser.add_argument("--estimator", default="map")
    options = parser.parse_args()
    lines = []
    for kind in options.kind.split(","):
        work = partial(run, kind, options.seed, options.estimator)
        settings = ["confident", kind, options.seed, options.estimator]
        rows = runs.gather(work, range(options.runs), options.out, options.workers, settings)
        faults = [r for r in rows if r["outcome"] == "fault"]
        for r in faults[:5]:
            print(f"fault: {kind} {r['index']}: {r['reasons'][0]}")
        lines.append(line(kind, [r for r in rows if r["outcome"] != "fault"]))
    header = (
        "kind", "runs", "usable", "wrong and confident", "refused", "largest deviation", "largest NEES/36",
        "mean NEES/36", "which", "refused most of all because",
    )  # fmt: skip
    runs.table(header, lines)


if __name__ == "__main__":
    main()
