"""The wrench of a rig's payload for whole records, by the core's Newton-Euler equations ([A00] 5-8)."""

import numpy as np

from truewrench import _core
from truewrench.model.arrays import Array
from truewrench.model.rig import PayloadSpec, Rig


def core_payload(spec: PayloadSpec) -> _core.Payload:
    """A payload as the core takes it."""
    return _core.Payload(spec.mass, spec.center_of_mass_array, spec.inertia_matrix)


def lever(rig: Rig, payload: str, body: _core.Payload) -> Array:
    """Where a body's centre of mass is, (3,), seen from the point that a log of a payload tells [m].

    That point stays where it is for another body: at the STATED centre of mass, or at the sensor's origin.
    """
    at_mass = rig.motion.of == "com"
    return body.center_of_mass - at_mass * rig.payloads[payload].center_of_mass_array


def payload_wrench(
    rig: Rig,
    payload: str,
    twist: Array,
    acceleration: Array,
    gravity: Array,
    body: _core.Payload | None = None,
) -> Array:
    """Wrench (N, 6) as the sensor feels it, at its origin and with the sign of `sensor.feels`.

    The twist (N, 6) and its component-wise derivative are of the logged point (`motion.of`), and like gravity
    (N, 3), the acceleration of free fall, along the sensor axes. The payload is as stated, or the `body` that
    it was found to be.
    """
    body = body or core_payload(rig.payloads[payload])
    e = lever(rig, payload, body)  # v_C = v + Omega x e, and so for the derivatives
    at_mass = (np.column_stack([x[:, :3] + np.cross(x[:, 3:], e), x[:, 3:]]) for x in (twist, acceleration))
    wrench: Array = _core.payload_wrench(body, *map(np.ascontiguousarray, (*at_mass, gravity)))
    return rig.sensor.sign * wrench
