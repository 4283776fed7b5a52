"""What a rig says of an IMU and of a weight that the driver has subtracted."""

from __future__ import annotations

from typing import Any

import pytest

from truewrench.model.errors import InputError
from truewrench.model.rig import Rig

IMU = {"source": "imu", "noise": [1e-3] * 3, "acceleration_noise": [1e-2] * 3}
DOWN = [0, 0, -9.81]


def test_imu_rig_has_priors_for_its_biases(settings: dict[str, Any]) -> None:
    rig = Rig.from_mapping(settings | {"motion": IMU})
    assert (rig.motion.accelerometer_bias_prior, rig.motion.gyro_bias_prior) == (0.05, 0.005)
    assert rig.motion.of == "sensor"
    exact = Rig.from_mapping(
        settings | {"motion": {**IMU, "accelerometer_bias_prior": 0, "gyro_bias_prior": 0.1}}
    )
    assert (exact.motion.accelerometer_bias_prior, exact.motion.gyro_bias_prior) == (0.0, 0.1)


def test_imu_rig_survives_its_own_mapping(settings: dict[str, Any]) -> None:
    rig = Rig.from_mapping(settings | {"motion": IMU, "limits": {"velocity": [1.0] * 6}})
    assert Rig.from_mapping(rig.to_mapping()) == rig


def test_rigs_of_other_sources_are_written_without_the_keys_of_an_imu(rig: Rig) -> None:
    assert not {"accelerometer_bias_prior", "gyro_bias_prior"} & rig.to_mapping()["motion"].keys()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"of": "com"}, r"motion\.of: found the text 'com', expected this key only with `source: twist`"),
        ({"robot": {"urdf": "a", "sensor_frame": "b"}}, r"motion\.robot: .* only with `source: joints`"),
        ({"position_noise": [1e-5] * 3}, r"motion\.position_noise: .* only with `source: joints`"),
        ({"initial_position": [0.0] * 3}, r"motion\.initial_position: .* only with `source: joints`"),
        ({"noise": None}, r"motion\.noise: found nothing, expected 3 numbers, 1 sigma of Omega"),
        ({"noise": [1e-3] * 6}, r"motion\.noise: found 6 entries, expected 3: 1 sigma of Omega"),
        ({"acceleration_noise": None}, r"motion\.acceleration_noise: found nothing, expected 3 numbers"),
        ({"acceleration_noise": [1e-2] * 6}, r"motion\.acceleration_noise: found 6 entries, expected 3"),
        ({"gyro_bias_prior": -1}, r"motion\.gyro_bias_prior: found -1, expected a number of at least 0"),
        ({"bias": None}, r"motion\.bias: unknown key `bias`"),
    ],
)
def test_key_that_does_not_fit_an_imu_is_named(
    settings: dict[str, Any], change: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        Rig.from_mapping(settings | {"motion": {**IMU, **change}})


def test_bias_prior_belongs_to_an_imu(settings: dict[str, Any]) -> None:
    settings["motion"]["gyro_bias_prior"] = 0.1
    with pytest.raises(InputError, match=r"motion\.gyro_bias_prior: .* only with `source: imu`"):
        Rig.from_mapping(settings)


def test_weight_that_was_subtracted_is_stated_as_a_body(settings: dict[str, Any]) -> None:
    settings["gravity"] = DOWN
    assert Rig.from_mapping(settings).sensor.subtracted is None
    settings["sensor"]["compensated"] = {"mass": 1.2, "center_of_mass": [0, 0, 0.05]}
    rig = Rig.from_mapping(settings)
    body = rig.sensor.subtracted
    assert body is not None
    assert (body.mass, body.center_of_mass) == (1.2, (0.0, 0.0, 0.05))
    assert Rig.from_mapping(rig.to_mapping()) == rig


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (True, r"sensor\.compensated: found true, expected false, or .* log the sensor's raw output"),
        ("yes", r"sensor\.compensated: found the text 'yes', expected false, or {mass, center_of_mass}"),
        (1, r"sensor\.compensated: found 1, expected false, or {mass, center_of_mass}"),
        ({"mass": 1}, r"sensor\.compensated\.center_of_mass: missing required key"),
        (
            {"mass": 0, "center_of_mass": [0, 0, 0]},
            r"sensor\.compensated\.mass: found 0, expected a number gr",
        ),
        (
            {"mass": 1, "centre_of_mass": [0, 0, 0]},
            r"unknown key `centre_of_mass`; nearest known key: `center_of_mass`",
        ),
    ],
)
def test_weight_that_is_not_known_is_refused(settings: dict[str, Any], value: object, message: str) -> None:
    settings["gravity"] = DOWN
    settings["sensor"]["compensated"] = value
    with pytest.raises(InputError, match=message):
        Rig.from_mapping(settings)


def test_no_weight_was_subtracted_without_gravity(settings: dict[str, Any]) -> None:
    settings["sensor"]["compensated"] = {"mass": 1, "center_of_mass": [0, 0, 0]}
    with pytest.raises(InputError, match=r"gravity: found .* the gravity in which the driver subtracted"):
        Rig.from_mapping(settings)
