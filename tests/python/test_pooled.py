"""Logs of motion and of static poses in one calibration: the sigma of both, and mistakes in either told."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.stats import chi2
from test_still_poses import poses, settings_of, written

import truewrench as tw
from truewrench.calibrating.pooled import Pooled, estimate_pooled
from truewrench.calibrating.still_poses import estimate_still
from truewrench.cli import main
from truewrench.estimation.estimator import estimate
from truewrench.estimation.joint import Joint
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

Array = NDArray[np.float64]

BODIES = {"default": (0.8, [0.02, -0.01, 0.05]), "other": (0.6, [-0.03, 0.04, 0.02])}


def stated(uncertainty: float = 0.01) -> dict[str, Any]:
    settings = settings_of(BODIES, uncertainty=uncertainty)
    settings["sensor"] |= {"discrepancy": 0, "time_offset_prior": 1e-3}
    settings["gravity_tilt_prior"] = 0.0
    settings["plan"] = {"duration": 10}
    settings["simulate"] = {"rate": 100, "payload": "nominal"}
    return settings


class Case:
    """A sensor, motion with one payload and poses with it and another; both drawn from what is stated."""

    def __init__(self, seed: int, *, heavier: float = 1.0) -> None:
        draw, settings = np.random.default_rng(seed), stated()
        self.rig = Rig.from_mapping(settings)
        true = deepcopy(settings)
        for name, payload in true["payloads"].items():
            payload["mass"] *= 1.0 + 0.01 * draw.normal()
            payload["center_of_mass"] = (np.array(BODIES[name][1]) + 0.002 * draw.normal(size=3)).tolist()
            payload["uncertainty"] = {"mass": 0, "center_of_mass": 0, "inertia": 0}
        at_rest = deepcopy(true)
        at_rest["payloads"]["default"]["mass"] *= heavier
        self.still, self.gain = poses(Rig.from_mapping(at_rest), seed)
        true["simulate"]["gain"] = self.gain.tolist()
        self.moved = simulate(Rig.from_mapping(true), payload="default", seed=seed).log

    def logs(self) -> list[Log]:
        return [self.moved, *self.still]

    def squares(self, found: Any) -> float:
        d = (found.gain - self.gain).ravel()
        return float(d @ np.linalg.solve(found.covariance[:36, :36], d))


def pooled(rig: Rig, logs: list[Log]) -> Pooled:
    return estimate_pooled(rig, logs, threads=0, online=False)


def test_what_is_told_of_some_parts_is_told_of_all_that_hang_on_them() -> None:
    draw = np.random.default_rng(0)
    root = draw.normal(size=(7, 9))
    P, mean = root @ root.T, draw.normal(size=7)
    joint = Joint.of_parts({"a": mean[:3], "b": mean[3:5], "c": mean[5:]}, P)
    H, R = draw.normal(size=(4, 5)), np.diag(draw.uniform(0.5, 1.0, 4))
    y = draw.normal(size=4)

    def updated(mean: Array, P: Array, H: Array) -> tuple[Array, Array]:
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        return mean + K @ (y - H @ mean), P - K @ H @ P

    # y = H (c, a, new) + e is seen by one who knows of c and a alone, and finds what is new
    whole = np.zeros((4, 8))
    whole[:, [5, 6, 0, 1]], whole[:, 7] = H[:, :4], H[:, 4]
    before = np.block([[P, np.zeros((7, 1))], [np.zeros((1, 7)), np.ones((1, 1))]])
    expected, covariance = updated(np.append(mean, 0.0), before, whole)
    at = [5, 6, 0, 1, 2]
    own = np.zeros((4, 6))
    own[:, [0, 1, 2, 3]], own[:, 5] = H[:, :4], H[:, 4]
    told = updated(np.append(mean[at], 0.0), before[np.ix_([*at, 7], [*at, 7])], own)
    found = joint.told(["c", "a"], *told, {"new": 1})
    assert np.allclose(found.mean, expected, rtol=1e-10)
    assert np.allclose(found.covariance, covariance, rtol=1e-9, atol=1e-10)
    assert found.places["new"] == slice(7, 8)


def test_both_together_are_as_good_as_they_say_and_better_than_either() -> None:
    squares = []
    for seed in range(8):
        case = Case(seed)
        found = pooled(case.rig, case.logs())
        squares.append(case.squares(found.estimate))
        assert found.agreement > 1e-4
        alone = [estimate(case.rig, [case.moved]), estimate_still(case.rig, case.still).estimate]
        trace = [np.trace(e.normalised_covariance[:36, :36]) for e in (found.estimate, *alone)]
        assert trace[0] < min(trace[1:])
    assert chi2.ppf(1e-4, 288) < sum(squares) < chi2.ppf(1.0 - 1e-4, 288)


def test_the_order_of_the_logs_says_nothing() -> None:
    case = Case(1)
    a = pooled(case.rig, case.logs()).estimate
    b = pooled(case.rig, [*case.still, case.moved]).estimate
    assert np.allclose(a.gain, b.gain, rtol=1e-12)
    assert np.allclose(a.offsets, b.offsets[[2, 0, 1]], rtol=1e-9)
    assert [len(rows.rows) > 0 for rows in b.rows] == [False, False, True]
    assert np.allclose(b.covariance[36:, 36:].diagonal(), b.offsets_std[2] ** 2, rtol=1e-9)


@pytest.mark.parametrize("estimator", ["map", "online"])
def test_a_usable_calibration_says_what_the_poses_are(tmp_path: Path, estimator: str) -> None:
    case = Case(2)
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(stated()), encoding="utf-8")
    paths = [written(log, tmp_path / f"log{k}.csv") for k, log in enumerate(case.logs())]
    named = [f"{path}@{log.payload}" for log, path in zip(case.logs(), paths, strict=True)]
    words = ["calibrate", tmp_path / "rig.yaml", *named, "-o", tmp_path / "out", "--estimator", estimator]
    assert main([str(word) for word in words]) == 0
    found = tw.load_calibration(tmp_path / "out" / "calibration.yaml")
    assert found.figures["poses"] == 24
    assert {"noise", "mass", "center_of_mass"} <= set(found.figures["limited_by"])
    assert [log.used for log in found.logs][1:] == [12, 12]
    assert set(found.payload_posterior) == set(BODIES)
    assert found.payload_posterior["other"]["mass_std"] < 0.01 * BODIES["other"][0]


def test_poses_with_another_mass_than_the_motion_are_refused() -> None:
    case = Case(3, heavier=1.1)
    verdict = tw.calibrate(case.rig, case.logs()).verdict
    assert not verdict.usable
    assert any("static poses tell another sensor" in reason for reason in verdict.reasons)


def test_a_payload_that_slips_among_the_poses_is_told_beside_motion() -> None:
    """The offset may wander so far that the poses still agree with the motion."""
    case = Case(3)
    slipped = case.still[1]
    raw = slipped.raw.copy()
    assert slipped.gravity is not None
    late = np.arange(len(raw)) >= len(raw) // 2
    mass = BODIES[slipped.payload][0]
    force = mass * slipped.gravity[late]
    moment = np.cross([0.02, 0.0, 0.0], force)
    raw[late] += np.hstack([np.zeros_like(force), moment]) @ case.gain.T
    verdict = tw.calibrate(case.rig, [case.moved, case.still[0], replace(slipped, raw=raw)]).verdict
    assert not verdict.usable
    assert any("the first and the last poses of log 3" in reason for reason in verdict.reasons)


def test_a_motion_of_another_sensor_is_named_among_poses() -> None:
    case = Case(3)
    again = Rig.from_mapping(stated() | {"plan": {"duration": 10, "seed": 8}})
    simulated = {**again.to_mapping(), "simulate": {"rate": 100, "gain": (1.02 * case.gain).tolist()}}
    louder = simulate(Rig.from_mapping(simulated), payload="default", seed=8).log
    logs = [case.still[0], case.moved, louder, case.still[1]]
    reasons = tw.calibrate(case.rig, logs).verdict.reasons
    assert any("log 2 and log 3, p =" in reason for reason in reasons)


def test_poses_beside_a_motion_that_cannot_be_solved_end_in_its_reason() -> None:
    case = Case(4)
    whole = case.moved
    assert whole.twist is not None
    assert whole.gravity is not None
    short = replace(
        whole,
        time_ns=whole.time_ns[:9],
        raw=whole.raw[:9],
        twist=whole.twist[:9],
        gravity=whole.gravity[:9],
    )
    found = tw.calibrate(case.rig, [short, *case.still])
    assert not found.verdict.usable
    assert found.verdict.reasons


def same_sensor(seed: int, count: int, heavier: float = 1.0, **odd: Any) -> tuple[Rig, list[Log], Array]:
    """Logs of one sensor, the second of another payload, or with these of `simulate`."""
    settings = stated()
    settings["sensor"] |= {"discrepancy": "auto", "noise": [2e-3] * 3 + [2e-4] * 3}
    settings["payloads"] = {"default": settings["payloads"]["default"]}
    settings["required"] = 0.05
    truth = simulate(Rig.from_mapping(settings), seed=seed).truth
    logs = []
    for k in range(count):
        own = deepcopy(settings)
        own["plan"]["seed"] = k
        own["simulate"] |= {"gain": truth.gain.tolist()} | (odd if k == 1 else {})
        own["payloads"]["default"]["mass"] *= heavier if k == 1 else 1.0
        logs.append(simulate(Rig.from_mapping(own), seed=100 * seed + k).log)
    return Rig.from_mapping(settings), logs, truth.gain


def test_one_disturbed_log_of_three_costs_what_it_tells() -> None:
    """Not what it would cost if all were as disturbed."""
    squares, sigma = [], []
    play = {"imperfections": {"hysteresis": {"size": 5e-3, "form": "play"}}}
    for seed in range(6):
        rig, logs, gain = same_sensor(seed, 3, **play)
        found, clean = (tw.calibrate(rig, some, held_out=False) for some in (logs, logs[::2]))
        d = (found.gain - gain).ravel()
        squares.append(d @ np.linalg.solve(found.covariance[:36, :36], d) / 36.0)
        sigma.append(np.sqrt(np.mean(found.gain_std[:, :3] ** 2) / np.mean(clean.gain_std[:, :3] ** 2)))
    assert np.mean(squares) < 1.4
    assert np.median(sigma) < 1.5


def test_of_two_logs_that_contradict_each_other_neither_is_believed() -> None:
    for seed in range(8):
        rig, logs, gain = same_sensor(seed, 2, heavier=1.1)
        found = tw.calibrate(rig, logs, held_out=False)
        worst = np.abs((found.gain - gain) / found.gain_std).max()
        assert not (found.verdict.usable and worst > 5.0)
