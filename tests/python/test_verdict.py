"""When a calibration may be used, and what is said when it may not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from truewrench.calibration import Undetermined
from truewrench.estimate.fits import group_fits
from truewrench.estimate.window_estimate import PayloadDeparture, WindowEstimate
from truewrench.estimate.windows import estimate_windows
from truewrench.io.tables import read_log
from truewrench.log import Log
from truewrench.motion.trajectory import HarmonicTwist
from truewrench.rig import Rig
from truewrench.simulation.free_body import default_trajectory, simulate
from truewrench.verdict import judge_reference, judge_windows, undetermined_directions

Array = NDArray[np.float64]

EXACT = {"mass": 0, "center_of_mass": 0, "inertia": 0}
CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")


def settings_of(**changes: Any) -> dict[str, Any]:
    inertia = {"xx": 1.5, "yy": 1.5, "zz": 0.4}
    settings: dict[str, Any] = {
        "sensor": {
            "channels": list(CHANNELS),
            "feels": "payload_on_sensor",
            "noise": [0.5, 0.5, 0.5, 0.05, 0.05, 0.05],
            "range": [500, 500, 500, 50, 50, 50],
            "gain_prior": 0.1,
            "time_offset_prior": 0,
        },
        "payloads": {
            "table_1": {"mass": 50, "center_of_mass": [0.2, 0, 0], "inertia": inertia, "uncertainty": EXACT}
        },
        "motion": {"of": "com", "noise": [1e-3] * 6},
        "plan": {"duration": 12},
    }
    for section, values in changes.items():
        settings[section] = {**settings.get(section, {}), **values} if isinstance(values, dict) else values
    return settings


def rig_of(**changes: Any) -> Rig:
    return Rig.from_mapping(settings_of(**changes))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_of()


@pytest.fixture(scope="module")
def log(rig: Rig) -> Log:
    return simulate(rig, seed=1).log


@pytest.fixture(scope="module")
def good(rig: Rig, log: Log) -> WindowEstimate:
    """An estimate without any fault, to be spoilt one fault at a time."""
    return estimate_windows(rig, [log])


def reason(rig: Rig, estimate: WindowEstimate) -> str:
    """The one reason of an unusable verdict."""
    verdict = judge_windows(rig, estimate)
    assert not verdict.usable
    assert len(verdict.reasons) == 1, verdict.reasons
    return verdict.reasons[0]


def test_a_good_log_gives_a_usable_calibration(rig: Rig, good: WindowEstimate) -> None:
    verdict = judge_windows(rig, good)
    assert verdict.usable
    assert verdict.reasons == ()
    assert verdict.undetermined == ()


def test_residuals_of_a_good_log_are_as_large_as_their_noise(good: WindowEstimate) -> None:
    fits = group_fits(good.windows)
    assert set(fits) == {"force", "moment", "v", "Omega"}
    for fit in fits.values():
        assert fit.chi_square == pytest.approx(1.0, abs=0.1)
        assert abs(fit.deviate) < 4.0


def test_iteration_that_did_not_end_is_said(rig: Rig, good: WindowEstimate) -> None:
    assert reason(rig, replace(good, converged=False)) == "the estimate did not converge"
    assert "could not be solved" in reason(rig, replace(good, solved=False))


def test_dependence_on_knots_or_windows_is_said(rig: Rig, good: WindowEstimate) -> None:
    assert "depends on the knot spacing (5.0 sigma)" in reason(rig, replace(good, knot_dependence=5.0))
    assert "depends on the length of the windows (4.2 sigma)" in reason(
        rig, replace(good, window_dependence=4.2)
    )
    for small in (replace(good, knot_dependence=3.0), replace(good, window_dependence=3.0)):
        assert judge_windows(rig, small).usable


def test_gain_without_an_inverse_is_refused(rig: Rig, good: WindowEstimate) -> None:
    dead, twins = good.gain.copy(), good.gain.copy()
    dead[2] = 0.0
    twins[2] = twins[1]
    for gain in (dead, twins):
        assert reason(rig, replace(good, gain=gain)).startswith("the gain is ")
        assert len(judge_reference(rig, gain).reasons) == 2


def test_ill_conditioned_gain_is_said_with_its_condition_number(rig: Rig, good: WindowEstimate) -> None:
    scale = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 1e-3])
    assert "ill-conditioned: condition number 1e+03" in reason(rig, replace(good, gain=scale))
    # In units of range: newtons beside millinewton metres are not ill-conditioned.
    other = rig_of(sensor={"range": [500, 500, 500, 0.05, 0.05, 0.05]})
    assert judge_windows(other, replace(good, gain=np.eye(6))).usable


def test_required_accuracy_names_the_worst_gain(rig: Rig, good: WindowEstimate) -> None:
    covariance = 1e-6 * np.eye(42)
    covariance[6 * 4 + 2, 6 * 4 + 2] = 0.03**2
    spoilt = replace(good, normalised_covariance=covariance)
    assert "the gain of my on fz has a sigma of 0.03 of range, more than the required 0.02" in reason(
        rig, spoilt
    )
    assert judge_windows(rig_of(required=0.04), spoilt).usable


def test_undetermined_directions_make_a_calibration_unusable(rig: Rig, good: WindowEstimate) -> None:
    covariance = 1e-6 * np.eye(42)
    covariance[5::6, 5::6][:6, :6] = 0.09**2 * np.eye(6)
    verdict = judge_windows(rig, replace(good, normalised_covariance=covariance))
    assert not verdict.usable
    assert "6 of 36 directions of the gain are not determined: moment about z" in verdict.reasons[0]
    assert len(verdict.undetermined) == 6


@pytest.mark.parametrize("stream", ["sensor", "motion"])
def test_noise_stated_half_as_large_is_refused_and_the_stream_named(stream: str, log: Log, rig: Rig) -> None:
    spec = settings_of()
    spec[stream]["noise"] = [0.5 * x for x in spec[stream]["noise"]]
    spoilt = Rig.from_mapping(spec)
    verdict = judge_windows(spoilt, estimate_windows(spoilt, [log]))
    assert not verdict.usable
    assert "noise stated too small" in verdict.reasons[0]
    assert any(
        name in verdict.reasons[0]
        for name in {"sensor": ("force", "moment"), "motion": ("v", "Omega")}[stream]
    )


def test_noise_stated_a_little_too_small_is_seen_in_the_sum_over_all_windows(rig: Rig, log: Log) -> None:
    """8% on a long log: no window is conspicuous, all of them together are."""
    spec = settings_of()
    spec["sensor"]["noise"][:3] = [0.92 * x for x in spec["sensor"]["noise"][:3]]
    spoilt = Rig.from_mapping(spec)
    verdict = judge_windows(spoilt, estimate_windows(spoilt, [log], "online"))
    assert not verdict.usable
    assert "residuals of force do not match the stated noise: chi-square 1.1" in " ".join(verdict.reasons)


def test_vibration_faster_than_the_samples_is_refused_with_the_reason(rig: Rig) -> None:
    base = default_trajectory(rig)
    one = np.ones((1, 6))
    motion = HarmonicTwist(
        np.concatenate([base.amplitude, 0.002 * one]), np.concatenate([base.frequency, 20.0 * one]),
        np.concatenate([base.phase, one]), 5.0,
    )  # fmt: skip
    words = reason_text(rig, simulate(rig, motion, seed=2).log)
    assert "no window of motion fits" in words
    assert "vibration, servo ripple" in words
    assert "36 of 36 directions" in words


def reason_text(rig: Rig, log: Log) -> str:
    verdict = judge_windows(rig, estimate_windows(rig, [log]))
    assert not verdict.usable
    return " ".join(verdict.reasons)


def with_contact(log: Log, first: int, last: int) -> Log:
    raw = log.raw.copy()
    raw[first:last, 1] += np.random.default_rng(0).normal(0.0, 50.0, last - first)
    return replace(log, raw=raw)


def test_a_contact_that_is_left_out_is_accepted_and_a_long_one_is_not(rig: Rig, log: Log) -> None:
    short = estimate_windows(rig, [with_contact(log, 300, 480)])  # 15% of the log
    assert short.left_out[0][300:480].mean() > 0.95
    assert judge_windows(rig, short).usable
    assert "25 % of the samples of log 1 were left out as contact or spikes" in reason_text(
        rig, with_contact(log, 450, 750)
    )


def test_a_few_rejected_samples_are_accepted_and_many_are_not(rig: Rig, log: Log) -> None:
    # Half of the log: nothing is left of the windows in it.
    assert "% of the samples lie in rejected windows (chi-square per degree of freedom up to" in reason_text(
        rig, with_contact(log, 300, 900)
    )
    # A gap that cuts off the last 6 rows, too few for a window.
    kept = np.r_[0:1100, 1194:1200]
    cut = replace(log, time_ns=log.time_ns[kept], raw=log.raw[kept], twist=np.asarray(log.twist)[kept])
    lost = estimate_windows(rig, [cut], "online")
    assert sum(w.samples for w in lost.windows if w.status.name != "fitted") == 6
    assert judge_windows(rig, lost).usable


@pytest.mark.parametrize("rows", [2, 5])
def test_a_log_too_short_says_so(rig: Rig, log: Log, rows: int) -> None:
    short = replace(log, time_ns=log.time_ns[:rows], raw=log.raw[:rows], twist=np.asarray(log.twist)[:rows])
    words = reason_text(rig, short)
    assert "no window of motion fits" in words
    assert "fewer samples than a motion needs" in words


def test_a_sensor_that_says_nothing_leaves_no_window(rig: Rig, log: Log) -> None:
    words = reason_text(rig, replace(log, raw=np.full_like(log.raw, np.nan)))
    assert "no window of motion" in words


def test_a_body_at_rest_on_orbit_teaches_nothing(rig: Rig, log: Log) -> None:
    draw = np.random.default_rng(3)
    at_rest = replace(
        log,
        raw=rig.sensor.noise_array * draw.normal(size=(1200, 6)),
        twist=1e-3 * draw.normal(size=(1200, 6)),
    )
    verdict = judge_windows(rig, estimate_windows(rig, [at_rest]))
    assert len(verdict.undetermined) == 36
    assert "36 of 36 directions" in " ".join(verdict.reasons)


def static_log(rig: Rig, poses: int = 24, rows: int = 50) -> Log:
    """A payload held still in many attitudes; the arm's way from one to the next is not logged."""
    draw = np.random.default_rng(4)
    body = next(iter(rig.payloads.values()))
    down = draw.normal(size=(poses, 3))
    gravity = np.repeat(9.81 * down / np.linalg.norm(down, axis=1, keepdims=True), rows, axis=0)
    weight = body.mass * gravity  # what the payload does to the sensor
    wrench = np.column_stack([weight, np.cross(body.center_of_mass_array, weight)])
    span = rig.sensor.range_array
    gain = (np.eye(6) + 0.2 * draw.normal(size=(6, 6))) * span[:, None] / span
    time = (10.0 * np.arange(poses)[:, None] + 0.01 * np.arange(rows)).ravel()
    return Log(
        path=None, payload=next(iter(rig.payloads)), sha256="", time_ns=np.rint(1e9 * time).astype(np.int64),
        raw=wrench @ gain.T + rig.sensor.noise_array * draw.normal(size=(time.size, 6)),
        twist=rig.motion.noise_array * draw.normal(size=(time.size, 6)), gravity=gravity,
    )  # fmt: skip


