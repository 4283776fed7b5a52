"""A channel without a signal, or at a rail, is named; a motion without some component is no fault."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from truewrench.verdict.silence import channel_faults, still_twists

from truewrench.calibration import AXES
from truewrench.log import Log
from truewrench.motion.trajectory import HarmonicTwist
from truewrench.pipeline import calibrate
from truewrench.rig import Rig
from truewrench.simulation.free_body import default_trajectory, simulate


@pytest.fixture(scope="module")
def rig() -> Rig:
    settings: dict[str, Any] = {
        "sensor": {
            "channels": list(AXES),
            "feels": "payload_on_sensor",
            "noise": [0.5, 0.5, 0.5, 0.05, 0.05, 0.05],
            "range": [500, 500, 500, 50, 50, 50],
            "gain_prior": 0.1,
            "time_offset_prior": 0,
        },
        "payloads": {
            "block": {
                "mass": 50,
                "center_of_mass": [0.2, 0, 0],
                "inertia": {"xx": 1.5, "yy": 1.5, "zz": 0.4},
                "uncertainty": {"mass": 0, "center_of_mass": 0, "inertia": 0},
            }
        },
        "motion": {"noise": [1e-3] * 6},
        "plan": {"duration": 12},
    }
    return Rig.from_mapping(settings)


@pytest.fixture(scope="module")
def log(rig: Rig) -> Log:
    return simulate(rig, seed=1).log


def with_channel(log: Log, channel: int, values: Any) -> Log:
    raw = log.raw.copy()
    raw[:, channel] = values
    return replace(log, raw=raw)


def words(rig: Rig, *logs: Log) -> list[str]:
    return [fault.words for fault in channel_faults(rig, logs)]


def test_healthy_channels_are_not_named(rig: Rig, log: Log) -> None:
    assert words(rig, log) == []
    assert still_twists([log]) == []


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (12.5, "channel mz is constant (12.5): cable, or driver"),
        (0.0, "channel mz is constant (0): cable, or driver"),
        (np.nan, "channel mz has no samples: cable, or driver"),
    ],
)
def test_silent_channel_is_the_one_reason(rig: Rig, log: Log, value: float, said: str) -> None:
    found = calibrate(rig, with_channel(log, 5, value))
    assert not found.verdict.usable
    assert found.verdict.reasons == (said,)
    if np.isnan(value):
        assert {u.words for u in found.verdict.undetermined} == {"gains of mz, which has no signal"}
        assert found.gain_determined[:5].all()
        assert not found.gain_determined[5].any()


def test_silence_in_one_of_two_logs_names_the_log(rig: Rig, log: Log) -> None:
    assert words(rig, log, with_channel(log, 2, 1.0)) == [
        "channel fz is constant (1) in log 2: cable, or driver"
    ]
    assert words(rig, with_channel(log, 2, 1.0), with_channel(log, 2, 2.0)) == [
        "channel fz is constant (1): cable, or driver"
    ]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_channel_at_a_rail_is_named(rig: Rig, log: Log, sign: float) -> None:
    values = sign * log.raw[:, 0]
    limit = float(np.quantile(values, 0.97))
    clipped = with_channel(log, 0, sign * np.minimum(values, limit))
    (said,) = words(rig, clipped)
    assert said.startswith(
        f"channel fx stands at {sign * limit:.6g}, its extreme value, for 3 % of the samples"
    )
    found = calibrate(rig, clipped)
    assert not found.verdict.usable
    assert found.verdict.reasons[0] == said


@pytest.mark.parametrize("levels", [20, 200, 4000])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_coarse_readings_and_pauses_are_no_rail(rig: Rig, levels: int, noise: float) -> None:
    draw = np.random.default_rng(levels)
    t = np.linspace(0.0, 30.0, 6000)
    sine = np.round((np.sin(t) + noise * draw.standard_normal(t.size)) * levels / 2)
    poses = np.round(np.repeat(draw.normal(size=24), 250) * levels)
    raw = np.column_stack([sine, -sine, poses, -poses, np.abs(sine), t])
    log = Log(None, "block", "", (1e9 * t).astype(np.int64), raw)
    assert words(rig, log) == []


def test_twist_that_stands_still_is_a_note_and_no_reason(rig: Rig, log: Log) -> None:
    assert log.twist is not None
    twist = log.twist.copy()
    twist[:, 5] = 0.0
    assert still_twists([replace(log, twist=twist)]) == [
        "column wz is constant (0): the motion has no such component, or it was not recorded"
    ]
    assert still_twists([replace(log, twist=np.zeros_like(twist))]) == []  # a static log
    assert still_twists([replace(log, twist=None)]) == []


def test_planar_motion_is_calibrated_from_with_a_note(rig: Rig) -> None:
    base = default_trajectory(rig)
    amplitude = base.amplitude.copy()
    amplitude[:, 5] = 0.0
    planar = HarmonicTwist(amplitude, base.frequency, base.phase, base.duration)
    log = simulate(rig, planar, seed=3).log
    assert log.twist is not None
    twist = log.twist.copy()
    twist[:, 5] = 0.0  # a driver that fills what its arm does not have
    found = calibrate(rig, replace(log, twist=twist))
    assert "column wz is constant" in found.figures["notes"][0]
    assert not any("wz" in reason for reason in found.verdict.reasons)
