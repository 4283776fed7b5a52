"""A calibration is judged by static poses: what a payload weighs in many directions of gravity."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tool_cases import a_rig, pose_log, swing_log

import truewrench as tw
from truewrench.judging.validation.at_rest import FEWEST, at_rest, poses_of
from truewrench.model.calibration import Calibration
from truewrench.model.log import Log
from truewrench.model.rig import Rig

MASS, CENTER = 3.0, np.array([0.02, -0.01, 0.1])
INERTIA = np.diag([0.03, 0.028, 0.02])


@pytest.fixture(scope="module")
def rig() -> Rig:
    settings: dict[str, Any] = a_rig(
        sensor={"gain_prior": 0.05},
        motion={"source": "twist", "of": "sensor", "noise": [1e-3] * 6},
        required=0.5,
    )
    inertia = dict(zip(("xx", "yy", "zz"), np.diag(INERTIA).tolist(), strict=True))
    payload = {"mass": MASS, "center_of_mass": CENTER.tolist(), "inertia": inertia}
    settings["payloads"] = {"tool": {**payload, "uncertainty": {"mass": 1e-3, "center_of_mass": 5e-4}}}
    return Rig.from_mapping(settings)


def read(rig: Rig, log: Log, gain: np.ndarray, seed: int) -> Log:
    """What a sensor of a gain reads: noise of the channels as stated."""
    noise = np.random.default_rng(seed).normal(size=log.raw.shape) * rig.sensor.noise_array
    return replace(log, raw=log.raw @ gain.T + noise)


def quiet(rig: Rig) -> Rig:
    return rig.model_copy(update={"sensor": rig.sensor.model_copy(update={"noise": (1e-9,) * 6})})


def weighed(rig: Rig, gain: np.ndarray, seed: int, poses: int = 16, walk: float = 1e-4) -> Log:
    log, _ = pose_log(quiet(rig), MASS, CENTER, poses=poses, seed=seed, walk=walk)
    return read(rig, log, gain, seed)


@pytest.fixture(scope="module")
def gain(rig: Rig) -> np.ndarray:
    span = rig.sensor.range_array
    return np.eye(6) + 0.03 * np.random.default_rng(0).normal(size=(6, 6)) * span[:, None] / span


@pytest.fixture(scope="module")
def moved(rig: Rig, gain: np.ndarray) -> Calibration:
    """By motion."""
    log = swing_log(quiet(rig), MASS, CENTER, INERTIA, seed=1, seconds=20.0)
    return tw.calibrate(rig, read(rig, log, gain, 1))


def test_a_sound_gain_passes_however_the_offset_walks(rig: Rig, gain: np.ndarray, moved: Calibration) -> None:
    still = tw.calibrate(rig, weighed(rig, gain, 2, 24))
    for calibration in (moved, still):
        assert calibration.verdict.usable, calibration.verdict.reasons
        for seed, (poses, walk) in enumerate([(8, 1e-5), (8, 1e-3), (16, 1e-4), (24, 1e-3)], 10):
            found = tw.validate(calibration, rig, weighed(rig, gain, seed, poses, walk))
            assert found.verdict.usable, found.verdict.reasons
            assert found.samples == poses
            assert found.held_out
            assert all(axis.better is not False for axis in found.axes.values())


def test_an_axis_that_is_off_is_told(rig: Rig, gain: np.ndarray, moved: Calibration) -> None:
    for axis, name in enumerate(("fx", "fy", "fz")):
        off = moved.gain.copy()
        off[axis] *= 1.1
        judged = replace(moved, gain=off, inverse=np.linalg.inv(off))
        found = tw.validate(judged, rig, weighed(rig, gain, 20 + axis))
        assert not found.verdict.usable
        assert not found.axes[name].keep


def test_motion_and_poses_are_judged_together(rig: Rig, gain: np.ndarray, moved: Calibration) -> None:
    swing = read(rig, swing_log(quiet(rig), MASS, CENTER, INERTIA, seed=30), gain, 30)
    found = tw.validate(moved, rig, [swing, weighed(rig, gain, 31)])
    assert found.verdict.usable, found.verdict.reasons
    assert found.samples > 500


def test_sizes_are_those_of_the_walk_and_the_claim_is_honest(rig: Rig, gain: np.ndarray) -> None:
    """Variance of a pose by what is found, over what was drawn: of 12 logs the mean."""
    truth = 5e-4
    share = []
    for seed in range(40, 52):
        log = weighed(rig, gain, seed, 24, truth)
        short, poses = poses_of(rig, log)
        assert short.gravity is not None
        wrench = rig.sensor.sign * MASS * np.hstack([short.gravity, np.cross(CENTER, short.gravity)])
        found = at_rest(rig, log, poses, wrench)
        seconds = 1e-9 * (log.time_ns - log.time_ns[0])
        K = truth**2 * np.minimum(seconds[:, None], seconds)
        centre = np.eye(24) - 1.0 / 24
        expected = (
            np.trace(centre @ K @ centre)
            + np.sum((rig.sensor.noise_array / rig.sensor.channel_scale) ** 2) * 4
        )
        share.append(
            (np.trace(found.walk) + np.sum(found.variance / rig.sensor.channel_scale**2) / 6) / expected
        )
    assert np.mean(share) == pytest.approx(1.0, abs=0.3)


def test_too_few_poses_are_refused(rig: Rig, gain: np.ndarray, moved: Calibration) -> None:
    with pytest.raises(tw.InputError, match=f"at least {FEWEST}, or 2 s of motion"):
        tw.validate(moved, rig, weighed(rig, gain, 60, FEWEST - 1))


def test_poses_of_which_nothing_tells_the_turn_about_gravity(
    rig: Rig, gain: np.ndarray, moved: Calibration
) -> None:
    """gx gy gz alone: a tilt of gravity points anywhere in each, and widens what is claimed."""
    log = replace(weighed(rig, gain, 70), attitude=None)
    tilted = rig.model_copy(update={"gravity_tilt_prior": 0.02})
    narrow, wide = (tw.validate(moved, one, log) for one in (rig, tilted))
    assert narrow.verdict.usable
    assert wide.verdict.usable
    assert wide.axes["fx"].nis < narrow.axes["fx"].nis
    assert wide.tilts == (0.0,)