@pytest.mark.parametrize("offset_prior", [0, [1, 1, 1, 0.1, 0.1, 0.1]])
def test_static_poses_leave_18_directions_because_the_moment_is_c_cross_the_force(offset_prior: Any) -> None:
    body = {
        "mass": 0.66,
        "center_of_mass": [0.01, -0.02, 0.05],
        "inertia": {"xx": 0.002, "yy": 0.002, "zz": 0.001},
        "uncertainty": EXACT,
    }
    rig = Rig.from_mapping(
        settings_of(
            sensor={
                "range": [10, 10, 10, 1, 1, 1],
                "noise": [0.02] * 3 + [0.002] * 3,
                "gain_prior": 0.3,
                "offset_prior": offset_prior,
            },
            gravity=[0, 0, -9.81],
        )
        | {"payloads": {"tool": body}}
    )
    verdict = judge_windows(rig, estimate_windows(rig, [static_log(rig)]))
    assert len(verdict.undetermined) == 18
    assert any(words.startswith("18 of 36 directions") for words in verdict.reasons)
    # Of C = [C_f, C_m] only C_f + C_m [c] is seen, here in units of range.
    x, y, z = np.array([0.01, -0.02, 0.05]) * 10.0
    seen = np.vstack([np.eye(3), [[0, -z, y], [z, 0, -x], [-y, x, 0]]])  # normalised wrench per force
    for found in verdict.undetermined:
        np.testing.assert_allclose(found.direction.reshape(6, 6) @ seen, 0.0, atol=0.05)
    # m_x = y f_z - z f_y and so on; 0.1 of a range is not worth a word
    tied = {"x": "y and z", "y": "x", "z": "x"}
    assert {found.words for found in verdict.undetermined} == {
        f"moment about {m}, always tied to force along {f}: gains of all channels" for m, f in tied.items()
    }


