"""Settings of a rig that several tests begin with."""

from __future__ import annotations

from typing import Any

EXACT = {"mass": 0, "center_of_mass": 0, "inertia": 0}


def two_payloads(first: str) -> dict[str, Any]:
    """Six channels, exact payloads and clock, 6 s of motion; the payload of [A00] by this name."""
    inertia = {"xx": 1.5, "yy": 1.5, "zz": 0.4}
    return {
        "sensor": {
            "channels": ["fx", "fy", "fz", "mx", "my", "mz"],
            "feels": "payload_on_sensor",
            "noise": [0.5, 0.5, 0.5, 0.05, 0.05, 0.05],
            "range": [500, 500, 500, 50, 50, 50],
            "gain_prior": 0.2,
            "time_offset_prior": 0,
        },
        "payloads": {
            first: {"mass": 50, "center_of_mass": [0.2, 0, 0], "inertia": inertia, "uncertainty": EXACT},
            "small": {"mass": 20, "center_of_mass": [0, 0.1, 0.1], "inertia": inertia, "uncertainty": EXACT},
        },
        "motion": {"of": "com", "noise": [1e-3] * 6},
        "plan": {"duration": 6},
    }


def changed(settings: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """The settings with sections replaced, or what is named in a section."""
    return settings | {
        section: {**settings.get(section, {}), **values} if isinstance(values, dict) else values
        for section, values in changes.items()
    }
