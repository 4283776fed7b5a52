"""The wrench of a rig's payload for whole records, by the core's Newton-Euler equations ([A00] 5-8)."""

import numpy as np

from truewrench import _core
from truewrench.model.arrays import Array
from truewrench.model.rig import PayloadSpec, Rig


def core_payload(spec: PayloadSpec) -> _core.Payload:
    """A payload as the core takes it."""
    return _core.Payload(spec.mass, spec.center_of_mass_array, spec.inertia_matrix)


def payload_wrench(rig: Rig, payload: str, twist: Array, acceleration: Array, gravity: Array) -> Array:
    """Wrench (N, 6) as the sensor feels it, at its origin and with the sign of `sensor.feels`.

    The twist (N, 6) and its component-wise derivative are of the logged point (`motion.of`), and like gravity
    (N, 3), the acceleration of free fall, along the sensor axes.
    """
    spec = rig.payloads[payload]
    at_mass = [twist, acceleration]
    if rig.motion.of == "sensor":  # v_C = v_S + Omega x c, and so for the derivatives
        lever = spec.center_of_mass_array
        at_mass = [np.column_stack([x[:, :3] + np.cross(x[:, 3:], lever), x[:, 3:]]) for x in at_mass]
    wrench: Array = _core.payload_wrench(core_payload(spec), *map(np.ascontiguousarray, (*at_mass, gravity)))
    return rig.sensor.sign * wrench