@pytest.mark.external
@pytest.mark.parametrize(("tool", "count"), [("hammer", 6), ("c_clamp", 0)])
def test_what_one_swung_tool_leaves_undetermined(external_data: Path, tool: str, count: int) -> None:
    folder = external_data / "utias"
    stated = yaml.safe_load((folder / "payloads.yaml").read_text(encoding="utf-8"))["payloads"][tool]
    rig = Rig.from_mapping(
        settings_of(
            sensor={
                "feels": "sensor_on_payload",
                "range": [10, 10, 10, 1, 1, 1],
                "noise": [0.02] * 3 + [0.002] * 3,
                "gain_prior": 0.3,
            },
            motion={"of": "sensor"},
            gravity=[0, 0, -9.81],
        )
        | {"payloads": {tool: {**stated, "uncertainty": EXACT}}}
    )
    log = read_log(folder / f"{tool}.csv", rig)
    draw = np.random.default_rng(5)
    assert log.twist is not None
    log = replace(
        log, acceleration=None, twist=log.twist + 1e-3 * draw.normal(size=log.twist.shape),
        raw=log.raw + rig.sensor.noise_array * draw.normal(size=log.raw.shape),
    )  # fmt: skip
    verdict = judge_windows(rig, estimate_windows(rig, [log]))
    assert len(verdict.undetermined) == count
    if tool == "hammer":  # a handle along y: nothing turns about it
        assert {u.words for u in verdict.undetermined} == {"moment about y: gains of all channels"}


