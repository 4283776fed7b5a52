"""A campaign: which trials are missing, where their rows are kept, and what is written of them.

Every trial draws a truth, simulates a log and calibrates from it; its row does not depend on how many
processes share the work. Rows are kept in shards, so that an interrupted campaign goes on where it stood.
"""

import hashlib
import json
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from truewrench import _core
from truewrench.calibrating.pipeline import EstimatorName
from truewrench.campaign.statistics import Campaign, summarise
from truewrench.campaign.trial import SCHEMA, Planned, Row, make_row, run_trial, trial_seed
from truewrench.campaign.workers import Lost, available_cores, in_processes
from truewrench.io.output import write_batches
from truewrench.model.errors import InputError, UnsupportedError
from truewrench.model.files import read_yaml, write_yaml
from truewrench.model.motion.trajectory import Trajectory
from truewrench.model.motion.trajectory_joint import JointTrajectory
from truewrench.model.rig import Rig
from truewrench.model.rig.strict import key_path
from truewrench.simulation.arm.run import default_joints
from truewrench.simulation.free_body import default_trajectory

FORMAT = "truewrench-campaign/1"

_SHARD = 64  # trials in a file
_SAVE_EVERY = 30.0  # [s] the most that a power cut costs


def campaign(
    rig: Rig,
    trials: int,
    output: str | Path,
    estimator: EstimatorName = "map",
    seed: int = 0,
    processes: int | None = None,
    progress: Callable[[str, float | None], None] | None = None,
    *,
    trajectory: Planned | None = None,
    restart: bool = False,
) -> Campaign:
    """Simulate and calibrate a rig many times, and write what came of it into a folder.

    The folder holds `campaign.yaml` (what was run), `trials/` (a Parquet data set, one row per trial),
    `summary.yaml` and pictures. Trials that are already there are not run again: more `trials` extend it.
    What is drawn, and what is not, is in the rig's `simulate`; its first payload is carried. The number of
    processes, by default all cores, has no effect on the rows; `progress` is told a phase and the share of it
    that is done.

    Raises:
        InputError: the folder holds another campaign, and `restart` does not say to drop it.
        UnsupportedError: this rig cannot be simulated, or not calibrated by this estimator.
    """
    rig.check_motion("which a simulation needs")
    if trials < 1:
        raise InputError.at(None, "trials", str(trials), "at least 1")
    if estimator not in get_args(EstimatorName):
        known = ", ".join(f"`{name}`" for name in get_args(EstimatorName))
        raise InputError.at(None, "estimator", f"`{estimator}`", f"one of {known}")
    report = progress or (lambda phase, share: None)
    motion = trajectory
    if motion is None:
        motion = default_joints(rig) if rig.motion.source == "joints" else default_trajectory(rig)
    shards = _Shards(Path(output), _manifest(rig, motion, estimator, seed), restart)
    missing = [trial for trial in range(trials) if trial not in shards.rows]
    done = trials - len(missing)
    report(f"{done} of {trials} trials", done / trials)
    work = partial(run_trial, rig, motion, estimator, seed)
    try:
        for trial, row in in_processes(work, missing, processes or available_cores()):
            if isinstance(row, UnsupportedError):  # so would every other trial be
                raise row
            if isinstance(row, Lost):
                row = make_row(trial, trial_seed(seed, trial), "fault", (row.reason,))
            shards.add(row)
            done += 1
            report(f"{done} of {trials} trials", done / trials)
    finally:
        shards.save()
    report("summary", None)
    table = pa.Table.from_pylist([shards.rows[trial] for trial in range(trials)], schema=SCHEMA)
    result = summarise(rig, table, estimator, seed)
    return _write(result, shards)


def _manifest(rig: Rig, motion: Planned, estimator: str, seed: int) -> dict[str, Any]:
    """Everything that a row depends on."""
    settings = json.loads(json.dumps(rig.to_mapping()))
    settings["simulate"].pop("seed", None)  # the campaign's own stands in its place
    at = np.linspace(0.0, motion.duration, 997)
    of_joints = rig.motion.source == "joints"
    moments = cast(JointTrajectory, motion).position(at) if of_joints else cast(Trajectory, motion).twist(at)
    digest = hashlib.sha256(np.ascontiguousarray(moments).tobytes()).hexdigest()
    return {
        "format": FORMAT,
        "version": version("truewrench"),
        "build": _build(),
        "core": _core.variant,
        "estimator": estimator,
        "seed": seed,
        "motion": {"duration": motion.duration, "sha256": digest},
        "rig": settings,
    }


