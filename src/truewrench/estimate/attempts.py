"""What is tried, and in which order, where logs do not fit as stated (docs/method.md, "Online and map")."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from truewrench import _core
from truewrench.calibration import UNDETERMINED
from truewrench.estimate.fits import ENOUGH, fitted_share
from truewrench.estimate.moving_offset import (
    Jump,
    Wandering,
    jump_in,
    log_cut_at,
    offsets_may_move,
    open_end,
    still_moves,
    untold,
    wandering,
    with_free_offsets,
)
from truewrench.estimate.noise import Noise, estimate_with_noise, with_noise, with_noise_of_walk
from truewrench.estimate.window_estimate import WindowEstimate
from truewrench.estimate.windows import estimate_windows
from truewrench.log import Log
from truewrench.rig import Rig
from truewrench.temperature import at_reference_temperature

__all__ = ["LEFT_OUT", "Attempts", "Explanation"]

NEARLY_ALL = 0.95  # share of the samples that contacts or jumps must explain to be believed
LEFT_OUT = 0.2
"""Share of the samples left out as contacts that is accepted: beyond it a push may be an offset."""
FEWER = 0.1  # of the samples left out as contacts may be so still, where a jump takes their place
GLARING = 1e-12  # contacts by chance in a window, where only those that nobody doubts are left out,
TINY = 1e-300  # and none that motion and gain take up


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """How logs were explained best.

    Attributes:
        estimate: of gain and all else.
        noise: that its residuals show.
        rig: with the walk of the offset, and the sensor's noise as stated beside what that adds.
        as_found: with the white noise that the estimate was made with.
        moving: what an offset had to do for it.
    """

    estimate: WindowEstimate
    noise: Noise
    rig: Rig
    as_found: Rig
    moving: Wandering | None


@dataclass(slots=True)
class Attempts:
    """Estimates from the same logs.

    Attributes:
        logs: with the twist, and gravity where it acts; cut where their offsets were found to jump.
        method: the estimator asked for.
        settings: of the core.
        jumps: per log, of its offset; empty where none jumps.
    """

    logs: Sequence[Log]
    method: Literal["map", "online"]
    settings: _core.EstimatorSettings
    jumps: Sequence[Jump | None] = ()
    _last_quick: tuple[Rig, WindowEstimate] | None = None
    _free: WindowEstimate | None = None

    def plain(self, rig: Rig, start: WindowEstimate | None = None) -> WindowEstimate:
        """The estimator asked for, once."""
        return estimate_windows(rig, self.logs, self.method, self.settings, start)

    def quick(self, rig: Rig) -> WindowEstimate:
        """The windows in sequence; asked twice in a row for a rig, it is the same estimate."""
        if self._last_quick is None or self._last_quick[0] is not rig:
            self._last_quick = rig, estimate_windows(rig, self.logs, "online", self.settings)
        return self._last_quick[1]

    def begun_at(self, start: WindowEstimate, rig: Rig) -> WindowEstimate:
        """By `map`, begun at an estimate with another rig."""
        return estimate_windows(rig, self.logs, "map", self.settings, start)

    def best(self, rig: Rig) -> WindowEstimate:
        """What explains most samples: as a whole, or begun by the windows in sequence."""
        return self._begun_in_sequence(rig, self.plain(rig))

    def explain(self, stated: Rig, rescale: bool) -> Explanation:
        """The estimate that explains most, with the noise that the data show.

        Args:
            stated: rig as the person states it.
            rescale: take the size of the noise from the residuals.
        """
        rig = with_noise_of_walk(stated, self.logs)
        first = self._with_jumps(rig)
        unexplained = self._free is None  # by free offsets, with the noise as stated
        estimate, noise = estimate_with_noise(stated, rig, first, self._estimated, rescale, unexplained)
        moving = None
        fitted = max(fitted_share(first.windows), fitted_share(estimate.windows))
        if self._free is not None and fitted < ENOUGH:
            moving = wandering(rig, self.logs, self._free, self.plain)
        if moving is not None:
            rig = moving.rig
            estimate, noise = estimate_with_noise(stated, rig, moving.estimate, self._estimated, rescale)
        return Explanation(estimate, noise, rig, with_noise(rig, noise.assumed), moving)

    def without(self, kept: Sequence[Log], rig: Rig, found: WindowEstimate) -> WindowEstimate:
        """The estimate from a part of the logs, begun at that from all of them."""
        again = estimate_windows(rig, kept, self.method, self.settings, found)
        if fitted_share(again.windows) >= min(ENOUGH, 0.9 * fitted_share(found.windows)):
            return again
        return estimate_windows(rig, kept, self.method, self.settings)

    def _estimated(self, rig: Rig, quick: bool) -> WindowEstimate:
        return self.quick(rig) if quick else self.best(rig)

    def _with_jumps(self, rig: Rig) -> WindowEstimate:
        """What explains most samples, with offsets that jump where logs fit so."""
        found = self.plain(rig)
        if _explained(found, ENOUGH):
            return self._rather_cut(rig, found) or found
        self._free = with_free_offsets(rig, self._as_a_whole)
        cut = None if self._free is None else self._cut_at_jumps(rig, self._free)
        return self._begun_in_sequence(rig, found) if cut is None else cut

    def _rather_cut(self, rig: Rig, found: WindowEstimate) -> WindowEstimate | None:
        """The logs cut at jumps that gain or contacts have taken up; None where there are none.

        None also where a step alone would not tell: the offset may walk, or lags behind a filter.
        """
        sensor = rig.sensor
        if not offsets_may_move(rig) or sensor.offset_walk_array.any() or sensor.lowpass_hz is not None:
            return None
        shown: WindowEstimate | None = found  # with a wrench also where there are contacts
        contacts = any(rows.any() for rows in found.left_out)
        if any(open_end(wrench) > 0 for wrench in found.wrench):
            shown = with_free_offsets(rig, self._as_a_whole)
        elif self.method == "online" or contacts:
            settings = _core.EstimatorSettings()
            settings.window, settings.threads = self.settings.window, self.settings.threads
            settings.knots = _glaring_contacts_alone()
            shown = estimate_windows(rig, self.logs, "map", settings, found)
            if not contacts and fitted_share(shown.windows) < ENOUGH:  # one gain for all does not fit
                shown = with_free_offsets(rig, self._as_a_whole)
        if shown is None or not shown.solved:
            return None
        return self._cut_at_jumps(rig, shown, found)

    def _as_a_whole(self, rig: Rig) -> WindowEstimate:
        """By `map`, whose wrenches are those of one gain: residuals of `online` show how it was found."""
        return estimate_windows(rig, self.logs, "map", self.settings)

    def _cut_at_jumps(
        self, rig: Rig, shown: WindowEstimate, uncut: WindowEstimate | None = None
    ) -> WindowEstimate | None:
        """The logs cut where their offsets jump; None where that is not all.

        Args:
            rig: with an offset for each log.
            shown: whose wrenches show it.
            uncut: with contacts in place of jumps. Those to a log's end are no better, if a cut explains it.
        """
        noise, whole = rig.sensor.noise_array, self.logs
        to_end = [uncut is not None and open_end(wrench) > 0 for wrench in (uncut or shown).wrench]
        jumps, rows = [], sum(map(len, shown.wrench_rows))
        claimed = _is_determined(rig, uncut or shown)
        for k, of_log in enumerate(_wrenches_of(whole, rig, shown)):
            contacts = None if uncut is None or to_end[k] else untold(uncut.wrench[k])
            share = len(of_log[1]) / rows if claimed else 0.0
            jumps.append(jump_in(*of_log, noise, contacts, share))
        if not any(jumps):
            return None
        self.logs = [log_cut_at(log, jump) for log, jump in zip(whole, jumps, strict=True)]
        cut = self._as_a_whole(rig)
        moving = any(still_moves(*of_log, noise) for of_log in _wrenches_of(self.logs, rig, cut))
        open_still = any(jump and to_end[k] and open_end(cut.wrench[k]) > 0 for k, jump in enumerate(jumps))
        contested = any(
            uncut is not None and jump and jump.contested
            and not _replaced(whole[k].time[uncut.wrench_rows[k]], jump, uncut.left_out[k], cut.left_out[k])
            for k, jump in enumerate(jumps)
        )  # fmt: skip
        if cut.solved and _explained(cut, NEARLY_ALL) and not (moving or open_still or contested):
            self.jumps, self._last_quick = jumps, None
            return cut if self.method == "map" else self.plain(rig)
        self.logs = whole
        return None

    def _begun_in_sequence(self, rig: Rig, found: WindowEstimate) -> WindowEstimate:
        if self.method == "online" or fitted_share(found.windows) >= ENOUGH:
            return found
        quick = self.quick(rig)
        if not quick.solved or fitted_share(quick.windows) == 0.0:
            return found
        again = self.plain(rig, quick)
        better = again.solved and fitted_share(again.windows) >= fitted_share(found.windows)
        return again if better else found


def _wrenches_of(
    logs: Sequence[Log], rig: Rig, found: WindowEstimate
) -> Iterator[tuple[Log, NDArray[np.int64], NDArray[np.float64]]]:
    """Per log: itself at the reference temperature, rows and the wrench there."""
    for log, rows, wrench in zip(logs, found.wrench_rows, found.wrench, strict=True):
        yield at_reference_temperature(found.offset_temperature, rig, log), rows, wrench


def _is_determined(rig: Rig, found: WindowEstimate) -> bool:
    """Whether every direction of the gain is: any other is refused, whatever may hide in it."""
    gains = 6 * rig.sensor.n
    largest = np.linalg.eigvalsh(found.normalised_covariance[:gains, :gains])[-1]
    return bool(largest < (UNDETERMINED * rig.sensor.gain_prior) ** 2)


def _replaced(
    time: NDArray[np.float64], jump: Jump, contacts: NDArray[np.bool_], left: NDArray[np.bool_]
) -> bool:
    """Whether with a jump hardly a sample is `left` (M,) out, in place of `contacts` (M,) that lie elsewhere.

    Then it is the simpler explanation, however much contacts explain.
    """
    elsewhere = contacts & ((time < jump.begin) | (time > jump.end))
    return bool(left.sum() < FEWER * elsewhere.sum())


def _glaring_contacts_alone() -> _core.KnotSettings:
    knots = _core.KnotSettings()
    knots.false_disturbances, knots.false_pushes = GLARING, TINY
    return knots


def _explained(estimate: WindowEstimate, share: float) -> bool:
    left_out = sum(float(rows.sum()) for rows in estimate.left_out)
    samples = sum(rows.size for rows in estimate.left_out)
    return fitted_share(estimate.windows) >= share and left_out <= LEFT_OUT * samples