def test_a_payload_or_clock_far_from_what_the_rig_states_is_suspected(good: WindowEstimate) -> None:
    uncertain = rig_of(
        sensor={"time_offset_prior": 5e-3},
        payloads={"table_1": {**settings_of()["payloads"]["table_1"], "uncertainty": {"mass": 1e-3}}},
    )
    heavy = PayloadDeparture(np.array([5e-3, *np.zeros(9)]), np.full(10, 1e-4))
    assert "the mass of payload `table_1` is 5.0 sigma from what the rig states" in reason(
        uncertain, replace(good, payloads={"table_1": heavy})
    )
    late = replace(good, time_offsets=np.array([0.02]))
    assert "the time offset of log 1, 20 ms, is 4.0 sigma" in reason(uncertain, late)
    near = PayloadDeparture(np.array([2e-3, *np.zeros(9)]), np.full(10, 1e-4))
    assert judge_windows(
        uncertain, replace(good, payloads={"table_1": near}, time_offsets=np.array([0.01]))
    ).usable


def test_reference_estimators_are_never_usable(rig: Rig) -> None:
    verdict = judge_reference(rig, np.eye(6), ["chi-square 3"])
    assert not verdict.usable
    assert verdict.reasons == ("reference estimator", "chi-square 3")


# Directions of a constructed covariance.

