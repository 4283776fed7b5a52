"""The contact wrench of a whole log."""

from dataclasses import dataclass

import numpy as np

from truewrench.correction.contact.run import DELAY, ContactEvent, ContactRun, View
from truewrench.io.joints import BASE_ATTITUDE, BASE_TWIST
from truewrench.io.table import ANGULAR_VELOCITY, ATTITUDE, GRAVITY, SPECIFIC_FORCE, TWIST
from truewrench.model.arrays import Array
from truewrench.model.calibration import Calibration
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.robot.arm import robot_of
from truewrench.tool.model import Tool


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """Contact wrenches of the N rows of a log, NaN where there is none; sign of the rig's `sensor.feels`.

    Attributes:
        wrench: (N, 6) [N, N m].
        covariance: (N, 6, 6) of it.
        chi2: (N,) wrench^T covariance^-1 wrench, with 6 degrees of freedom where there is no contact.
        events: contacts, in their order.
    """

    wrench: Array
    covariance: Array
    chi2: Array
    events: tuple[ContactEvent, ...]


def contact(
    log: Log,
    tool: Tool,
    calibration: Calibration | None = None,
    *,
    delay: float = DELAY,
    view: View | None = None,
) -> Contact:
    """What the sensor felt beyond its tool.

    Args:
        log: with motion and, in gravity, its direction.
        tool: identified on the same sensor.
        calibration: of the sensor, for what its offset does with temperature.
        delay: half the length of the kernels [s], 0: they end at the row.
        view: where and how to express the wrench; the sensor's origin and axes by default.

    Raises:
        InputError: the log lacks what the motion needs, or tool and calibration are of two sensors.
    """
    columns = _columns(log, tool.rig)
    run = ContactRun(tool, columns, calibration=calibration, delay=delay, view=view, place=log.path)
    count = len(log.time_ns)
    wrench, covariance = np.full((count, 6), np.nan), np.full((count, 6, 6), np.nan)
    chi2 = np.full(count, np.nan)
    for found in (run.feed(log.time_ns, log.raw, columns), run.finish()):
        wrench[found.rows], covariance[found.rows] = found.wrench, found.covariance
        chi2[found.rows] = found.chi2
    return Contact(wrench, covariance, chi2, tuple(run.events()))


def _columns(log: Log, rig: Rig) -> dict[str, Array]:
    groups: list[tuple[tuple[str, ...], Array | None]] = [
        (GRAVITY, log.gravity),
        (ATTITUDE, log.attitude),
        (ANGULAR_VELOCITY, log.angular_velocity),
        (SPECIFIC_FORCE, log.specific_force),
        (BASE_TWIST, log.base_twist),
        (BASE_ATTITUDE, log.base_attitude),
        (("temperature",), None if log.temperature is None else log.temperature[:, None]),
    ]
    if rig.motion.source == "joints":
        joints = robot_of(rig).joints
        groups += [(tuple(f"q_{joint}" for joint in joints), log.position)]
        groups += [(tuple(f"dq_{joint}" for joint in joints), log.velocity)]
    elif log.twist is not None:
        groups.append((TWIST, log.twist))
    return {
        name: values[:, k] for names, values in groups if values is not None for k, name in enumerate(names)
    }
