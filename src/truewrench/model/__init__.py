"""What people state and what they get, frozen and validated: rig, log, payload, calibration."""

from collections.abc import Callable
from typing import Any

contact: Callable[..., Any]
"""What `Calibration.contact` calls; the package's face sets it, as this room imports none above it."""
