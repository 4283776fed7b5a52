"""Imperfect hardware on every kind of rig, the keys that ask for it, and the truth that tells of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imperfect_cases import EIGHT, EVERYTHING, GROUND, normalised_gain, rig_of, swing, twins
from rigs import changed, two_payloads

from truewrench import robots
from truewrench.cli import main
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.rig import Rig, load_rig
from truewrench.simulation.arm import ArmRun, simulate_arm
from truewrench.simulation.free_body import simulate
from truewrench.simulation.truth import read_truth


def test_sensor_of_eight_channels_is_imperfect_in_fractions_of_each_channels_scale() -> None:
    inside = {"hysteresis": {"size": 2e-3}, "step": {"size": 0.05, "time": 4.0}}
    rig, _, time, off = twins(inside, sensor=EIGHT)
    assert off.shape == (800, 8)
    before = off[time < 3.9]
    assert np.abs(before).max() == pytest.approx(2e-3, rel=1e-6)
    assert np.abs(off[time > 4.1]).max() == pytest.approx(0.05, abs=2.1e-3)
    squares = np.array(
        simulate(rig_of({"nonlinearity": 1e-3}, sensor=EIGHT)).truth.imperfections["nonlinearity"][
            "coefficients"
        ]
    )
    assert squares.shape == (8, 21)
    assert (np.sum(squares == 1.0, axis=1) == 1).all()
    felt_most = np.argmax(np.abs(rig.sensor.nominal_gain_array) * rig.sensor.range_array, axis=1)
    j, k = np.triu_indices(6)
    assert [int(j[row == 1.0][0]) for row in squares] == felt_most.tolist()
    assert [int(k[row == 1.0][0]) for row in squares] == felt_most.tolist()


def test_forces_from_outside_stay_within_what_a_wrench_can_do_to_eight_channels() -> None:
    outside = {"cable": 1e-3, "vibration": {"size": 1e-3}, "contact": {"size": 0.1}}
    rig, run, _, off = twins(outside, sensor=EIGHT)
    gain = normalised_gain(rig, run)
    wrench = np.linalg.lstsq(gain, off.T, rcond=None)[0]
    np.testing.assert_allclose(gain @ wrench, off.T, atol=1e-9)


def numbers(told: Any) -> list[float]:
    """All numbers of what a truth tells."""
    if isinstance(told, dict | list):
        values = told.values() if isinstance(told, dict) else told
        return [number for value in values for number in numbers(value)]
    return [] if isinstance(told, str) else [told]


@pytest.mark.parametrize(
    "kind", ["cable", "drift", "random_walk", "vibration", "contact", "step", "spikes", "nonlinearity"]
)
def test_one_kind_changes_nothing_that_another_draws(kind: str) -> None:
    alone = simulate(rig_of({kind: EVERYTHING[kind]}), swing(0.5), seed=3).truth.imperfections
    together = simulate(rig_of(EVERYTHING, gravity=GROUND), swing(0.5), seed=3).truth.imperfections
    np.testing.assert_allclose(numbers(alone[kind]), numbers(together[kind]), rtol=1e-3)


def test_seed_repeats_an_imperfect_log_and_another_does_not() -> None:
    rig = rig_of(EVERYTHING, gravity=GROUND)
    log, again, other = (simulate(rig, seed=s).log for s in (1, 1, 2))
    np.testing.assert_array_equal(log.raw, again.raw)
    np.testing.assert_array_equal(log.twist, again.twist)
    assert not np.any(log.raw == other.raw)


def test_truth_that_was_written_is_the_truth_that_is_read(tmp_path: Path) -> None:
    run = simulate(
        rig_of(EVERYTHING, gravity=GROUND, simulate={"payload": "random", "imperfections": EVERYTHING})
    )
    _, path = run.write(tmp_path / "run.csv")
    truth = read_truth(path)
    assert truth.to_mapping() == run.truth.to_mapping()
    assert np.array_equal(truth.gain, run.truth.gain)
    assert list(truth.imperfections) == list(EVERYTHING)
    assert truth.imperfections["velocity_filter"] == {"hz": 20.0, "order": 2}
    assert (truth.imperfections["jitter"], truth.imperfections["noise"]) == (1e-3, 2.0)
    _, plain = simulate(rig_of()).write(tmp_path / "plain.csv")
    assert "imperfections" not in plain.read_text()
    (tmp_path / "cut.yaml").write_text(path.read_text().replace("seed:", "sed:"))
    with pytest.raises(InputError, match="seed"):
        read_truth(tmp_path / "cut.yaml")


@pytest.mark.parametrize(
    ("imperfections", "said"),
    [
        ({"hysterisis": {"size": 1e-3}}, "unknown key `hysterisis`; nearest known key: `hysteresis`"),
        ({"hysteresis": {"sise": 1e-3, "size": 1e-3}}, "hysteresis.sise: unknown key `sise`"),
        ({"hysteresis": 1e-3}, "hysteresis: found 0.001, expected a mapping"),
        ({"hysteresis": {"form": "play"}}, "hysteresis.size: missing required key"),
        ({"hysteresis": {"size": 1e-3, "form": "plya"}}, "`play` or `dahl`"),
        ({"cable": -1e-3}, "cable: found -0.001, expected a number of at least 0"),
        ({"nonlinearity": {"size": 1e-3}}, "nonlinearity: found a mapping"),
        ({"sensor_filter": {"hz": 20, "order": 3}}, "sensor_filter.order: found 3, expected 1 or 2"),
        ({"velocity_filter": {"hz": 0}}, "velocity_filter.hz: found 0, expected a number of at least 0.001"),
        (
            {"vibration": {"size": 1e-3, "hz": 900}},
            "vibration.hz: found 900, expected a number of at most 500",
        ),
        ({"spikes": {"size": 0.1, "share": 2}}, "spikes.share: found 2, expected a number of at most 1"),
        ({"gravity_tilt": "some"}, "expected `random` or a number of radians of at least 0"),
        ({"gravity_tilt": 0.01}, "gravity_tilt: found 0.01, expected gravity to tilt"),
        ({"step": {"size": 1e-3, "time": -1}}, "step.time: found -1, expected a number of at least 0"),
    ],
)
def test_keys_that_cannot_be_meant_are_refused_with_their_place(
    imperfections: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError) as refused:
        rig_of(imperfections)
    assert "simulate.imperfections" in str(refused.value)
    assert said in str(refused.value)


def test_what_the_motion_cannot_have_is_refused() -> None:
    with pytest.raises(InputError, match=r"imperfections\.step\.time.*8 s of motion"):
        simulate(rig_of({"step": {"size": 1e-3, "time": 8}}))
    with pytest.raises(InputError, match=r"imperfections\.contact\.start"):
        simulate(rig_of({"contact": {"size": 1e-3, "start": 20}}))
    with pytest.raises(InputError, match="nothing moves"):
        simulate(rig_of({"cable": 1e-3}), swing(0.5, 1.0, amplitude=0.0))


def test_stated_filter_of_the_sensor_has_to_be_simulated() -> None:
    with pytest.raises(UnsupportedError, match="sensor_filter"):
        simulate(rig_of(sensor={"lowpass_hz": 40}))
    filtered = simulate(rig_of({"sensor_filter": {"hz": 40}}, sensor={"lowpass_hz": 40}))
    assert np.isfinite(filtered.log.raw).all()


def test_defaults_are_none_and_a_rig_with_them_is_written_as_before() -> None:
    rig = rig_of()
    assert rig.simulate.imperfections is None
    assert "imperfections" not in rig.to_mapping()["simulate"]
    assert (rig.gravity_tilt_prior, rig.sensor.discrepancy) == (3.5e-3, "auto")
    full = rig_of(EVERYTHING, gravity=GROUND)
    assert Rig.from_mapping(full.to_mapping()) == full


def arm_rig(imperfections: dict[str, Any] | None, **changes: Any) -> Rig:
    rig = load_rig(robots.path("ur10_ground"))
    settings = changed(rig.to_mapping(), plan={"duration": 3.0}, simulate={"rate": 100.0}, **changes)
    settings["simulate"]["imperfections"] = imperfections
    return Rig.from_mapping(settings, rig.path)


@pytest.fixture(scope="module")
def arm_run() -> Callable[[dict[str, Any] | None], ArmRun]:
    return lambda imperfections: simulate_arm(arm_rig(imperfections))


def test_imperfect_arm_logs_late_velocities_and_true_positions(arm_run: Callable[..., ArmRun]) -> None:
    late, ideal = (arm_run({"noise": 0, **i}) for i in ({"velocity_filter": {"hz": 20}}, {}))
    assert late.log.velocity is not None
    assert ideal.log.velocity is not None
    np.testing.assert_allclose(late.log.position, ideal.log.position, atol=1e-9)  # type: ignore[arg-type]
    np.testing.assert_allclose(late.log.raw, ideal.log.raw, atol=1e-6)
    rows = np.isfinite(ideal.log.velocity[:, 0])
    time, delay = ideal.log.time_ns[rows] * 1e-9, 1 / (2 * np.pi * 20)
    logged, true = late.log.velocity[rows], ideal.log.velocity[rows]
    expected = np.stack([np.interp(time - delay, time, joint) for joint in true.T], axis=1)
    off = np.abs(logged - expected).max()
    assert off < 0.03 * np.abs(true).max()
    assert np.abs(logged - true).max() > 2 * off


def test_cable_of_an_arm_follows_its_joints(arm_run: Callable[..., ArmRun]) -> None:
    pulled, free = (arm_run({"noise": 0, **i}) for i in ({"cable": 1e-3}, {}))
    scale = load_rig(robots.path("ur10_ground")).sensor.range_array
    sampled = np.isfinite(pulled.log.raw[:, 0])
    force = (pulled.log.raw - free.log.raw)[sampled] @ np.linalg.inv(pulled.truth.gain).T / scale
    np.testing.assert_allclose(np.sqrt(np.mean(force**2, axis=0)), 1e-3, rtol=0.02)
    assert len(pulled.truth.imperfections["cable"]["pose_std"]) == 6


def test_arm_on_wholly_imperfect_hardware_keeps_its_laws(arm_run: Callable[..., ArmRun]) -> None:
    run = arm_run(EVERYTHING)
    told = run.truth.imperfections
    assert list(told) == list(EVERYTHING)
    assert run.figures()["newton_euler_disagreement"] < 1e-6  # in the gravity that acts
    assert run.log.position is not None
    assert run.log.velocity is not None
    rows = np.isfinite(run.log.velocity[:, 0])
    for logged, sigma in ((run.log.velocity, 2e-3), (run.log.position, 5e-5)):
        steps = logged[rows] / (10 * sigma)
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    acting = np.array(told["gravity_tilt"]["gravity"])
    assert np.hypot(*acting[:2]) == pytest.approx(9.81 * np.sin(5e-3), rel=1e-9)


def test_command_says_on_which_hardware_it_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.yaml"
    imperfections = {"hysteresis": {"size": 2e-3}, "drift": 1e-3}
    rig.write_text(json.dumps(changed(two_payloads("a"), simulate={"imperfections": imperfections})))

    def run(*options: str) -> str:
        assert main(["simulate", str(rig), "-o", str(tmp_path / "run.csv"), *options]) == 0
        return capsys.readouterr().out

    assert "hysteresis, drift" in run()
    answer = json.loads(run("--json"))
    assert answer["status"] == 0
    assert answer["figures"]["imperfections"] == ["hysteresis", "drift"]
    truth = read_truth(tmp_path / "run.csv.truth.yaml")
    assert truth.imperfections["hysteresis"] == {"size": 2e-3, "form": "play"}


def test_plan_promises_what_perfect_hardware_would_give() -> None:
    from truewrench.planning.prediction import ideal

    assert ideal(rig_of(EVERYTHING, gravity=GROUND)).simulate.imperfections is None
