"""What samples of a tool's logs have beside the noise as stated: a contact wrench elsewhere has it, too."""

import numpy as np

from truewrench.model.arrays import Array
from truewrench.tool.model_rows import Problem
from truewrench.tool.motion import MotionFit


def sample_noise(problem: Problem, motion: MotionFit | None) -> Array:
    """(n,) 1 sigma of a sample [raw units]: as the estimator of motion found it, at least as stated."""
    noise = problem.rig.sensor.noise_array
    return noise if motion is None else noise * np.maximum(motion.noise, 1.0)


def vibrations(problem: Problem) -> Array:
    """(B, 1 + n) frequency [Hz] and 1 sigma of each channel [raw units] of what shakes the sensor.

    Of dwells, whose frequency is not looked for, it is 0. What the motion shows as well moves the tool, and
    the contact wrench is without it. Of several logs the one that shakes most is taken.
    """
    scale, shaking = problem.rig.sensor.channel_scale, problem.poses.shaking
    found = [np.zeros((0, 1 + len(scale)))]
    for move in problem.moves:
        bands = [[band.centre, *band.std] for band in move.record.vibrations if not band.shown]
        found.append(np.array(bands, np.float64).reshape(-1, 1 + len(scale)))
    told = np.isfinite(shaking).all(axis=1)
    for k in np.unique(problem.poses.log[told]).tolist():
        mean = shaking[told & (problem.poses.log == k)].mean(axis=0) / scale**2
        found.append(np.append(0.0, np.sqrt(np.maximum(mean, 0.0)))[None])
    most = max(found, key=lambda bands: float((bands[:, 1:] ** 2).sum()))
    return np.asarray(most * np.append(1.0, scale))
