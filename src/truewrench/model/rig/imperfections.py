"""What a simulated run has that a perfect one has not: ``simulate.imperfections`` of a rig.

Sizes are fractions of range: forces of the sensor's range, effects inside the sensor of each channel's scale,
``|nominal_gain| @ range``. 0 is nothing. What is left open (None) is drawn from the seed.
"""

from typing import Annotated, Literal

from pydantic import Field

from truewrench.model.rig.strict import NonNegative, Positive, Section, word_or_number


class HysteresisSpec(Section):
    """Every channel lags behind its load: by the play operator, or by Dahl's friction on top of it."""

    size: NonNegative  # half the width of the loop
    form: Literal["play", "dahl"] = "play"


class VibrationSpec(Section):
    """A force of one frequency, its amplitude wandering by half of its size."""

    size: NonNegative  # mean amplitude
    hz: Annotated[Positive, Field(le=500.0)] | None = None  # drawn: 12 to 40


class ContactSpec(Section):
    """A push: half a sine."""

    size: NonNegative  # peak, of the axis that feels it most
    start: NonNegative | None = None  # [s] of the motion
    duration: Positive | None = None  # [s]; drawn: 0.2 to 2


class StepSpec(Section):
    """The offset jumps once."""

    size: NonNegative  # of the channel that jumps farthest
    time: NonNegative | None = None  # [s] of the motion


class SpikesSpec(Section):
    """Single samples are wrong, in all channels."""

    size: NonNegative  # 1 sigma
    share: Annotated[NonNegative, Field(le=1.0)] = 0.01  # of the samples


class FilterSpec(Section):
    """A low-pass filter: of first order, or Butterworth's of second."""

    hz: Annotated[Positive, Field(ge=1e-3)]  # -3 dB
    order: Literal[1, 2] = 1


class ImperfectionsSpec(Section):
    """Imperfect hardware, each kind by itself or with others (docs/imperfections.md)."""

    hysteresis: HysteresisSpec | None = None
    nonlinearity: NonNegative | None = None  # of the square of the channel's own axis, at full range
    cable: NonNegative | None = None  # RMS over the record
    drift: NonNegative | None = None  # 1 sigma of where the offset goes
    random_walk: NonNegative | None = None  # of the offset, per sqrt(s)
    vibration: VibrationSpec | None = None
    contact: ContactSpec | None = None
    step: StepSpec | None = None
    spikes: SpikesSpec | None = None
    velocity_filter: FilterSpec | None = None
    sensor_filter: FilterSpec | None = None  # the sensor's own noise passes it, too
    jitter: NonNegative | None = None  # [s] 1 sigma, white; of sensor and motion each their own
    quantisation: NonNegative | None = None  # steps of the logged motion, in sigmas of its noise
    gravity_tilt: (
        Annotated[
            float | Literal["random"], word_or_number("random", "a number of radians of at least 0", 0.0)
        ]
        | None
    ) = None  # [rad] of the direction of gravity, about a drawn axis; random: from gravity_tilt_prior
    noise: NonNegative | None = None  # factor on the stated noise of sensor and motion

    @property
    def stated(self) -> tuple[str, ...]:
        """The kinds that are simulated."""
        return tuple(kind for kind in type(self).model_fields if getattr(self, kind) is not None)
