"""What the rows of a campaign say: accuracy against the bound, and whether the stated sigma is honest."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text
from scipy.special import betaincinv, chdtrc, chdtri, ndtri

from truewrench.model.arrays import Array, Mask
from truewrench.model.rig import Rig

DEVIATION = 6.0  # |error| / sigma of a gain beyond which a usable calibration is wrong and confident,
TAIL = 1e-8  # as it is where a NEES so large has less than this probability
_REASONS = 10  # that are listed
_ARRAYS = ("error", "std")


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """A campaign's summary, and the trials that its pictures are drawn from."""

    summary: Mapping[str, Any]  # plain numbers and lists, as summary.yaml holds them
    channels: tuple[str, ...]  # n names
    population: str  # which trials the arrays hold, in words: the usable ones, or all where none is
    error: Array  # (N, n, 6) of the normalised gain
    std: Array  # (N, n, 6) stated 1 sigma
    nees: Array  # (N,) of the gain
    nees_dof: Array  # (N,) its degrees of freedom
    outputs: tuple[Path, ...] = ()  # files and folders written

    def with_outputs(self, outputs: Sequence[Path]) -> Campaign:
        """The same, with what was written."""
        return replace(self, outputs=tuple(outputs))


def summarise(rig: Rig, rows: pa.Table, estimator: str, seed: int) -> Campaign:
    """Judge the rows of a campaign (trial.py, `SCHEMA`), at least one."""
    n, total = rig.sensor.n, rows.num_rows
    outcome = np.array(rows["outcome"].to_pylist())
    calibrated, usable = outcome == "calibrated", _column(rows, "usable") > 0.0
    wrong = wrong_and_confident(rows)
    counts = {
        "usable": int(usable.sum()),
        "not_usable": int((calibrated & ~usable).sum()),
        "refused": int((outcome == "refused").sum()),
        "faults": int((outcome == "fault").sum()),
    }
    seconds = _column(rows, "seconds")[calibrated]
    drawn = _drawn(rig)
    reasons = _reasons(rows, counts, int(wrong.sum()))
    summary = {
        "format": "truewrench-campaign-summary/1",
        "estimator": estimator,
        "seed": seed,
        "trials": total,
        "verdict": {"usable": not reasons, "reasons": reasons},
        "outcomes": counts,
        "share_usable": counts["usable"] / total,
        "share_usable_95": list(wilson_interval(counts["usable"], total)),
        "wrong_and_confident": {
            "count": int(wrong.sum()),
            "rate_below_95": _upper_limit(int(wrong.sum()), counts["usable"]),
            "seeds": [int(s) for s in np.array(rows["seed"].to_pylist())[wrong][:_REASONS]],
        },
        "drawn_from_priors": drawn,
        "usable_trials": _statistics(rows, usable),
        "calibrated_trials": _statistics(rows, calibrated),
        "seconds": {
            "median": float(np.median(seconds)) if seconds.size else None,
            "largest": float(seconds.max()) if seconds.size else None,
            "total": float(seconds.sum()),
        },
        "reasons": _common_reasons(rows),
    }
    judged, population = (usable, "usable trials") if usable.any() else (calibrated, "calibrated trials")
    error, std = (
        np.array([row for row, j in zip(rows[name].to_pylist(), judged, strict=True) if j], dtype=np.float64)
        for name in _ARRAYS
    )
    return Campaign(
        summary,
        rig.sensor.channels,
        f"{judged.sum()} {population}",
        error.reshape(-1, n, 6),
        std.reshape(-1, n, 6),
        _column(rows, "nees")[judged],
        _column(rows, "nees_dof")[judged],
    )


def wrong_and_confident(rows: pa.Table) -> Mask:
    """Trials whose verdict says usable although a gain, or all of them together, is out of the question."""
    deviation, nees, freedom = (_column(rows, name) for name in ("largest_deviation", "nees", "nees_dof"))
    with np.errstate(invalid="ignore"):
        right = (deviation <= DEVIATION) & (chdtrc(freedom, nees) >= TAIL)  # false for NaN, too
    return np.asarray((_column(rows, "usable") > 0.0) & ~right)


