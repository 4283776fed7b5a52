"""Logs of bodies that nobody knows, pooled with those of known payloads into one calibration.

An unknown body is a payload with a prior so wide that the data tell it (METHOD 6); what they do not tell, its
mass where no body is known, keeps its variance. A body is estimated about a first guess, because its moment
bends: least squares on differentiated velocities with the nominal gain.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from truewrench import _core
from truewrench.estimation.accelerometer import at_sensor
from truewrench.estimation.estimate import PayloadDeparture
from truewrench.model.errors import InputError
from truewrench.model.log import Log
from truewrench.model.rig import InertiaSpec, PayloadSpec, Rig
from truewrench.model.rig.sections import ELEMENTS, UNKNOWN_GYRATION, UNKNOWN_UNCERTAINTY
from truewrench.robot.track import tracked
from truewrench.tool.motion import body_start

BENDS = 0.05  # 1 sigma of the gains beyond which gain times mass is no longer linear (docs/tool.md)


def known_payload(rig: Rig, log: Log) -> bool:
    """Whether the payload that a log carries is known."""
    return not rig.payloads[log.payload].unknown


def known_logs(rig: Rig, logs: Sequence[Log]) -> list[Log]:
    """Those that carry a known payload."""
    return [log for log in logs if known_payload(rig, log)]


def scale_unknown(rig: Rig, logs: Sequence[Log]) -> list[str]:
    """Why no gain follows from these logs: nothing in them has a known mass, and the prior is wide."""
    if known_logs(rig, logs) or rig.sensor.gain_prior <= BENDS:
        return []
    return [
        "no log carries a known payload: mass and force scale cannot be told apart, and so for inertia and "
        f"moments; beyond a gain_prior of {BENDS:g}, sigma does not say how far they may be off together; "
        "weigh a body, or add a log of a known one"
    ]


def with_first_guess(rig: Rig, logs: Sequence[Log]) -> Rig:
    """The rig with unknown bodies near what the logs say, their priors as wide as before.

    The logged point of a twist stays where it is: with `motion.of: com`, the centre of mass that is stated.
    """
    found: dict[str, PayloadSpec] = {}
    for name in dict.fromkeys(log.payload for log in logs):
        if rig.payloads[name].unknown:
            found[name] = _guess(rig, rig.payloads[name], [log for log in logs if log.payload == name])
    return rig.model_copy(update={"payloads": {**rig.payloads, **found}}) if found else rig


def notes_on_bodies(
    rig: Rig, logs: Sequence[Log], payloads: Mapping[str, PayloadDeparture]
) -> tuple[str, ...]:
    """What was found of the unknown bodies of `with_first_guess`, and what the data did not tell."""
    notes = []
    for name in dict.fromkeys(log.payload for log in logs if not known_payload(rig, log)):
        if name not in payloads:
            continue
        spec, std = rig.payloads[name], payloads[name].std
        prior = spec.uncertainty.of_each
        untold = [
            what for what, s, p in zip(_NAMES, std, prior, strict=True) if not s < _core.UNDETERMINED * p
        ]
        mass = spec.mass * (1.0 + payloads[name].mean[0])
        said = f"unknown payload `{name}`: {mass:.4g} kg, 1 sigma {spec.mass * std[0]:.2g} kg"
        notes.append(said + (f"; not determined: {', '.join(untold)}" if untold else ""))
    return tuple(notes)


_NAMES = (
    "mass",
    *(f"centre of mass along {axis}" for axis in "xyz"),
    *(f"inertia {element}" for element in ELEMENTS),
)


def _guess(rig: Rig, spec: PayloadSpec, logs: Sequence[Log]) -> PayloadSpec:
    center = spec.center_of_mass_array
    if rig.motion.source == "joints":
        logs = tracked(rig, logs)
    elif rig.motion.source == "twist" and rig.motion.of == "com":
        logs = [at_sensor(log, center) for log in logs]
    try:
        body = body_start(rig, logs, rig.sensor.nominal_gain_array)
    except (InputError, np.linalg.LinAlgError):
        return spec
    mass = float(np.exp(body[0]))
    if rig.motion.source != "twist" or rig.motion.of != "com":
        center = np.clip(body[1:4], -0.5, 0.5)
    moment = max(mass * UNKNOWN_GYRATION, float(np.mean(body[4:7])))
    update: dict[str, Any] = {
        "mass": mass,
        "center_of_mass": tuple(center.tolist()),
        "inertia": InertiaSpec(xx=moment, yy=moment, zz=moment),
        # of what was guessed, not of what was stated: a body twice as heavy has twice the inertia
        "uncertainty": spec.uncertainty.model_copy(
            update={"inertia": max(spec.uncertainty.inertia, UNKNOWN_UNCERTAINTY.inertia)}
        ),
    }
    return spec.model_copy(update=update)
