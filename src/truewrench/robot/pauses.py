"""Long pauses of a joint log, shortened: a motion laid through them would ask for memory by the day."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from truewrench.model.arrays import Integers
from truewrench.model.log import Log, Reference

_SHORTENED = 10.0  # [s] that is left of a pause, and
_PERIODS = 40  # of joints and base at least
_LONG = 2.0  # of what would be left: from which on a pause is long


@dataclass(frozen=True, slots=True, eq=False)
class Pauses:
    """Where neither joints nor base tell anything for long."""

    edges_ns: Integers  # (2K,) stamps: begins and ends in turn
    cut_ns: Integers  # (2K,) by how much later stamps are brought forward at each of them

    @classmethod
    def of(cls, log: Log) -> Pauses:
        """Of a log's own."""
        streams = (log.position, log.velocity, log.base_twist, log.base_attitude)
        told = [np.isfinite(x).any(axis=1) for x in streams if x is not None]
        stamps = log.time_ns[np.any(told, axis=0)]
        steps = np.diff(stamps)
        left = round(max(_SHORTENED * 1e9, _PERIODS * float(np.median(steps)))) if steps.size else 0
        long = np.flatnonzero(steps > _LONG * left)
        edges = np.stack([stamps[long], stamps[long + 1]], axis=1).ravel()
        cut = np.cumsum(steps[long] - left)
        before = np.concatenate([[0], cut[:-1]]) if cut.size else cut
        return cls(edges, np.stack([before, cut], axis=1).ravel())

    def __bool__(self) -> bool:
        return bool(self.edges_ns.size)

    def without(self, log: Log) -> Log:
        """The log with its pauses shortened, what else is in them closer together."""
        since, edges = log.time_ns - log.time_ns[0], self.edges_ns - log.time_ns[0]
        pieces = np.searchsorted(edges, since, side="right")
        known = np.concatenate([[0], self.cut_ns])[pieces]  # of all that lies in no pause
        inside = pieces % 2 == 1
        k = pieces[inside] - 1
        share = (since[inside] - edges[k]) / (edges[k + 1] - edges[k])
        cut = (self.cut_ns[k + 1] - self.cut_ns[k]) * share
        known[inside] += np.floor(cut).astype(np.int64)
        return replace(log, time_ns=log.time_ns - known)

    def within(self, reference: Reference) -> Reference:
        """A reference of the shortened log, for the times of the log as it is."""
        edges, cut = (
            np.asarray(1e-9 * ns, np.float64) for ns in (self.edges_ns - reference.origin_ns, self.cut_ns)
        )
        return replace(reference, pause_edges=edges, pause_cut=cut)