def wilson_interval(successes: float, trials: float) -> tuple[float, float]:
    """95% interval of a share, from independent trials (not necessarily a whole number of them)."""
    z = float(ndtri(0.975))
    p = successes / trials
    middle = (p + z**2 / (2.0 * trials)) / (1.0 + z**2 / trials)
    half = z / (1.0 + z**2 / trials) * np.sqrt(p * (1.0 - p) / trials + z**2 / (4.0 * trials**2))
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def cluster_interval(shares: Array, size: int) -> tuple[float, float]:
    """95% interval of a mean share over clusters of `size` dependent outcomes each.

    The gains of one trial err together, so they count for fewer than their number: Wilson's interval for as
    many independent outcomes as would scatter like the shares (N,); for N, the fewest, where all are equal.
    """
    p, count = float(shares.mean()), shares.size
    scatter = float(shares.var(ddof=1)) if count > 1 else 0.0
    effective = p * (1.0 - p) * count / scatter if scatter > 0.0 else 0.0
    effective = float(np.clip(effective, count, size * count))
    return wilson_interval(p * effective, effective)


def _upper_limit(found: int, trials: int) -> float:
    """The rate that is exceeded with 5% confidence only (Clopper and Pearson)."""
    return float(betaincinv(found + 1, trials - found, 0.95)) if found < trials else 1.0