def _build() -> str:
    """Digest of the installed code, so that rows of two states of a source tree are not mixed."""
    digest = hashlib.sha256()
    core = find_spec(f"truewrench._core_{_core.variant}")
    assert core is not None
    for path in [*sorted(Path(__file__).parents[1].rglob("*.py")), Path(str(core.origin))]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


class _Shards:
    """The rows of one campaign in a folder; nothing is written before the first row is known."""

    def __init__(self, folder: Path, manifest: Mapping[str, Any], restart: bool) -> None:
        text = json.dumps(manifest, sort_keys=True)
        self._key = f"seed{manifest['seed']}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
        self.folder = folder
        self._manifest = manifest
        self._restart = restart
        self._dirty: set[int] = set()
        self._saved = time.monotonic()
        self.rows: dict[int, Row] = {}
        path = folder / "campaign.yaml"
        if restart or not path.exists():
            return
        _check_same(path, read_yaml(path)[0], manifest)
        for shard in sorted((folder / "trials").glob(f"{self._key}-*.parquet")):
            self.rows |= {row["trial"]: row for row in _read(shard)}

    def add(self, row: Row) -> None:
        """Keep a row; it is on disk when its shard is whole, or after half a minute."""
        self.rows[row["trial"]] = row
        shard = row["trial"] // _SHARD
        self._dirty.add(shard)
        whole = all(trial in self.rows for trial in range(shard * _SHARD, (shard + 1) * _SHARD))
        if whole or time.monotonic() - self._saved > _SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Write every shard that has new rows."""
        if self._dirty:
            self._begin()
        by_shard = defaultdict(list)
        for trial in sorted(self.rows):
            by_shard[trial // _SHARD].append(self.rows[trial])
        for shard in sorted(self._dirty):
            path = self.folder / "trials" / f"{self._key}-{shard:06}.parquet"
            write_batches(path, [pa.RecordBatch.from_pylist(by_shard[shard], schema=SCHEMA)])
        self._dirty.clear()
        self._saved = time.monotonic()

    def _begin(self) -> None:
        path = self.folder / "campaign.yaml"
        if self._restart:
            for old in (*(self.folder / "trials").glob("*.parquet"), path, self.folder / "summary.yaml"):
                old.unlink(missing_ok=True)
            self._restart = False
        if not path.exists():
            write_yaml(path, self._manifest)


def _read(path: Path) -> list[Row]:
    try:
        rows: list[Row] = pq.read_table(path, schema=SCHEMA).to_pylist()
    except (pa.ArrowException, OSError) as error:
        raise InputError.at(
            path, "", f"a broken file ({error})", "trials of this campaign, or --restart"
        ) from error
    return rows


def _check_same(path: Path, there: Any, here: Mapping[str, Any]) -> None:
    if not isinstance(there, Mapping) or there.get("format") != FORMAT:
        raise InputError.at(path, "format", "another file", f"`{FORMAT}` (or --restart to replace it)")
    before, now = dict(_leaves(there)), dict(_leaves(here))
    keys = [key for key in dict.fromkeys([*before, *now]) if before.get(key) != now.get(key)]
    told = [key for key in keys if key.startswith("rig.")]  # the default motion follows from these
    problems = [
        f"{path}: {key}: found {before.get(key, 'nothing')}, expected {now.get(key, 'nothing')}"
        for key in (key for key in keys if not (told and key.startswith("motion.")))
    ]
    if problems:
        more = f" ({len(problems) - 2} more differ)" if len(problems) > 2 else ""
        said = f"{path}: another campaign{more}; choose another folder, or replace it with --restart"
        problems = [*problems[:2], said]
        raise InputError("\n".join(problems), problems=problems)


def _leaves(value: Any, keys: tuple[str | int, ...] = ()) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, (*keys, key))
    else:
        yield key_path(keys), value


def _write(result: Campaign, shards: _Shards) -> Campaign:
    from truewrench.campaign.figures import coverage_figure, nees_figure, sigma_figure  # not in every process

    folder = shards.folder
    write_yaml(folder / "summary.yaml", result.summary)
    outputs = [folder / "campaign.yaml", folder / "trials", folder / "summary.yaml"]
    for name, draw in (("nees", nees_figure), ("sigma", sigma_figure), ("coverage", coverage_figure)):
        picture = folder / f"{name}.png"
        picture.unlink(missing_ok=True)  # of a smaller campaign
        if draw(picture, result):
            outputs.append(picture)
    return result.with_outputs(outputs)
