"""What a log tells of its time offset, and a gain whose clock it does not tell (docs/method.md, "Clocks")."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from truewrench.estimate.curvature import TAILS
from truewrench.log import Log
from truewrench.rig import SensorSpec

__all__ = ["ClockInformation", "with_untold_clock"]

Array = NDArray[np.float64]

_SAMPLES = 4  # of the sensor in the shortest bin
_BINS = 20  # of the longest, in a log
_UNEVEN = 0.01  # of the step between bins
_KEPT = 0.5  # share of the energy of the channels' rate that bins may smooth away,
_FINE = 0.97  # and where the rate itself is looked for
_SIGNIFICANT = 4.0  # sigma
_CHANCE = 3.0
_CONFOUNDED = 0.01  # share of the energy that the gain may leave unexplained
_ITERATIONS = 10
_NODES = 15  # of a quadrature over the clock


@dataclass(frozen=True, slots=True, eq=False)
class ClockInformation:
    """On the time offset of a log, were the wrench known without an error: no estimate can have more.

    A change of the clock is undone by the gain as far as the rate of the channels is a combination of the
    channels themselves. What is not, over their noise, is all there is to know of the clock.

    Attributes:
        of_data: no more than this where the gain is not known [1/s^2].
        of_priors: of the priors of clock and gain [1/s^2].
        generator: (n, n) B of the normalised channels, d(raw)/dt = B raw [1/s], where the log tells less of
            the clock than the priors and the gain undoes all but a hundredth of its change; else None.
    """

    of_data: float
    of_priors: float
    generator: Array | None

    @classmethod
    def of(cls, sensor: SensorSpec, log: Log, gain: Array) -> ClockInformation | None:
        """From the raw channels, or None where they are too few, or too still.

        Rates are taken from means over bins, each of even and of odd samples: in products of the two, white
        noise has the mean zero.

        Args:
            sensor: with its noise and priors.
            log: whose raw channels count.
            gain: (n, 6) known so far, SI.
        """
        present = np.isfinite(log.raw).all(axis=1)
        time, raw = 1e-9 * (log.time_ns[present] - log.time_ns[0]), log.raw[present] / sensor.noise_array
        if time.size < 2 * _SAMPLES * _BINS:
            return None
        whitened = gain * sensor.range_array / sensor.noise_array[:, None]
        lengths = _SAMPLES * 2 ** np.arange(int(np.log2(time.size // (_BINS * _SAMPLES))) + 1)
        all_lengths = [_binned(time, raw, int(length), whitened) for length in lengths]
        found = [x for x in all_lengths if x.energy > _SIGNIFICANT * x.chance]
        if not found:
            return None
        energy = max(x.energy for x in found)
        smooth = [x for x in found if x.energy >= _KEPT * energy][-1]
        fine = [x for x in found if x.energy >= _FINE * energy][-1]
        to_normalised = sensor.noise_array / sensor.channel_scale
        generator = fine.generator * to_normalised[:, None] / to_normalised
        change = generator @ (gain * sensor.range_array / sensor.channel_scale[:, None])
        of_priors = sensor.time_offset_prior**-2.0 + float(np.sum(change**2)) / sensor.gain_prior**2
        seen = max(x.unexplained * (x.unexplained > _SIGNIFICANT * x.chance) for x in found)
        at_most = (max(smooth.unexplained, 0.0) + _CHANCE * smooth.chance) * energy / smooth.energy
        of_data = max(seen, at_most)
        untold = of_data < of_priors and of_data < _CONFOUNDED * energy
        return cls(of_data, of_priors, generator if untold else None)

    @property
    def sigma(self) -> float:
        """1 sigma [s] at best."""
        return float((self.of_data + self.of_priors) ** -0.5)


@dataclass(frozen=True, slots=True, eq=False)
class _Binned:
    """At one length of bins.

    Attributes:
        energy: information on the clock if the gain were known [1/s^2].
        unexplained: what remains of it where the gain is not known,
        chance: and its 1 sigma.
        generator: (n, n) of the channels' rate by the channels, as nearly as can be.
    """

    energy: float
    unexplained: float
    chance: float
    generator: Array


def _binned(time: Array, raw: Array, samples: int, gain: Array) -> _Binned:
    """Of bins of so many samples, an even number; raw and gain (n, 6) over the noise."""
    size = time.size // samples
    when = time[: size * samples].reshape(size, -1, 2).mean(axis=1)
    mean = raw[: size * samples].reshape(size, -1, 2, raw.shape[1]).mean(axis=1)
    step = when[2:] - when[:-2]
    usual = float(np.median(step))
    even = (np.abs(step - usual) < _UNEVEN * usual).all(axis=1)  # no gap among them
    rate = ((mean[2:][even] - mean[:-2][even]) / step[even][..., None]).swapaxes(0, 1)
    value = np.insert(mean[1:-1][even].swapaxes(0, 1) @ np.linalg.pinv(gain).T, 6, 1.0, axis=2)
    wrench_rate = rate @ np.linalg.pinv(gain).T
    (a, b), (da, db) = value, wrench_rate
    by_wrench = np.linalg.lstsq(a.T @ b + b.T @ a, a.T @ db + b.T @ da, rcond=1e-6)[0]  # (M15a)
    rest = (wrench_rate - value @ by_wrench) @ gain.T
    turning = float(np.linalg.norm(by_wrench[:6], 2))
    # differences over +-h of exp(B t) give sinh(B h) / h: its inverse function
    turn = 0.5 * usual * gain @ by_wrench[:6].T @ np.linalg.pinv(gain)
    square = turn @ turn
    turn = turn @ (np.eye(len(turn)) - square / 6.0 + 3.0 / 40.0 * square @ square)
    return _Binned(
        energy=samples * float(np.sum(rate[0] * rate[1])),
        unexplained=samples * float(np.sum(rest[0] * rest[1])),
        chance=float(np.sqrt(rest[0].size) * (4.0 / usual**2 + 2.0 * turning**2)),
        generator=2.0 / usual * turn,
    )


def with_untold_clock(
    generator: Array,
    mean: Array,
    covariance: Array,
    nominal: Array,
    gain_prior: float,
    time_offset_prior: float,
) -> tuple[Array, Array]:
    """Common parameters of an estimate that held the clock, with the clock as the last of them.

    All that is known of it are its prior and, as exp(-B tau) C is the gain at a time offset tau, the gain's.

    Args:
        generator: (n, n) B.
        mean: (p,) the normalised gain first.
        covariance: (p, p).
        nominal: (n, 6) mean of the gain's prior, normalised.
        gain_prior: 1 sigma of it.
        time_offset_prior: 1 sigma [s].

    Returns:
        Mean (p + 1,) and covariance.
    """
    n = len(nominal)
    held = mean[: 6 * n].reshape(n, 6)
    offset, most = 0.0, 5.0 * time_offset_prior
    for _ in range(_ITERATIONS):
        gain = expm(-offset * generator) @ held
        by_offset = -generator @ gain
        information = time_offset_prior**-2.0 + float(np.sum(by_offset**2)) / gain_prior**2
        score = float(np.sum(by_offset * (nominal - gain))) / gain_prior**2 - offset / time_offset_prior**2
        offset = float(np.clip(offset + score / information, -most, most))
    gain = expm(-offset * generator) @ held

    def turned(by: Array, others: float = 1.0) -> Array:
        """The covariance with the gain's departures multiplied by a matrix, and all others by a number."""
        whole = block_diag(np.kron(by, np.eye(6)), others * np.eye(mean.size - 6 * n))
        return np.asarray(whole @ covariance @ whole.T)

    # Second moments about the estimate, as they are; what is beyond the tangent has the tails of products.
    nodes, weights = hermegauss(_NODES)
    joint = np.zeros((mean.size + 1, mean.size + 1))
    departure, beyond = np.zeros((2, mean.size + 1))
    for change, weight in zip(nodes / np.sqrt(information), weights / weights.sum(), strict=True):
        turn = expm(-change * generator) - np.eye(n)
        departure[: 6 * n], departure[-1] = (turn @ gain).ravel(), change
        beyond[: 6 * n] = (turn @ gain + change * generator @ gain).ravel()
        joint += weight * (np.outer(departure, departure) + (TAILS - 1.0) * np.outer(beyond, beyond))
        joint[:-1, :-1] += weight * turned(expm(-(offset + change) * generator))
        joint[:-1, :-1] += weight * (TAILS - 1.0) * turned(turn @ expm(-offset * generator), 0.0)
    return np.concatenate([gain.ravel(), mean[6 * n :], [offset]]), joint
