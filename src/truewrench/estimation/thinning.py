"""Noise of which a filter has left hardly any where it is fast: so many samples are one that it is white.

No model of the filter is needed: of one sample in D the density is folded, sum_j S(f + j / (D dt)), and D is
the least by which that no longer falls (docs/method.md, M12c). So it is with steep filters, and with what was
smoothed after it was sampled, to either side.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truewrench.estimation.evenly import NoiseSpectrum, blackman_harris, noise_spectrum
from truewrench.model.arrays import Array, Integers

BEGINS = (3.0, 4.0, 5.0)  # [Hz] from which on noise is sought, the first where it is found: tolerance
SECONDS = 5.2  # of a spectrum's segments: tolerance
FEWEST = 8  # bins of a band: tolerance
WITHIN = 0.95  # of the Nyquist frequency of what is left: tolerance
FALLS = 1.25  # from the lower half of the band to the upper one, up to which noise is white: tolerance
COSTS = 2.0  # times the noise's density that thinning may bring with it: of one pole 1.6

GROWS = 1.15
"""Of the noise's 1 sigma at the same rate, from which on a filter matters: 3 of 210 imperfect records of
other kinds were taken for filtered; 12 with 1.08."""

LEFT = 0.5
"""Of the stated density, up to which a filter left noise where it is fast: what is slow falls to it."""


@dataclass(frozen=True, slots=True)
class Thinning:
    """How many samples are one."""

    step: int
    corner: float  # bandwidth of the noise, of the sampling rate


def thinning_of(
    time: Array, values: Array, stated: Array | None, without: Sequence[tuple[float, float]] = ()
) -> Thinning | None:
    """Of samples (N, M) at times (N,); None where their noise is white, or never is.

    `stated` (M,) is 1 sigma of it, None where it is not known; `without` are bands taken out [Hz].
    """
    if len(time) < 2:
        return None
    period = float(np.median(np.diff(time)))
    found = noise_spectrum(time, values, BEGINS[0], 1.0, window(period), without)
    if found is None:
        return None
    for begin in BEGINS:
        for step in range(2, int(0.5 / (begin * period))):
            band = np.flatnonzero((found.hz >= begin) & (found.hz <= WITHIN * 0.5 / (step * period)))
            if band.size < FEWEST:
                break
            level = np.median(found.power[band], axis=0)
            folded = _folded(found, band, step) / level
            lower, upper = np.array_split(np.log(folded), 2)
            if np.median(lower) - np.median(upper) > np.log(FALLS):
                continue
            growth = np.exp(-0.5 * np.log(np.minimum(found.power / level, 1.0).mean(axis=0)).mean())
            if growth < GROWS or np.median(folded) > COSTS or not _left(found, step, stated):
                break
            return Thinning(step, float(0.5 / growth**2))
    return None


def window(period: float) -> Array:
    """Of a spectrum that tells noise as slow as `BEGINS` beside motions a thousand times as large."""
    length = max(512, 2 ** int(np.log2(SECONDS / period)))
    return blackman_harris(2.0 * np.pi * np.arange(length) / length)


def _folded(found: NoiseSpectrum, band: Integers, step: int) -> Array:
    """Densities (K, M) in a band of one sample in so many."""
    turned = found.hz[band, None] * found.period + np.arange(step) / step
    turned = np.abs((turned + 0.5) % 1.0 - 0.5) / found.period
    return np.stack([np.interp(turned, found.hz, column).sum(axis=1) for column in found.power.T], axis=1)


def _left(found: NoiseSpectrum, step: int, stated: Array | None) -> bool:
    """Whether less than the stated noise is left beyond the corner."""
    if stated is None or stated.size != found.power.shape[1]:
        return True
    fast = np.median(found.power[found.hz >= 0.75 / (step * found.period)], axis=0)
    return bool(np.log(fast / (2.0 * found.period * stated**2)).mean() < np.log(LEFT))
