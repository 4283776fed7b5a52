"""Steps of an offset that no test finds: what can be seen of them, and what the gain takes up.

    python benchmarks/hidden_steps.py --runs 900 --seed 12

The logs are those of `confident.py --kind "offset step"`; nothing is estimated. A part of a step is a
combination of the channels themselves and a constant: a gain that nobody told of the step takes it up, and
nobody can see it. With the energy of both parts (squares over the noise) and the time of the step given, the
test for any change of the offset is a noncentral chi-square of the one, and the NEES of that gain one of the
other; its gains are off by normal numbers of known mean. So the chance is known, for each log and whatever
the estimator, that the step stays below a limit of the test and that the gain is wrong: its NEES beyond the
tail, or one of the gains off by more than 6 sigma, whichever is more likely.
"""

from __future__ import annotations

import confident  # first: it holds NumPy to one thread

# isort: split
from functools import partial

import numpy as np
import runs
from numpy.typing import NDArray
from scipy.stats import chi2, ncx2, norm

from truewrench.estimate.moving_offset import FAINT, SIGNIFICANT, limit_of_jump

LISTED = 5


def wrong(shift: NDArray[np.float64], taken_up: float) -> float:
    """Chance that gains are wrong, from their shift in sigma and the energy of a step that they take up."""
    nees = ncx2.sf(chi2.isf(runs.TAIL, shift.size), shift.size, taken_up)
    largest = 1.0 - np.prod(norm.cdf(runs.SIX_SIGMA - np.abs(shift)))
    return float(max(nees, largest))


def run(campaign: int, index: int) -> runs.Row:
    """One row."""
    rig, log, simulated, about = confident.problem("offset step", campaign, index)
    plain = simulated.log.raw
    change = (log.raw - plain) / rig.sensor.noise_array
    regressors = np.column_stack([plain / rig.sensor.range_array, np.ones(len(plain))])
    basis, triangle = np.linalg.qr(regressors)
    seen = float(np.sum((change - basis @ (basis.T @ change)) ** 2))
    taken_up = float(np.sum((change - change.mean(axis=0)) ** 2)) - seen
    n = rig.sensor.n
    limits = [chi2.isf(FAINT, n), chi2.isf(SIGNIFICANT, n), limit_of_jump(np.array(taken_up / seen), n)]
    shift = np.linalg.solve(triangle, basis.T @ change)  # of the gains, and of the constant at the end
    sigma = np.linalg.norm(np.linalg.inv(triangle), axis=1)
    chance = wrong((shift / sigma[:, None])[:-1], taken_up)
    return about | {
        "outcome": "drawn",
        "seen": seen,
        "taken_up": taken_up,
        "hidden": [chance * float(ncx2.cdf(limit, n, seen)) for limit in limits],
    }


def main() -> None:
    options = runs.arguments(__doc__, runs=900).parse_args()
    work = partial(run, options.seed)
    rows = runs.gather(
        work, range(options.runs), options.out, options.workers, ["hidden steps, both criteria", options.seed]
    )
    rows = [row for row in rows if row["outcome"] != "fault"]
    expected = np.sum([row["hidden"] for row in rows], axis=0)
    low, high = (f"{chi2.isf(chance, 6):.0f}" for chance in (FAINT, SIGNIFICANT))
    names = low, high, f"{low} to {high}, by what the gain takes up"
    runs.table(
        ("limit in six channels", "logs", "wrong and not seen, expected"),
        [[name, len(rows), f"{n:.3f}"] for name, n in zip(names, expected, strict=True)],
    )
    most = sorted(rows, key=lambda row: -row["hidden"][-1])[:LISTED]
    runs.table(
        ("run", "size", "seen", "taken up", "chance to be wrong and not seen"),
        [
            [
                row["index"],
                f"{row['size']:.2f}",
                f"{row['seen']:.0f}",
                f"{row['taken_up']:.0f}",
                f"{row['hidden'][-1]:.1e}",
            ]
            for row in most
        ],
    )


if __name__ == "__main__":
    main()