def campaign_words(result: Campaign) -> Iterator[RenderableType]:
    """The verdict, the figures, and why trials were not usable."""
    summary = result.summary
    verdict, counts = summary["verdict"], summary["outcomes"]
    text = Text("NOTHING AGAINST THE ESTIMATOR" if verdict["usable"] else "NOT AS IT SHOULD BE", style="bold")
    for reason in verdict["reasons"]:
        text.append(f"\n  - {reason}", style="not bold")
    yield text
    low, high = summary["share_usable_95"]
    confident = f"Wrong and confident: {summary['wrong_and_confident']['count']}"
    if counts["usable"]:
        rate = 100 * summary["wrong_and_confident"]["rate_below_95"]
        confident += f" (with 95 % confidence fewer than {rate:.2g} % of usable ones)"
    yield Text(
        f"{summary['trials']} trials with {summary['estimator']}, seed {summary['seed']}: "
        + ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
        + f". Usable {100 * summary['share_usable']:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f}).\n"
        f"{confident}."
    )
    columns = [s for s in (summary["usable_trials"], summary["calibrated_trials"]) if s["trials"]]
    if columns:
        yield _figures(columns, ["usable trials", "calibrated trials"][-len(columns) :])
    fixed = [name.replace("_", " ") for name, drawn in summary["drawn_from_priors"].items() if not drawn]
    if fixed:
        yield Text(
            f"Not drawn from the rig's priors: {', '.join(fixed)}. NEES and coverage are then not bound to "
            "be nominal, even for an honest estimator."
        )
    if summary["reasons"]:
        table = Table(title="Why not usable", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
        table.add_column("trials", justify="right")
        table.add_column("reason", overflow="fold")
        for reason, count in summary["reasons"].items():
            table.add_row(str(count), Text(reason))
        yield table
    seconds = summary["seconds"]
    if seconds["median"] is not None:
        yield Text(
            f"Time of a calibration: median {seconds['median']:.2f} s, longest {seconds['largest']:.2f} s; "
            f"{seconds['total']:.0f} s of one core in all."
        )


def _figures(columns: Sequence[Mapping[str, Any]], titles: Sequence[str]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("of the gains, normalised by range")
    for title in titles:
        table.add_column(title, justify="right", no_wrap=True)

    def percent(value: float | None) -> str:
        return "-" if value is None else f"{100 * value:.3g} %"

    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.3f}"

    def interval(low_high: Sequence[float] | None, factor: float = 1.0) -> str:
        return "-" if low_high is None else f"{factor * low_high[0]:.4g} to {factor * low_high[1]:.4g}"

    cells: list[tuple[str, Callable[[Mapping[str, Any]], str]]] = [
        ("trials", lambda s: str(s["trials"])),
        ("RMS error", lambda s: percent(s["rms_error"])),
        ("RMS of the stated sigma", lambda s: percent(s["rms_stated"])),
        ("RMS of the oracle bound", lambda s: percent(s["rms_oracle"])),
        ("RMS error / stated sigma", lambda s: number(s["rms_over_stated"])),
        ("RMS error / oracle bound", lambda s: number(s["rms_over_oracle"])),
        ("efficiency against the oracle bound", lambda s: percent(s["efficiency"])),
        ("mean NEES / degrees of freedom", lambda s: number(s["nees_mean"])),
        ("  95 % of honest campaigns", lambda s: interval(s["nees_honest_95"])),
        ("coverage of 95 % intervals", lambda s: percent(s["coverage"])),
        ("  its 95 % confidence [%]", lambda s: interval(s["coverage_95"], 100.0)),
        ("largest |error| / sigma", lambda s: number(s["largest_deviation"])),
        ("samples left out", lambda s: percent(s["masked"])),
    ]
    for name, cell in cells:
        table.add_row(name, *(cell(column) for column in columns))
    return table


def _statistics(rows: pa.Table, chosen: Mask) -> dict[str, Any]:
    def column(name: str) -> Array:
        values = _column(rows, name)[chosen]
        return values[np.isfinite(values)]

    def rms(name: str) -> float | None:
        values = column(name)
        return float(np.sqrt(np.mean(values**2))) if values.size else None

    def mean(name: str) -> float | None:
        values = column(name)
        return float(values.mean()) if values.size else None

    error, stated, oracle = rms("rms_error"), rms("rms_stated"), rms("rms_oracle")
    judged = chosen & np.isfinite(_column(rows, "nees"))
    squared, freedom = _column(rows, "nees")[judged], _column(rows, "nees_dof")[judged]
    shares, sizes = column("coverage"), [len(e) for e in rows["error"].to_pylist() if e is not None]
    largest = column("largest_deviation")
    return {
        "trials": int(chosen.sum()),
        "rms_error": error,
        "rms_stated": stated,
        "rms_oracle": oracle,
        "rms_over_stated": _ratio(error, stated),
        "rms_over_oracle": _ratio(error, oracle),
        "efficiency": None if not error or oracle is None else (oracle / error) ** 2,  # of variances
        "nees_mean": float(squared.sum() / freedom.sum()) if squared.size else None,
        "nees_dof": float(freedom.mean()) if squared.size else None,
        "nees_honest_95": (chdtri(freedom.sum(), [0.975, 0.025]) / freedom.sum()).tolist()
        if squared.size
        else None,
        "coverage": float(shares.mean()) if shares.size else None,
        "coverage_95": list(cluster_interval(shares, max(sizes))) if shares.size else None,
        "largest_deviation": float(largest.max()) if largest.size else None,
        "noise_found": {
            name.removeprefix("noise_"): mean(name) for name in rows.column_names if name.startswith("noise_")
        },
        "masked": mean("masked"),
    }


def _ratio(a: float | None, b: float | None) -> float | None:
    return None if a is None or not b else a / b


def _column(rows: pa.Table, name: str) -> Array:
    """Numbers or flags; NaN for null."""
    return np.array(rows[name].to_pylist(), dtype=np.float64)  # None becomes NaN


def _drawn(rig: Rig) -> dict[str, bool]:
    """Which of the unknowns follow the priors that the estimator believes in."""
    options, sensor = rig.simulate, rig.sensor
    exact = all(payload.exact for payload in rig.payloads.values())
    no_offset = options.offset in (0, "none") and not sensor.offset_prior_array.any()
    no_delay = options.time_offset == 0 and sensor.time_offset_prior == 0
    return {
        "gain": options.gain == "random",
        "offset": options.offset == "random" or no_offset,
        "payload": options.payload == "random" or exact,
        "time_offset": options.time_offset == "random" or no_delay,
    }


def _reasons(rows: pa.Table, counts: Mapping[str, int], wrong: int) -> list[str]:
    reasons = []
    if wrong:
        reasons.append(
            f"{wrong} of {counts['usable']} usable calibrations are wrong and confident: a gain off by more "
            f"than {DEVIATION:g} sigma, or a NEES beyond the {TAIL:g} tail of chi-square"
        )
    if counts["faults"]:
        reasons.append(f"{counts['faults']} of {rows.num_rows} trials ended in an internal fault")
    if not counts["usable"]:
        reasons.append("no trial is usable")
    return reasons


def _common_reasons(rows: pa.Table) -> dict[str, int]:
    """How many trials give a reason, with the numbers in it left open."""
    found = Counter[str]()
    for reasons in rows["reasons"].to_pylist():
        found.update(
            {re.sub(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", "#", reason) for reason in reasons}
        )
    return dict(found.most_common(_REASONS))