PRIOR = 0.3


def covariance_with(unknown: Sequence[Array], n: int = 6) -> Array:
    """Small everywhere but along the unknown directions, which keep their prior."""
    covariance = 1e-6 * np.eye(6 * n)
    if not unknown:
        return covariance
    basis, _ = np.linalg.qr(np.column_stack(unknown))
    return np.asarray(covariance + PRIOR**2 * basis @ basis.T)


def directions(found: Sequence[Undetermined]) -> Array:
    return np.array([u.direction for u in found])


def gain_of(channel: int, axis: int, n: int = 6) -> Array:
    direction = np.zeros(6 * n)
    direction[6 * channel + axis] = 1.0
    return direction


def test_nothing_is_undetermined_where_all_is_known() -> None:
    assert undetermined_directions(covariance_with([]), PRIOR, CHANNELS) == ()


def test_half_the_prior_is_the_limit() -> None:
    covariance = covariance_with([])
    covariance[7, 7] = (0.49 * PRIOR) ** 2
    assert undetermined_directions(covariance, PRIOR, CHANNELS) == ()
    covariance[7, 7] = (0.51 * PRIOR) ** 2
    assert len(undetermined_directions(covariance, PRIOR, CHANNELS)) == 1


def test_one_unknown_gain_is_named_by_channel_and_axis() -> None:
    (found,) = undetermined_directions(covariance_with([gain_of(4, 2)]), PRIOR, CHANNELS)
    np.testing.assert_allclose(np.abs(found.direction), gain_of(4, 2), atol=1e-9)
    assert found.words == "force along z: gain of my"


@pytest.mark.parametrize("n", [6, 8])
def test_an_axis_without_excitation_is_named_once_for_all_channels(n: int) -> None:
    channels = [f"gauge_{i}" for i in range(n)]
    unknown = [gain_of(i, 3, n) for i in range(n)]
    found = undetermined_directions(covariance_with(unknown, n), PRIOR, channels)
    assert [u.words for u in found] == ["moment about x: gains of all channels"] * n


def test_an_axis_that_follows_from_another_is_named_with_it() -> None:
    u = np.array([0.0, 0.8, 0.0, 0.0, 0.0, -0.6])  # the force along y is 0.75 of the moment about z, always
    unknown = [np.kron(e, u) for e in np.eye(6)]
    found = undetermined_directions(covariance_with(unknown), PRIOR, CHANNELS)
    assert {f.words for f in found} == {"force along y, always tied to moment about z: gains of all channels"}


def test_a_silent_channel_has_six_unknown_gains() -> None:
    found = undetermined_directions(covariance_with([gain_of(2, a) for a in range(6)]), PRIOR, CHANNELS)
    assert len(found) == 6
    assert all(u.words.endswith("gain of fz") for u in found)


@pytest.mark.parametrize("count", [1, 5, 9, 20, 36])
def test_directions_are_an_orthonormal_basis_of_what_is_unknown(count: int) -> None:
    draw = np.random.default_rng(count)
    unknown = list(draw.normal(size=(count, 36)))
    covariance = covariance_with(unknown)
    found = directions(undetermined_directions(covariance, PRIOR, CHANNELS))
    assert found.shape == (count, 36)
    np.testing.assert_allclose(found @ found.T, np.eye(count), atol=1e-9)
    # Every one of them has kept its prior.
    variance = np.einsum("ki,ij,kj->k", found, covariance, found)
    np.testing.assert_allclose(np.sqrt(variance), PRIOR, rtol=1e-4)


def test_whole_axes_and_single_gains_together_are_all_counted() -> None:
    unknown = [gain_of(i, 5) for i in range(6)] + [gain_of(1, 0), gain_of(3, 4)]
    found = undetermined_directions(covariance_with(unknown), PRIOR, CHANNELS)
    words = [u.words for u in found]
    assert len(found) == 8
    assert words.count("moment about z: gains of all channels") == 6
    assert {"force along x: gain of fy", "moment about y: gain of mx"} <= set(words)
