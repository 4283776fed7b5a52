"""Pools of logs whose attitude is not logged: each begins at a heading of its own, gravity's tilt with it."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from test_still_poses import SEVERAL, poses, settings_of

import truewrench as tw
from truewrench.calibrating.pooled import estimate_pooled
from truewrench.calibrating.still_poses import estimate_still
from truewrench.estimation.bound import information
from truewrench.estimation.estimate import Estimate
from truewrench.estimation.estimator import estimate
from truewrench.estimation.parts import InParts
from truewrench.judging.words import findings
from truewrench.model.log import Log
from truewrench.model.motion.trajectory import HarmonicTwist, attitude
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

Array = NDArray[np.float64]

G = np.array([0.0, 0.0, -9.81])
TILT = 3.5e-3  # [rad]


def stated() -> dict[str, Any]:
    settings = settings_of({"default": (0.8, [0.02, -0.01, 0.05])}, uncertainty=0.01)
    settings["sensor"] |= {"discrepancy": 0, "time_offset_prior": 1e-3, "noise": [2e-3] * 3 + [2e-4] * 3}
    return settings | {"gravity_tilt_prior": TILT, "simulate": {"rate": 100, "payload": "nominal"}}


@dataclass(frozen=True)
class Pool:
    """Logs of one sensor on a base that leans, which each begin at another heading, and the truth."""

    rig: Rig
    logs: list[Log]
    gain: Array
    offsets: Array
    lean: Array  # (2,) of gravity about x and y of the base [rad]

    @staticmethod
    def of(seed: int, *, told: tuple[bool, ...], lean: float = 1.0, seconds: float = 10.0) -> Pool:
        """`told`: which logs hold their attitude; `lean`: over what the rig states."""
        draw, settings = np.random.default_rng(seed), stated()
        rig, true = Rig.from_mapping(settings), deepcopy(settings)
        body = true["payloads"]["default"]
        body["mass"] *= 1.0 + 0.01 * draw.normal()
        body["uncertainty"] = {"mass": 0, "center_of_mass": 0, "inertia": 0}
        gain = np.eye(6) + 0.1 * draw.normal(size=(6, 6)) * rig.sensor.channel_scale[:, None] / (
            rig.sensor.range_array
        )
        true["simulate"]["gain"] = gain.tolist()
        angles = lean * TILT * draw.normal(size=2)
        fall_base = Rotation.from_rotvec([*angles, 0.0]).apply(G)
        logs, offsets = [], []
        for k, known in enumerate(told):
            R_base_start = Rotation.from_euler("z", draw.uniform(0.0, 2.0 * np.pi))
            # the simulated sensor starts aligned with its root frame
            here = true | {"gravity": R_base_start.inv().apply(fall_base).tolist(), "gravity_tilt_prior": 0}
            frequency = draw.uniform(0.1, 1.0, (6, 6))
            size = 0.15 * draw.uniform(0.5, 1.0, (6, 6)) * np.sqrt(frequency)
            motion = HarmonicTwist(size, frequency, draw.uniform(0.0, 6.0, (6, 6)), seconds)
            run = simulate(Rig.from_mapping(here), motion, seed=1000 * seed + k)
            R_base_sensor = R_base_start.as_matrix() @ attitude(motion, run.log.time)
            q = Rotation.from_matrix(R_base_sensor).as_quat()[:, [3, 0, 1, 2]]
            logs.append(replace(run.log, gravity=G @ R_base_sensor, attitude=q if known else None))
            offsets.append(run.truth.offset)
        return Pool(rig, logs, gain, np.array(offsets), angles)

    def gains_off(self, found: Estimate) -> Array:
        """(36,) in sigma."""
        return np.asarray((found.gain - self.gain).ravel() / np.sqrt(np.diag(found.covariance)[:36]))

    def offsets_off(self, found: Estimate) -> Array:
        """(L, 6) in sigma."""
        return np.asarray((found.offsets - self.offsets) / found.offsets_std)


@pytest.mark.parametrize("online", [False, True])
def test_pools_of_logs_without_attitude_are_as_good_as_they_say(online: bool) -> None:
    gains, offsets = [], []
    for seed in range(5):
        pool = Pool.of(seed, told=(False,) * 3)
        found = estimate(pool.rig, pool.logs, online=online)
        assert [tilt.logs for tilt in found.tilts] == [(0,), (1,), (2,)]
        gains.append(pool.gains_off(found))
        offsets.append(pool.offsets_off(found)[-1 if online else 0 :])  # `online` knows the last log's
    for off in (np.concatenate(gains), np.concatenate(offsets)):
        assert np.abs(off).max() < 5.0
        assert np.sqrt(np.mean(off**2)) < 1.4


@pytest.mark.parametrize("online", [False, True])
def test_logs_that_hold_their_attitude_share_one_tilt(online: bool) -> None:
    pool = Pool.of(1, told=(True,) * 3)
    found = estimate(pool.rig, pool.logs, online=online)
    (tilt,) = found.tilts
    assert tilt.logs == (0, 1, 2)
    assert np.abs(pool.offsets_off(found)[-1 if online else 0 :]).max() < 4.0
    angle, true = np.linalg.norm(tilt.angles), np.linalg.norm(pool.lean)
    assert abs(angle - true) < 4.0 * tilt.std.max() < 0.2 * true


@pytest.mark.parametrize("online", [False, True])
def test_a_log_without_attitude_among_others_stands_apart(online: bool) -> None:
    pool = Pool.of(2, told=(True, False, True))
    found = estimate(pool.rig, pool.logs, online=online)
    assert [tilt.logs for tilt in found.tilts] == [(0, 2), (1,)]
    assert np.abs(pool.gains_off(found)).max() < 4.0
    assert np.abs(pool.offsets_off(found)[-1 if online else 0 :]).max() < 4.0
    # the same lean of the base, seen from another heading
    same, own = found.tilts
    if not online:
        apart = abs(np.linalg.norm(same.angles) - np.linalg.norm(own.angles))
        assert apart < 4.0 * np.hypot(same.std.max(), own.std.max())


def test_online_knows_the_shared_tilt_after_a_log_that_stands_apart() -> None:
    for seed in (0, 1, 3):
        pool = Pool.of(seed, told=(True, False, True))
        whole, forward = (estimate(pool.rig, pool.logs, online=online) for online in (False, True))
        for of in (lambda e: np.diag(e.covariance)[:36], lambda e: e.tilts[0].std ** 2):
            ratio = np.sqrt(of(forward) / of(whole))
            assert 0.9 < ratio.min() < ratio.max() < 1.4


@pytest.mark.parametrize("seed", [1, 3])
def test_parts_of_a_long_log_without_attitude_begin_anew_as_logs_do(seed: int) -> None:
    pool = Pool.of(seed, told=(False,), seconds=60.0, lean=4.0)
    found = InParts(pool.rig, pool.logs, seconds=15.0).estimate()
    assert [tilt.logs for tilt in found.tilts] == [(0,)]
    assert np.abs(pool.gains_off(found)).max() < 4.0
    assert np.abs(pool.offsets_off(found)).max() < 4.0


def test_poses_do_not_take_over_the_tilt_of_a_motion_at_another_heading() -> None:
    pool = Pool.of(4, told=(False,), lean=3.0)
    still, _ = poses(Rig.from_mapping(pool.rig.to_mapping() | {"gravity_tilt_prior": 0}), 4)
    found = estimate_pooled(pool.rig, [*still, *pool.logs], threads=0, online=False).estimate
    assert [tilt.logs for tilt in found.tilts] == [(1,), (0,)]
    moving, resting = found.tilts
    alone = estimate(pool.rig, pool.logs)
    assert np.linalg.norm(moving.angles) > 5.0 * moving.std.max()
    assert np.allclose(moving.angles, alone.tilts[0].angles, atol=3.0 * alone.tilts[0].std.max())
    assert np.abs(resting.angles).max() < 4.0 * resting.std.max()


def test_the_bound_knows_of_each_root_frame() -> None:
    pool = Pool.of(5, told=(True,) * 3)
    told, _ = information(pool.rig, pool.logs, np.eye(6))
    alone, _ = information(pool.rig, [replace(log, attitude=None) for log in pool.logs], np.eye(6))
    places = [[u.log for u in found.unknowns if u.group == "gravity"] for found in (told, alone)]
    assert places == [[None, None], [0, 0, 1, 1, 2, 2]]
    variance = [np.diag(found.covariance()) for found in (told, alone)]
    assert np.all(variance[1] >= 0.999 * variance[0])


def test_a_tilt_is_told_of_the_log_that_has_it() -> None:
    pool = Pool.of(6, told=(False, False), lean=4.0)
    found = estimate(pool.rig, pool.logs)
    told = [a.where for a in findings(found, pool.rig, pool.logs) if a.what.startswith("gravity")]
    assert told == ["log 1", "log 2"]
    one = estimate(pool.rig, pool.logs[:1])
    assert [a.where for a in findings(one, pool.rig, pool.logs[:1]) if a.what.startswith("gravity")] == [
        "all logs"
    ]
    notes = tw.calibrate(pool.rig, pool.logs).figures["notes"]
    assert not any("attitude" in note for note in notes)


@pytest.mark.parametrize("alike", [False, True])
def test_poses_of_unknown_headings_are_at_least_as_good_as_they_say(alike: bool) -> None:
    settings = settings_of(SEVERAL, uncertainty=1e-3) | {"gravity_tilt_prior": TILT}
    settings["sensor"]["noise"] = [2e-3] * 3 + [2e-4] * 3
    rig, nees, furthest = Rig.from_mapping(settings), [], []
    for seed in range(10):
        # at any heading the tilt has any direction: by chance, or alike in all poses
        logs, gain = poses(rig, seed, walk=1e-5)
        draw = np.random.default_rng(100 + seed)
        lean = TILT * np.linalg.norm(draw.normal(size=2))
        for k, log in enumerate(logs):
            assert log.gravity is not None
            to = np.array([0.3, 0.5, 0.8]) if alike else draw.normal(size=log.gravity.shape)
            axis = np.cross(log.gravity, np.cross(to, log.gravity))
            axis /= np.linalg.norm(axis, axis=1, keepdims=True)
            stated_fall = Rotation.from_rotvec(-lean * axis).apply(log.gravity)
            logs[k] = replace(log, gravity=stated_fall)
        told = estimate_still(rig, logs)
        assert told.unturned == len(told.poses)
        found = told.estimate
        off, P = (found.gain - gain).ravel(), found.covariance[:36, :36]
        nees.append(off @ np.linalg.solve(P, off) / 36)
        furthest.append(np.abs(off / np.sqrt(np.diag(P))).max())
    assert np.mean(nees) < 1.05
    assert max(furthest) < 4.0
