"""The figures of a campaign: NEES, realised against stated sigma, and coverage, each with its caption."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy.stats import binom, chi2, norm

from truewrench.campaign.statistics import Campaign, wilson_interval
from truewrench.io.pictures import BLUE, GREY, VERMILION, finish
from truewrench.model.calibration import AXES

_FEWEST = 2  # trials that make a picture
_LIMITS = (0.025, 0.975)
_Z = float(norm.ppf(_LIMITS[1]))


def nees_figure(path: Path, result: Campaign) -> bool:
    """Draw the NEES of the gain against chi-square; False, and nothing, for too few trials."""
    known = np.isfinite(result.nees) & (result.nees_dof > 0)
    nees, freedom = result.nees[known], result.nees_dof[known]
    if nees.size < _FEWEST:
        return False
    dof = float(np.median(freedom))
    low, high = _both(chi2.ppf(_LIMITS, freedom.sum()) / nees.size)
    mean = float(nees.mean())
    figure, ax = _axes(7.6, 5.6, bottom=0.27)
    # what lies beyond any honest value is counted in the last bin
    end = min(float(nees.max()) * 1.02, 3.0 * float(chi2.isf(1e-4, dof)))
    start = min(float(nees.min()), float(chi2.ppf(1e-4, dof)))
    bins = np.linspace(
        start, max(end, float(chi2.isf(1e-4, dof))), int(np.clip(2 * np.sqrt(nees.size), 10, 60)) + 1
    )
    beyond = int((nees > bins[-1]).sum())
    ax.hist(
        np.minimum(nees, bins[-1]), bins=bins.tolist(), color=BLUE, alpha=0.55, label=f"{nees.size} trials"
    )
    grid = np.linspace(bins[0], bins[-1], 500)
    expected = nees.size * (bins[1] - bins[0]) * chi2.pdf(grid, dof)
    ax.plot(grid, expected, color="black", linewidth=1.8, label=f"chi-square, {dof:.0f} degrees of freedom")
    ax.axvspan(low, high, color=GREY, alpha=0.35, linewidth=0, label="95% of the means, if honest")
    ax.axvline(mean, color=VERMILION, linewidth=1.8, linestyle="--", label=f"mean {mean:.1f}")
    ax.set_xlabel(r"NEES of the gain, $e^T P^{-1} e$ [1]")
    ax.set_ylabel(f"trials in a bin of {bins[1] - bins[0]:.1f}")
    ax.legend(frameon=False)
    ax.set_title(result.population)
    if low <= mean <= high:
        precision = max(1.0 - np.sqrt(low / dof), np.sqrt(high / dof) - 1.0)
        conclusion = (
            f"as a whole the stated sigma is honest, as far as so many trials tell: to {precision:.1%}"
        )
    elif mean > high:
        conclusion = f"errors are larger than stated: the sigma is {np.sqrt(mean / dof):.2f} times too small"
    else:
        conclusion = f"errors are smaller than stated: the sigma is {np.sqrt(dof / mean):.2f} times too large"
    caption = (
        f"Squared error of the {freedom.max():.0f} gains in units of their stated covariance. If that is "
        "right, the histogram follows the curve, and the mean lies in the grey band, "
        f"{low:.1f} to {high:.1f}, in 95% of campaigns; it is {mean:.1f}. "
        + (f"{beyond} trials beyond the picture are counted in its last bin. " if beyond else "")
        + f"Conclusion: {conclusion}."
    )
    finish(figure, path, caption)
    return True


def sigma_figure(path: Path, result: Campaign) -> bool:
    """Draw realised over stated sigma of every gain; False, and nothing, for too few trials."""
    trials = len(result.error)
    if trials < _FEWEST:
        return False
    ratio = np.sqrt(np.mean(result.error**2, axis=0) / np.mean(result.std**2, axis=0))
    n = len(ratio)
    scatter = _both(np.sqrt(chi2.ppf(_LIMITS, trials) / trials))
    # of all gains together, honest ones stay within this
    widest = _both(np.sqrt(chi2.ppf(_limits_of_all(ratio.size), trials) / trials))
    outside = int(((ratio < widest[0]) | (ratio > widest[1])).sum())
    figure, ax = _axes(7.2, 2.4 + 0.55 * n, bottom=1.5 / (2.4 + 0.55 * n), right=0.88)
    span = max(2.0, float(np.max(np.maximum(ratio, 1.0 / np.maximum(ratio, 1e-9)))))
    picture = ax.imshow(ratio, norm=LogNorm(1.0 / span, span), cmap="RdBu_r", aspect="auto")
    for (i, j), value in np.ndenumerate(ratio):
        strong = abs(np.log(max(value, 1e-9))) > 0.6 * np.log(span)
        ax.text(j, i, f"{value:.2f}", ha="center", va="center", color="white" if strong else "black")
    ax.set_xticks(range(6), AXES)
    ax.set_yticks(range(n), result.channels)
    ax.set_xlabel("wrench axis")
    ax.set_ylabel("channel")
    ax.set_title(result.population)
    bar = figure.colorbar(picture, ax=ax, fraction=0.05, pad=0.03)
    bar.set_label("RMS error / RMS stated sigma [1]")
    ticks = [t for t in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if 1.0 / span <= t <= span]
    bar.set_ticks(ticks, labels=[f"{t:g}" for t in ticks])
    bar.ax.minorticks_off()
    if not outside:
        conclusion = "no gain's sigma can be told from an honest one"
    else:
        i, j = np.unravel_index(np.argmax(np.abs(np.log(np.maximum(ratio, 1e-9)))), ratio.shape)
        which = f"{result.channels[i]} on {AXES[j]}, at {ratio[i, j]:.2f}"
        conclusion = (
            f"{outside} of {ratio.size} gains lie outside that, above all {which}: their sigma is wrong"
        )
    caption = (
        "Realised over stated sigma of every gain: 1 is honest, red (above 1) promises too much, blue (below "
        f"1) is too careful. With {trials} trials an honest gain lies within {scatter[0]:.2f} to "
        f"{scatter[1]:.2f} in 95% of campaigns, and all {ratio.size} within {widest[0]:.2f} to "
        f"{widest[1]:.2f}. Conclusion: {conclusion}."
    )
    finish(figure, path, caption)
    return True


def coverage_figure(path: Path, result: Campaign) -> bool:
    """Draw how often the 95% interval of every gain covers the truth; False for too few trials."""
    trials, n = len(result.error), len(result.channels)
    if trials < _FEWEST:
        return False
    covered = (np.abs(result.error) <= _Z * result.std).sum(axis=0)  # (n, 6)
    share = 100.0 * covered / trials
    band = _both(100.0 * binom.ppf(_LIMITS, trials, 0.95) / trials)
    widest = _both(100.0 * binom.ppf(_limits_of_all(covered.size), trials, 0.95) / trials)
    low, high = ((share < widest[0]).sum(), (share > widest[1]).sum())
    figure, ax = _axes(max(7.6, 1.3 * n), 5.6, bottom=0.27)
    ax.axhspan(*band, color=GREY, alpha=0.25, linewidth=0, label="95% of honest gains")
    ax.axhline(95.0, color="black", linewidth=1.0)
    for i in range(n):
        x = i + np.linspace(-0.3, 0.3, 6)
        ends = 100.0 * np.array([wilson_interval(k, trials) for k in covered[i]])
        colour = BLUE if i % 2 == 0 else VERMILION
        ax.vlines(x, ends[:, 0], ends[:, 1], color=colour, linewidth=1.4)
        ax.plot(x, share[i], "o" if i % 2 == 0 else "s", color=colour, markersize=4.5)
    ax.set_xticks(range(n), result.channels)
    ax.set_xlabel(f"channel; within each, its gains on {', '.join(AXES)}")
    ax.set_ylabel("95% intervals that cover the truth [%]")
    ax.legend(frameon=False, loc="lower right")
    ax.set_title(result.population)
    if low:
        conclusion = f"the intervals of {low} of {covered.size} gains are too narrow"
    elif high:
        conclusion = f"the intervals of {high} of {covered.size} gains are wider than they need be"
    else:
        conclusion = "no gain's interval can be told from an honest one"
    caption = (
        f"Share of {trials} trials in which estimate ± 1.96 sigma covers the true gain, with its 95% "
        f"confidence. Over all gains {share.mean():.1f}%. All {covered.size} honest gains lie within "
        f"{widest[0]:.1f} to {widest[1]:.1f}% in 95% of campaigns. Conclusion: {conclusion}."
    )
    finish(figure, path, caption)
    return True


def _limits_of_all(count: int) -> tuple[float, float]:
    """Probabilities between which all of `count` lie together in 95% of cases, at least (Bonferroni)."""
    return _LIMITS[0] / count, 1.0 - _LIMITS[0] / count


def _both(values: object) -> tuple[float, float]:
    low, high = np.asarray(values, dtype=np.float64)
    return float(low), float(high)


def _axes(width: float, height: float, bottom: float, right: float = 0.97) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height))
    ax = figure.subplots()
    figure.subplots_adjust(left=0.11, right=right, top=0.93, bottom=bottom)
    ax.spines[["top", "right"]].set_visible(False)
    return figure, ax
