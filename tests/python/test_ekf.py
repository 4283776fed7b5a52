"""The published filter: the core against a textbook version, and the estimator built on it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from truewrench import _core
from truewrench.estimation.ekf import estimate_ekf
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.log import Log
from truewrench.model.rig import Rig

Array = NDArray[np.float64]

MASS, COM, INERTIA = 50.0, np.array([0.2, 0.03, -0.05]), np.diag([1.5, 1.4, 0.4])
SPAN = np.array([500.0, 500, 500, 50, 50, 50])


def cross(x: Array) -> Array:
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


def newton_euler(nu: Array, a: Array, g: Array) -> Array:
    f = MASS * (a[:3] + np.cross(nu[3:], nu[:3]) - g)
    n = INERTIA @ a[3:] + np.cross(nu[3:], INERTIA @ nu[3:])
    return -np.concatenate([f, np.cross(COM, f) + n])


def jacobians(nu: Array) -> tuple[Array, Array]:
    """By acceleration and by twist, from the formulas for any centre of mass and inertia."""
    v, o = nu[:3], nu[3:]
    by_a = -np.block([[MASS * np.eye(3), np.zeros((3, 3))], [MASS * cross(COM), INERTIA]])
    turning = -MASS * cross(COM) @ cross(v) + cross(o) @ INERTIA - cross(INERTIA @ o)
    by_nu = -np.block([[MASS * cross(o), -MASS * cross(v)], [MASS * cross(COM) @ cross(o), turning]])
    return by_a, by_nu


@dataclass
class Textbook:
    """Dense extended Kalman filter, Joseph form, with rows without a sample struck out."""

    x: Array
    P: Array
    R: Array
    density: Array
    sign: float

    def predict(self, dt: float) -> None:
        F = np.eye(self.x.size)
        F[:6, 6:12] = dt * np.eye(6)
        Q = np.zeros_like(F)
        s = np.diag(self.density)
        Q[:12, :12] = np.block([[dt**3 / 3 * s, dt**2 / 2 * s], [dt**2 / 2 * s, dt * s]])
        self.x, self.P = F @ self.x, F @ self.P @ F.T + Q

    def update(self, raw: Array, twist: Array, g: Array) -> tuple[Array, float]:
        nu, a, C = self.x[:6], self.x[6:12], self.x[12:48].reshape(6, 6)
        w = self.sign * newton_euler(nu, a, g)
        by_a, by_nu = jacobians(nu)
        H = np.zeros((12, self.x.size))
        H[:6, :6], H[:6, 6:12] = self.sign * C @ by_nu, self.sign * C @ by_a
        H[:6, 12:48] = np.kron(np.eye(6), w)
        H[6:, :6] = np.eye(6)
        predicted = np.concatenate([C @ w, nu])
        if self.x.size == 54:
            H[:6, 48:] = np.eye(6)
            predicted[:6] += self.x[48:]
        innovation = np.concatenate([raw, twist]) - predicted
        seen = np.isfinite(innovation)
        H, R, y = H[seen], self.R[np.ix_(seen, seen)], innovation[seen]
        S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        self.x = self.x + K @ y
        I_KH = np.eye(self.x.size) - K @ H
        self.P = I_KH @ self.P @ I_KH.T + K @ R @ K.T
        return innovation, float(y @ np.linalg.solve(S, y))


@dataclass
class Record:
    time_ns: NDArray[np.int64]
    raw: Array
    twist: Array
    gravity: Array
    gain: Array


def record(
    n: int, force_noise: float, seed: int = 0, twist_noise: float = 1e-3, gain: Array | None = None
) -> Record:
    """Sinusoidal motion at uneven times around 100 Hz, gravity turning with a made-up attitude."""
    rng = np.random.default_rng(seed)
    time_ns = np.cumsum(rng.integers(5_000_000, 15_000_000, n))
    t = time_ns[:, None] * 1e-9
    rate = 2 * np.pi * np.array([0.30, 0.51, 0.69, 0.39, 0.60, 0.87])
    phase = np.array([0, 1, 2, 0.5, 1.5, 2.5])
    nu, a = 0.25 * np.sin(rate * t + phase), 0.25 * rate * np.cos(rate * t + phase)
    g = 9.81 * np.column_stack([np.sin(t), np.cos(t) * np.sin(2 * t), np.cos(t) * np.cos(2 * t)])
    if gain is None:
        gain = np.eye(6) + 0.2 * rng.normal(size=(6, 6)) * SPAN[:, None] / SPAN
    wrench = np.array([newton_euler(*row) for row in zip(nu, a, g, strict=True)])
    sigma = force_noise * np.array([1, 1, 1, 0.1, 0.1, 0.1])
    raw = wrench @ gain.T + sigma * rng.normal(size=(n, 6))
    return Record(time_ns, raw, nu + twist_noise * rng.normal(size=(n, 6)), g, gain)


def settings(force_noise: float) -> _core.EkfSettings:
    s = _core.EkfSettings()
    s.raw_covariance = np.diag(force_noise * np.array([1, 1, 1, 0.1, 0.1, 0.1])) ** 2
    # Correlated, as J_c E[.] J_c^T is.
    s.twist_covariance = 1e-6 * (np.eye(6) + 0.3 * np.ones((6, 6)))
    covariance = np.zeros((42, 42))
    covariance[:36, :36] = np.diag((0.3 * SPAN[:, None] / SPAN).ravel() ** 2)
    covariance[36:, 36:] = np.diag((0.1 * SPAN) ** 2)
    s.parameter_covariance = covariance
    return s


def payload() -> _core.Payload:
    return _core.Payload(MASS, COM, INERTIA)


def textbook(s: _core.EkfSettings, with_offset: bool) -> Textbook:
    size = 54 if with_offset else 48
    x = np.concatenate([np.zeros(12), s.gain.ravel(), s.offset])[:size]
    P = np.zeros((54, 54))
    P[:12, :12] = np.diag(np.concatenate([s.twist_variance, s.acceleration_variance]))
    P[12:, 12:] = s.parameter_covariance
    R = np.zeros((12, 12))
    R[:6, :6], R[6:, 6:] = s.raw_covariance, s.twist_covariance
    return Textbook(
        x, P[:size, :size], R, s.process_density, 1.0 if s.feels == _core.Feels.payload_on_sensor else -1.0
    )


@pytest.mark.parametrize("with_offset", [False, True])
@pytest.mark.parametrize("feels", [_core.Feels.payload_on_sensor, _core.Feels.sensor_on_payload])
def test_filter_equals_the_textbook_over_thousands_of_uneven_steps(
    with_offset: bool, feels: _core.Feels
) -> None:
    log, s = record(3000, 0.5), settings(0.5)
    s.feels = feels
    raw = log.raw * (1.0 if feels == _core.Feels.payload_on_sensor else -1.0)
    twist = log.twist.copy()
    raw[100:200:3] = np.nan  # streams of different rates
    twist[150:300:2] = np.nan
    raw[500:600, 2] = np.nan  # one channel silent
    reference = textbook(s, with_offset)
    innovations, nis = [], []
    for i in range(len(raw)):
        if i > 0:
            reference.predict(1e-9 * float(log.time_ns[i] - log.time_ns[i - 1]))
        y, d2 = reference.update(raw[i], twist[i], log.gravity[i])
        innovations.append(y)
        nis.append(d2)
    found = _core.ekf_run(payload(), s, with_offset, log.time_ns, raw, twist, log.gravity)
    assert found.status == _core.Status.ok
    sigma = np.sqrt(np.diag(reference.P))
    assert np.linalg.norm(found.state - reference.x) <= 2e-9 * np.linalg.norm(reference.x)
    # The steps amplify rounding: this textbook in double and in long double differ by 1e-8 sigma too.
    assert np.abs((found.state - reference.x) / sigma).max() < 1e-6
    scaled = (found.covariance - reference.P) / sigma[:, None] / sigma
    assert np.abs(scaled).max() < 1e-8
    np.testing.assert_allclose(found.innovation, innovations, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.nis, nis, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(
        found.degrees_of_freedom, np.isfinite(raw).sum(1) + np.isfinite(twist).sum(1)
    )


def test_covariance_stays_positive_definite_at_small_measurement_noise() -> None:
    log, s = record(16_000, 1e-4, twist_noise=1e-6), settings(1e-4)
    s.twist_covariance = 1e-12 * np.eye(6)
    found = _core.ekf_run(payload(), s, False, log.time_ns, log.raw, log.twist, log.gravity)
    assert found.status == _core.Status.ok
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.linalg.eigvalsh(found.covariance / sigma[:, None] / sigma).min() > 0


def test_history_holds_the_last_row_of_every_stretch() -> None:
    log, s = record(25, 0.5), settings(0.5)
    every = _core.ekf_run(payload(), s, False, log.time_ns, log.raw, log.twist, log.gravity)
    tenth = _core.ekf_run(payload(), s, False, log.time_ns, log.raw, log.twist, log.gravity, 10)
    np.testing.assert_array_equal(tenth.history_row, [9, 19, 24])
    np.testing.assert_array_equal(tenth.history_gain, every.history_gain[[9, 19, 24]])


def test_a_row_that_cannot_be_filtered_stops_the_record_there() -> None:
    log, s = record(10, 0.5), settings(0.5)
    log.gravity[7] = np.nan
    found = _core.ekf_run(payload(), s, False, log.time_ns, log.raw, log.twist, log.gravity)
    assert found.status == _core.Status.not_finite
    assert found.rows_done == 7
    log.time_ns[5] = log.time_ns[4]
    found = _core.ekf_run(payload(), s, False, log.time_ns, log.raw, log.twist, log.gravity)
    assert found.status == _core.Status.not_increasing
    assert found.rows_done == 5


def rig(force_noise: float, offset_prior: object = 0, **sensor: object) -> Rig:
    ixx, iyy, izz = (float(i) for i in np.diag(INERTIA))
    return Rig.from_mapping(
        {
            "sensor": {
                "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
                "feels": "payload_on_sensor",
                "noise": [force_noise] * 3 + [force_noise / 10] * 3,
                "range": SPAN.tolist(),
                "offset_prior": offset_prior,
                **sensor,
            },
            "payloads": {
                "default": {
                    "mass": MASS,
                    "center_of_mass": COM.tolist(),
                    "inertia": {"xx": ixx, "yy": iyy, "zz": izz},
                }
            },
            "motion": {"source": "twist", "of": "com", "noise": [1e-3] * 6},
            "gravity": [0, 0, -9.81],
        }
    )


def as_log(of: Record, offset: object = 0.0) -> Log:
    return Log(None, "default", "", of.time_ns, of.raw + offset, of.twist, of.gravity)


def normalised_rms(found: Array, truth: Array) -> float:
    return float(np.sqrt(np.mean(((found - truth) * SPAN / SPAN[:, None]) ** 2)))


def test_gain_is_found_where_the_sensor_is_noisy_enough_for_the_filter() -> None:
    run = record(1000, 5.0)
    estimate = estimate_ekf(rig(5.0), [as_log(run)], acceleration_prior=2.0)
    assert normalised_rms(estimate.gain, run.gain) < 0.05
    assert estimate.history_gain.shape == (1000, 6, 6)
    assert normalised_rms(np.eye(6), run.gain) > 0.15
    assert 0.8 < estimate.nis.sum() / estimate.degrees_of_freedom.sum() < 1.2


def test_pooled_logs_share_the_gain_and_keep_their_own_offsets() -> None:
    runs = [record(1000, 5.0, 0)]
    runs.append(record(1000, 5.0, 1, gain=runs[0].gain))
    offsets = np.array([[30.0, -20, 10, 1, -2, 3], [-25.0, 15, 40, -3, 2, 1]])
    logs = [as_log(run, offset) for run, offset in zip(runs, offsets, strict=True)]
    settings_rig = rig(5.0, [50.0] * 3 + [5.0] * 3)
    alone = estimate_ekf(settings_rig, logs[:1], acceleration_prior=2.0)
    pooled = estimate_ekf(settings_rig, logs, acceleration_prior=2.0)
    assert np.all(np.diag(pooled.covariance)[:36] < np.diag(alone.covariance)[:36])
    assert normalised_rms(pooled.gain, runs[0].gain) < normalised_rms(alone.gain, runs[0].gain)
    std = np.sqrt(np.diag(pooled.covariance)[36:])
    assert np.all(np.abs(pooled.offsets - offsets) < 5 * std + 1e-9)
    assert std.max() < 5.0
    np.testing.assert_array_equal(np.unique(pooled.history_log), [0, 1])


def test_twist_of_the_sensor_origin_is_carried_to_the_centre_of_mass() -> None:
    run = record(400, 5.0)
    at_sensor = run.twist.copy()
    at_sensor[:, :3] -= np.cross(run.twist[:, 3:], COM)
    settings_rig = rig(5.0)
    moved = settings_rig.model_copy(
        update={"motion": settings_rig.motion.model_copy(update={"of": "sensor"})}
    )
    expected = estimate_ekf(settings_rig, [as_log(run)])
    found = estimate_ekf(moved, [replace(as_log(run), twist=at_sensor)])
    # The same motion; only the noise that is assumed of v differs, by c x the noise of Omega.
    assert normalised_rms(found.gain, expected.gain) < 0.01


def test_published_start_is_the_identity_whatever_the_nominal_gain() -> None:
    nominal = (2 * np.eye(6)).tolist()
    blind = replace(as_log(record(50, 5.0)), raw=np.full((50, 6), np.nan))
    np.testing.assert_array_equal(estimate_ekf(rig(5.0, 0, nominal_gain=nominal), [blind]).gain, nominal)
    published = estimate_ekf(rig(5.0, 0, nominal_gain=nominal), [blind], published=True)
    np.testing.assert_array_equal(published.gain, np.eye(6))
    np.testing.assert_array_equal(published.covariance[:36, :36], np.eye(36))


def test_process_density_is_one_number_or_one_per_axis() -> None:
    log = as_log(record(50, 5.0))
    one = estimate_ekf(rig(5.0), [log], process_density=3.0)
    each = estimate_ekf(rig(5.0), [log], process_density=[3.0] * 6)
    other = estimate_ekf(rig(5.0), [log], process_density=[3.0] * 3 + [30.0] * 3)
    np.testing.assert_array_equal(one.gain, each.gain)
    assert np.abs(other.gain - one.gain).max() > 0


def test_what_the_published_filter_does_not_know_is_refused() -> None:
    log = as_log(record(20, 5.0))
    seven = rig(
        5.0,
        0,
        channels=list("abcdefg"),
        noise=[1.0] * 7,
        nominal_gain=np.vstack([np.eye(6), np.ones((1, 6))]).tolist(),
    )
    with pytest.raises(UnsupportedError, match=r"sensor\.channels: found 7 channels"):
        estimate_ekf(seven, [log])
    with pytest.raises(InputError, match="no twist columns"):
        estimate_ekf(rig(5.0), [replace(log, twist=None)])
    for slow in ("raw", "twist"):  # half the rate of the other
        stream = getattr(log, slow).copy()
        stream[1::2] = np.nan
        with pytest.raises(UnsupportedError, match=r"10 of 20 rows .* one rate: `ekf` does not merge"):
            estimate_ekf(rig(5.0), [replace(log, **{slow: stream})])
    with pytest.raises(InputError, match="no gravity columns"):
        estimate_ekf(rig(5.0), [replace(log, gravity=None)])
