"""Mistakes in axes and units that a free gain absorbs: whether all are flagged, and sound rigs are not.

    python benchmarks/setup_sweep.py --healthy 10000 --end-to-end 200 --workers 2 --out out/setup

A sensor of departure 0.15 (or --departure) is estimated with the errors of the scenario's bound. All 46,079
signed permutations of the wrench axes other than the identity, and the named scales on all axes, on forces
and on moments, are put between its gain and the nominal one, each with a departure of its own.
`--end-to-end` calibrates so many simulated logs: every scale, then permutations. `--runs` limits the
permutations.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per core; before NumPy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from functools import cache, partial
from itertools import permutations, product
from typing import Any

import bound_common
import cases
import numpy as np
import runs
from numpy.typing import NDArray

from truewrench.judging.setup_odds import suspected_setup_errors
from truewrench.model.rig import Rig
from truewrench.simulation.free_body import simulate

Array = NDArray[np.float64]

CELL = (0.5, 1e-3)
SCALES = (1000.0, 9.81, 4.448, 57.3, 0.001)
GROUPS = {"all axes": np.ones(6), "forces": np.repeat([1.0, 0.0], 3), "moments": np.repeat([0.0, 1.0], 3)}
BATCH = 64  # rigs of a row


@cache
def signed_permutations() -> tuple[tuple[tuple[int, ...], tuple[int, ...]], ...]:
    """All 46,080: where each axis goes, and its sign; the identity first."""
    return tuple(product(permutations(range(6)), product((1, -1), repeat=6)))


def matrix_of(index: int) -> Array:
    """A signed permutation of SI wrench axes; 0 is the identity."""
    order, sign = signed_permutations()[index]
    out = np.zeros((6, 6))
    out[np.arange(6), list(order)] = sign
    return out


@cache
def rig_of(prior: float) -> Rig:
    """The rig of the scenario with another prior."""
    settings = cases.rig_of("scenario", CELL).to_mapping()
    settings["sensor"]["gain_prior"] = prior
    return Rig.from_mapping(settings)


@cache
def covariance(prior: float) -> Array:
    """Of the normalised gains: the bound."""
    return bound_common.bound(rig_of(prior), cases.motion_of("scenario", 0), np.eye(6), 0.2)


def flagged(mistake: Array, departure: float, prior: float, rng: np.random.Generator) -> tuple[bool, str]:
    """Whether a sensor with a mistake (6, 6) between nominal and true wrench axes (SI) is suspected."""
    sensor = rig_of(prior).sensor
    span = sensor.range_array
    normalised = mistake * span / span[:, None]
    gain = (np.eye(6) + departure * rng.standard_normal((6, 6))) @ normalised
    P = covariance(prior)
    gain = gain + (np.linalg.cholesky(P) @ rng.standard_normal(36)).reshape(6, 6)
    center = rig_of(prior).payloads["default"].center_of_mass_array
    found = suspected_setup_errors(
        gain,
        P,
        np.eye(6),
        prior,
        span,
        sensor.channel_scale,
        centers_of_mass=[center],
        prior_in_estimate=False,
    )
    return bool(found), found[0].words if found else ""


def batch(kind: str, campaign: int, departure: float, prior: float, first: int) -> runs.Row:
    """Flags of a batch of mistakes."""
    flags, words = [], {}
    for index in range(first * BATCH, min((first + 1) * BATCH, count_of(kind))):
        rng = np.random.default_rng([campaign, ("axes", "scales", "healthy").index(kind), index])
        mistake = {"axes": lambda i: matrix_of(i + 1), "scales": scale_of, "healthy": lambda i: np.eye(6)}[
            kind
        ](index)
        suspected, text = flagged(mistake, departure, prior, rng)
        flags.append(suspected)
        if suspected == (kind == "healthy") and len(words) < 5:
            words[str(index)] = text
    return {"outcome": "done", "reasons": [], "flags": flags, "words": words}


def scale_of(index: int) -> Array:
    """A named scale on a group of axes."""
    factor = SCALES[index % len(SCALES)]
    group = list(GROUPS.values())[index // len(SCALES) % len(GROUPS)]
    return np.diag(np.where(group > 0.0, factor, 1.0))


def count_of(kind: str) -> int:
    """How many there are; healthy rigs have no end, and every scale has 100 departures."""
    return {"axes": 46_079, "scales": 100 * len(SCALES) * len(GROUPS), "healthy": 10**9}[kind]


def end_to_end(campaign: int, departure: float, prior: float, index: int) -> runs.Row:
    """One calibration: a scale for the first indices, then permutations at random, every tenth sound."""
    rng = np.random.default_rng([campaign, 9, index])
    scales = len(SCALES) * len(GROUPS)
    kind = "scales" if index < scales else "healthy" if index % 10 == 0 else "axes"
    which = index if kind == "scales" else int(rng.integers(1, 46_080))
    mistake = {"scales": scale_of, "axes": matrix_of, "healthy": lambda i: np.eye(6)}[kind](which)
    settings = rig_of(prior).to_mapping()
    span = rig_of(prior).sensor.range_array
    healthy = (np.eye(6) + departure * rng.standard_normal((6, 6))) * span[:, None] / span
    settings["simulate"] |= {"gain": (healthy @ mistake).tolist()}
    # noise of the channels as stated; a scaled sensor's noise is scaled with it
    factor = np.abs(np.diag(mistake)) if kind == "scales" else np.ones(6)
    settings["sensor"]["noise"] = [x * f for x, f in zip(settings["sensor"]["noise"], factor, strict=True)]
    simulated = simulate(Rig.from_mapping(settings), cases.motion_of("scenario", index), seed=index)
    row = runs.calibrate_row(rig_of(prior), simulated.log, simulated.truth.gain)
    suspected = [r for r in row["reasons"] if "suspected set-up error" in r]
    return {"kind": kind, "which": which, "suspected": suspected[:1], **row}


def main() -> None:
    parser = runs.arguments(__doc__, runs=46_079)
    parser.add_argument("--healthy", type=int, default=10_000)
    parser.add_argument("--end-to-end", type=int, default=0)
    parser.add_argument("--departure", type=float, default=0.15)
    parser.add_argument("--prior", type=float, default=0.3)
    options = parser.parse_args()
    lines: list[Any] = []
    for kind, count in (("axes", options.runs), ("scales", count_of("scales")), ("healthy", options.healthy)):
        count = min(count, count_of(kind))
        work = partial(batch, kind, options.seed, options.departure, options.prior)
        settings = ["setup", kind, options.seed, options.departure, options.prior]
        rows = runs.gather(work, range(-(-count // BATCH)), options.out, options.workers, settings)
        flags = [f for r in rows for f in r.get("flags", [])][:count]
        odd = {k: v for r in rows for k, v in r.get("words", {}).items()}
        lines.append(
            (
                kind,
                len(flags),
                sum(flags),
                f"{np.mean(flags) if flags else 0:.4%}",
                str(list(odd.items())[:3]),
            )
        )
    runs.table(("mistake", "rigs", "flagged", "share", "not as they should be: number, words"), lines)
    if options.end_to_end:
        work = partial(end_to_end, options.seed, options.departure, options.prior)
        settings = ["setup end to end", options.seed, options.departure, options.prior]
        rows = runs.gather(work, range(options.end_to_end), options.out, options.workers, settings)
        print("\nCalibrated from simulated logs:\n")
        table = []
        for kind in ("scales", "axes", "healthy"):
            of_kind = [r for r in rows if r.get("kind") == kind]
            suspected = [r for r in of_kind if r["suspected"]]
            missed = [r["index"] for r in of_kind if bool(r["suspected"]) == (kind == "healthy")]
            usable = sum(r["usable"] for r in of_kind)
            table.append((kind, len(of_kind), len(suspected), usable, missed[:8]))
        runs.table(("mistake", "logs", "suspected", "usable", "not as they should be"), table)
        for r in [r for r in rows if r["outcome"] == "fault"][:5]:
            print(f"fault: {r['index']}: {r['reasons'][0]}")


if __name__ == "__main__":
    main()
