"""Time per sample of the estimators on a 60 s, 1 kHz record, one thread, beside filterpy: a markdown table.

    python benchmarks/speed.py
    python benchmarks/speed.py --arm panda_ground

Processor time of the whole call with its defaults, the least of several calls. filterpy runs the published
filter on the same rows in the same process, with F and Q formed once and H written out by hand; that both
arrive at the same state is checked. With `--arm`: joint logs of a packaged arm, beside the twist that they
amount to as a log of its own.
"""

from __future__ import annotations

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy is imported
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import cases
import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from truewrench import _core, robots
from truewrench.estimation.ekf import estimate_ekf
from truewrench.estimation.estimator import estimate
from truewrench.estimation.motion_noise import twist_noise
from truewrench.model.log import Log
from truewrench.model.rig import Rig, load_rig
from truewrench.simulation.arm import simulate_arm
from truewrench.simulation.free_body import simulate

Array = NDArray[np.float64]

CELL = (0.5, 1e-3)  # noise of force [N] and of the twist [m/s, rad/s]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--duration", type=float, default=60.0, help="of the record [s]")
    parser.add_argument("--rate", type=float, default=1000.0, help="of its samples [Hz]")
    parser.add_argument("--filterpy-rows", type=int, default=10_000, help="rows that filterpy runs over")
    parser.add_argument("--repeat", type=int, default=3, help="calls of which the fastest counts")
    parser.add_argument("--arm", help="name of a packaged arm")
    arguments = parser.parse_args()
    if arguments.arm is not None:
        joints_against_twist(arguments.arm, arguments.duration, arguments.rate, arguments.repeat)
        return

    rig, log = record(arguments.duration, arguments.rate)
    rows = len(log.raw)
    part = slice(0, min(arguments.filterpy_rows, rows))
    short = replace(log, time_ns=log.time_ns[part], raw=log.raw[part], twist=log.twist[part])

    per_sample = {
        "filterpy": seconds(lambda: filterpy_state(rig, short), 1) / len(short.raw),
        "ekf": seconds(lambda: estimate_ekf(rig, [log]), arguments.repeat) / rows,
        "online": seconds(lambda: estimate(rig, [log], threads=1, online=True), arguments.repeat) / rows,
        "map": seconds(lambda: estimate(rig, [log], threads=1), arguments.repeat) / rows,
    }
    print(f"{rows} rows, one thread, core `{_core.variant}`\n")
    print("| estimator | µs per sample | over `ekf` | filterpy over it |")
    print("|---|---|---|---|")
    for name, t in per_sample.items():
        print(f"| {name} | {t * 1e6:.2f} | {t / per_sample['ekf']:.2f} | {per_sample['filterpy'] / t:.1f} |")

    found = estimate_ekf(rig, [short]).gain.ravel()
    apart = np.abs(found - filterpy_state(rig, short)[12:]).max()
    print(f"\n`ekf` and filterpy: gains {apart:.1e} apart after {len(short.raw)} rows")


def joints_against_twist(name: str, duration: float, rate: float, repeat: int) -> None:
    """Time per row of reading and estimating."""
    path = robots.path(name)
    settings = load_rig(path).to_mapping()
    settings["plan"]["duration"] = duration
    settings["simulate"] |= {"rate": rate, "sensor_rate": rate}
    joints = Rig.from_mapping(settings, path)
    log = simulate_arm(joints).log
    of_twist = {"source": "twist", "of": "sensor", "noise": twist_noise(joints, log).tolist()}
    twist = Rig.from_mapping(settings | {"motion": of_twist, "limits": {}}, path)
    bare = replace(log, tracking=None)
    print(f"{len(log.raw)} rows of `{name}`, one thread, core `{_core.variant}`; µs per row\n")
    print("| log | map |\n|---|---|")
    for label, rig, one in (("joints", joints, bare), ("twist", twist, bare)):
        times = [seconds(partial(estimate, rig, [one], threads=1), repeat)]
        print(f"| {label} | " + " | ".join(f"{1e6 * t / len(log.raw):.1f}" for t in times) + " |")


def record(duration: float, rate: float) -> tuple[Rig, Log]:
    """The motion of `scenario`, longer and faster."""
    true = cases.problem("scenario", CELL, 0).gain.tolist()
    motion = replace(cases.motion_of("scenario", 0), duration=duration)
    known = cases.rig_of("scenario", CELL, gain=true, rate=rate, sensor_rate=rate)
    return cases.rig_of("scenario", CELL), simulate(known, motion, seed=0).log


def seconds(work: Callable[[], object], repeat: int) -> float:
    """Least processor time of some calls."""
    taken = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return min(taken)


def filterpy_state(rig: Rig, log: Log) -> Array:
    """The published filter on an even record without offset and gravity; its state (48,)."""
    assert log.twist is not None
    defaults = _core.EkfSettings()
    payload = rig.payloads[log.payload]
    mass, c, inertia = payload.mass, cross_matrix(payload.center_of_mass_array), payload.inertia_matrix
    by_acceleration = -np.block([[mass * np.eye(3), np.zeros((3, 3))], [mass * c, inertia]])
    dt = float(log.time_ns[1] - log.time_ns[0]) * 1e-9

    ekf = ExtendedKalmanFilter(48, 12)
    ekf.x = np.concatenate([np.zeros(12), rig.sensor.nominal_gain_array.ravel()])
    prior = rig.sensor.gain_prior * rig.sensor.channel_scale[:, None] / rig.sensor.range_array
    start = [defaults.twist_variance, defaults.acceleration_variance, prior.ravel() ** 2]
    ekf.P = np.diag(np.concatenate(start))
    ekf.F = np.eye(48)
    ekf.F[:6, 6:12] = dt * np.eye(6)
    density = np.diag(defaults.process_density)
    ekf.Q = np.zeros((48, 48))
    ekf.Q[:12, :12] = np.block(
        [[dt**3 / 3 * density, dt**2 / 2 * density], [dt**2 / 2 * density, dt * density]]
    )
    ekf.R = np.diag(np.concatenate([rig.sensor.noise_array**2, rig.motion.noise_array**2]))

    H = np.zeros((12, 48))
    H[6:, :6] = np.eye(6)
    by_twist = np.zeros((6, 6))

    def wrench(x: Array) -> Array:
        v, omega, a = x[:3], x[3:6], x[6:12]
        f = mass * (a[:3] + np.cross(omega, v))
        n = inertia @ a[3:] + np.cross(omega, inertia @ omega)
        return -np.concatenate([f, c @ f + n])

    def jacobian(x: Array) -> Array:
        gain, turning, moving = x[12:].reshape(6, 6), cross_matrix(x[3:6]), cross_matrix(x[:3])
        by_twist[:3, :3], by_twist[:3, 3:] = -mass * turning, mass * moving
        by_twist[3:, :3] = -mass * c @ turning
        by_twist[3:, 3:] = mass * c @ moving - turning @ inertia + cross_matrix(inertia @ x[3:6])
        H[:6, :6], H[:6, 6:12] = gain @ by_twist, gain @ by_acceleration
        w = wrench(x)
        for i in range(6):
            H[i, 12 + 6 * i : 18 + 6 * i] = w
        return H

    def measurement(x: Array) -> Array:
        return np.concatenate([x[12:].reshape(6, 6) @ wrench(x), x[:6]])

    for i, z in enumerate(np.hstack([log.raw, log.twist])):
        if i > 0:
            ekf.predict()
        ekf.update(z, jacobian, measurement)
    state: Array = ekf.x
    return state


def cross_matrix(x: Array) -> Array:
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


if __name__ == "__main__":
    main()
