"""Logs without attitude whose motion falls silent: nothing tells how the body turned meanwhile."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from test_root_frames import TILT, G, stated

import truewrench as tw
from truewrench.estimation.bound import information
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.estimator import estimate
from truewrench.estimation.parts import InParts
from truewrench.judging.validation import validate
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.attitude import attitude_of

Array = NDArray[np.float64]

RATE, FINE = 100, 10  # samples per second, steps of the attitude per sample
RIG = Rig.from_mapping(stated() | {"required": 0.1})
LONG, SHORT = ((9.0, 11.0),), tuple((2.0 + 3 * k, 2.2 + 3 * k) for k in range(6))  # [s]


@dataclass(frozen=True)
class Record:
    """A rigid body by Newton and Euler, six frequencies an axis, which turns by 1.8 rad in long silences."""

    log: Log
    gain: Array
    offset: Array
    R_root_sensor: Array

    @staticmethod
    def of(
        seed: int, silent: tuple[tuple[float, float], ...], lean: float = 1.0, seconds: int = 20
    ) -> Record:
        rng, n, h = np.random.default_rng(seed), seconds * RATE, 1.0 / (RATE * FINE)
        omega = 2.0 * np.pi * rng.uniform(0.1, 1.0, (6, 6))
        size = 0.15 * rng.uniform(0.5, 1.0, (6, 6)) * np.sqrt(omega / (2.0 * np.pi))
        phase = rng.uniform(0.0, 6.0, (6, 6))

        def moves(t: Array) -> tuple[Array, Array]:
            angle = omega * t[:, None, None] + phase
            nu, a = np.sum(size * np.sin(angle), axis=2), np.sum(size * omega * np.cos(angle), axis=2)
            for begin, end in (s for s in silent if s[1] - s[0] > 1.0):
                x = np.clip((t - begin) / (end - begin), 0.0, 1.0)
                nu[:, 5] += 1.8 * 30.0 * (x * (1.0 - x)) ** 2 / (end - begin)
                a[:, 5] += 1.8 * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (end - begin) ** 2
            return nu, a

        t = np.arange(n) / RATE
        steps = Rotation.from_rotvec(h * moves((np.arange(n * FINE) + 0.5) * h)[0][:, 3:]).as_matrix()
        R = np.empty((n, 3, 3))
        R[0] = Rotation.from_euler("z", rng.uniform(0.0, 6.0)).as_matrix()
        for k in range(1, n):
            R[k] = R[k - 1]
            for step in steps[(k - 1) * FINE : k * FINE]:
                R[k] = R[k] @ step
        g = Rotation.from_rotvec([*(lean * TILT * rng.normal(size=2)), 0.0]).apply(G) @ R
        nu, a = moves(t)
        spec = RIG.payloads["default"]
        m, c, inertia = (
            spec.mass * (1.0 + 0.01 * rng.normal()),
            spec.center_of_mass_array,
            spec.inertia_matrix,
        )
        v, turn, spin = nu[:, :3], nu[:, 3:], a[:, 3:]
        at_center = a[:, :3] + np.cross(turn, v) + np.cross(spin, c) + np.cross(turn, np.cross(turn, c))
        f = m * (at_center - g)
        w = -np.hstack([f, np.cross(c, f) + spin @ inertia + np.cross(turn, turn @ inertia)])
        scale = RIG.sensor.channel_scale
        gain = np.eye(6) + 0.1 * rng.normal(size=(6, 6)) * scale[:, None] / RIG.sensor.range_array
        offset = 0.3 * RIG.sensor.offset_prior_array * rng.normal(size=6)
        raw = w @ gain.T + offset + RIG.sensor.noise_array * rng.normal(size=(n, 6))
        twist, gravity = nu + 1e-4 * rng.normal(size=(n, 6)), G @ R
        for begin, end in silent:
            twist[(t > begin) & (t < end)] = gravity[(t > begin) & (t < end)] = np.nan
        stamps = np.round(1e9 * t).astype(np.int64)
        log = Log(None, "default", "", stamps, raw, twist=twist, gravity=gravity)
        return Record(log, gain, offset, R)

    def off(self, found: Estimate) -> tuple[Array, Array]:
        """Gains (36,) and offsets (6,), in sigma."""
        gains = (found.gain - self.gain).ravel() / np.sqrt(np.diag(found.covariance)[:36])
        return gains, (found.offsets[-1] - self.offset) / found.offsets_std[-1]


@pytest.mark.parametrize("online", [False, True])
@pytest.mark.parametrize("silent", [LONG, SHORT], ids=["one of 2 s", "six of 0.2 s"])
def test_records_that_fall_silent_are_as_good_as_they_say(silent: Any, online: bool) -> None:
    gains, offsets = [], []
    for seed in range(8):
        record = Record.of(seed, silent)
        found = estimate(RIG, [record.log], online=online)
        assert found.masked_share() < 0.01
        assert not found.steps[0]
        for all_of, off in zip((gains, offsets), record.off(found), strict=True):
            all_of.append(off)
    for off in (np.concatenate(gains), np.concatenate(offsets)):
        assert np.abs(off).max() < 4.5
        assert np.sqrt(np.mean(off**2)) < 1.3


def test_short_silences_leave_the_heading_known_and_long_ones_do_not() -> None:
    for silent, most in ((SHORT, 0.02), (LONG, np.inf)):
        record = Record.of(1, silent)
        told = attitude_of(RIG, record.log)
        assert told is not None
        at = np.searchsorted(record.log.time, told[0])
        heading = told[1].transpose(0, 2, 1) @ record.R_root_sensor[at].transpose(0, 2, 1)
        turned = np.unwrap(np.arctan2(heading[:, 1, 0], heading[:, 0, 0]))
        assert np.ptp(turned) < most
    assert np.ptp(turned) > 0.5


def test_validation_knows_of_the_silence() -> None:
    log = Record.of(2, LONG).log
    found = tw.calibrate(RIG, [log])
    assert found.verdict.usable
    axes = validate(found, RIG, [log]).axes
    assert all(0.8 < axis.nis < 1.2 for axis in axes.values())


def test_parts_of_a_long_record_fall_silent_within() -> None:
    record = Record.of(5, ((20.0, 22.0), (38.0, 40.0)), lean=3.0, seconds=60)
    gains, offsets = record.off(InParts(RIG, [record.log], seconds=30.0).estimate())
    assert max(np.abs(gains).max(), np.abs(offsets).max()) < 4.0


def test_the_bound_knows_of_the_silence() -> None:
    log = Record.of(4, LONG).log
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(log.time_ns), 1))
    own, shared = (information(RIG, [of], np.eye(6))[0] for of in (log, replace(log, attitude=q)))
    assert [sum(u.group == "gravity" for u in of.unknowns) for of in (own, shared)] == [4, 2]
