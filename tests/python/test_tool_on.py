"""A workpiece on a tool that was identified before: honest, and as good as both records in one estimate."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contact_cases import tilted
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from tool_cases import a_rig

import truewrench as tw
from truewrench.correction.contact.log import contact as contact_of
from truewrench.estimation.static_poses import REPEATABILITY, WALK
from truewrench.model.errors import InputError
from truewrench.model.files import write_yaml
from truewrench.model.log import Log
from truewrench.model.rig import Rig
from truewrench.model.rig.tool_rig import tool_rig
from truewrench.tool.exports import tool_exports
from truewrench.tool.model import Tool

Array = NDArray[np.float64]

POSES, APART, PAUSE = 12, 8.0, 60.0  # [s] between poses, and between the records
GAIN, MOUNTING, TILT = 0.02, np.radians(3.0), np.radians(0.5)  # 1 sigma, as nobody states otherwise
FEW = 4  # poses of the workpiece in a hurry
# in one vector: gain (36), tool and workpiece (log m, c), offset (6), mounting (3), tilt (2)
TOOL, PIECE, OFFSET, MOUNTED, TILTED = (
    slice(36, 40),
    slice(40, 44),
    slice(44, 50),
    slice(50, 53),
    slice(53, 55),
)


def a_rig_of(session: bool) -> Rig:
    return tool_rig(a_rig(sensor={"pool_offsets": session}))


RIG = a_rig_of(True)
SPAN = RIG.sensor.range_array
UNITS = SPAN[:, None] / SPAN


def predicted(theta: Array, attitudes: Array, with_piece: bool) -> Array:
    """(T, 6) channels at rest, without walk and noise."""
    fall = attitudes.transpose(0, 2, 1) @ tilted(RIG.gravity_array, theta[TILTED])
    w = np.zeros((len(fall), 6))
    for body in (TOOL, PIECE)[: 1 + with_piece]:
        mass, center = np.exp(theta[body][0]), theta[body][1:]
        w += mass * np.hstack([fall, np.cross(center, fall)])
    turn = Rotation.from_euler("xyz", theta[MOUNTED]).as_matrix()  # of the channels in the sensor frame
    turned = np.hstack([w[:, :3] @ turn, w[:, 3:] @ turn])
    return np.asarray(turned @ theta[:36].reshape(6, 6).T + theta[OFFSET])


class Both:
    """A tool's record and one with a workpiece, of one session; everything drawn from what is believed."""

    def __init__(self, seed: int, poses: int = POSES, cone: float = np.pi) -> None:
        rng = np.random.default_rng(seed)
        self.theta = np.concatenate(
            [
                (np.eye(6) + GAIN * UNITS * rng.normal(size=(6, 6))).ravel(),
                [np.log(rng.uniform(0.8, 2.5))], rng.normal(size=3) * 0.02 + [0.0, 0.0, 0.08],
                [np.log(rng.uniform(0.3, 1.5))], rng.normal(size=3) * 0.03 + [0.0, 0.0, 0.2],
                0.1 * SPAN * rng.normal(size=6), MOUNTING * rng.normal(size=3), TILT * rng.normal(size=2),
            ]
        )  # fmt: skip
        begin = POSES * APART + PAUSE
        self.time = np.concatenate([np.arange(POSES) * APART, begin + np.arange(poses) * APART])
        turns = Rotation.random(POSES + poses, random_state=rng)
        if cone < np.pi:  # the workpiece about one pose
            axes = np.column_stack([rng.normal(size=(poses, 2)), np.zeros(poses)])
            axes *= cone / np.linalg.norm(axes, axis=1, keepdims=True)
            turns = Rotation.concatenate([turns[:POSES], Rotation.from_rotvec(axes)])
        self.attitudes = turns.as_matrix()
        steps = np.sqrt(np.diff(self.time, prepend=0.0))[:, None] * rng.normal(size=(len(self.time), 6))
        self.walk = np.cumsum(WALK * SPAN * steps, axis=0)
        scatter = np.hypot(REPEATABILITY * SPAN, RIG.sensor.noise_array)
        raw = self.predicted(self.theta) + self.walk + scatter * rng.normal(size=(len(self.time), 6))
        self.logs = [self._log(raw, part) for part in (slice(None, POSES), slice(POSES, None))]

    def predicted(self, theta: Array) -> Array:
        first, second = self.attitudes[:POSES], self.attitudes[POSES:]
        return np.vstack([predicted(theta, first, False), predicted(theta, second, True)])

    def _log(self, raw: Array, part: slice) -> Log:
        R = self.attitudes[part]
        quaternion = Rotation.from_matrix(R).as_quat()[:, [3, 0, 1, 2]]
        stamps = (self.time[part] * 1e9).astype(np.int64)
        fall, still = R.transpose(0, 2, 1) @ RIG.gravity_array, np.zeros((len(R), 6))
        return Log(None, "tool", "", stamps, raw[part], twist=still, gravity=fall, attitude=quaternion)

    def two_steps(self, rig: Rig) -> Tool:
        return tw.identify_tool(rig, self.logs[1], on=tw.identify_tool(rig, self.logs[0]))

    def pooled_std(self, same_session: bool) -> float:
        """1 sigma of the log of the workpiece's mass from both records at once, the walk's rate known."""
        size, h = self.theta.size, 1e-6
        J = np.stack(
            [
                (self.predicted(self.theta + d) - self.predicted(self.theta - d)) / (2 * h)
                for d in h * np.eye(size)
            ],
            axis=2,
        )  # (T, 6, p)
        prior = np.concatenate(
            [
                (GAIN * UNITS).ravel(),
                [1.5],
                [0.15] * 3,
                [1.5],
                [0.15] * 3,
                0.1 * SPAN,
                [MOUNTING] * 3,
                [TILT] * 2,
            ]
        )
        since = np.minimum(self.time[:, None], self.time)
        if not same_session:  # another offset for the second record
            second = np.zeros((len(self.time), 6, 6))
            second[POSES:] = np.eye(6)
            J = np.concatenate([J, second], axis=2)
            prior = np.append(prior, 0.1 * SPAN)
            T = self.time[POSES:] - self.time[POSES]
            T1 = self.time[:POSES]
            since = block_diag(np.minimum(T1[:, None], T1), np.minimum(T[:, None], T))
        information = np.diag(prior**-2.0)
        for i in range(6):
            V = (WALK * SPAN[i]) ** 2 * since
            V += np.eye(len(V)) * ((REPEATABILITY * SPAN[i]) ** 2 + RIG.sensor.noise_array[i] ** 2)
            information += J[:, i].T @ np.linalg.solve(V, J[:, i])
        return float(np.sqrt(np.linalg.inv(information)[PIECE.start, PIECE.start]))

    def nees(self, tool: Tool, body: slice, end: int) -> tuple[float, float]:
        """Of gain, body, mounting and tilt, over their number; of the offset at pose `end`."""
        layout = tool.layout
        held = np.r_[layout.gain, layout.log_mass, layout.center_of_mass, layout.mounting, layout.tilt]
        told = np.concatenate([self.theta[part] for part in (slice(36), body, MOUNTED, TILTED)])
        offset = np.r_[layout.offset]
        out = []
        for place, truth in ((held, told), (offset, self.theta[OFFSET] + self.walk[end])):
            error, P = tool.theta[place] - truth, tool.covariance[np.ix_(place, place)]
            out.append(float(error @ np.linalg.solve(P, error)) / place.size)
        return out[0], out[1]


@pytest.mark.slow
@pytest.mark.parametrize("same_session", [True, False])
def test_two_steps_are_honest_and_as_good_as_one_estimate_of_both(same_session: bool) -> None:
    nees, of_offset, against, squares = [], [], [], []
    for seed in range(20):
        both = Both(seed)
        first = tw.identify_tool(RIG, both.logs[0])
        tool = tw.identify_tool(a_rig_of(same_session), both.logs[1], on=first)
        before, after = both.nees(first, TOOL, POSES - 1), both.nees(tool, PIECE, -1)
        nees.append(after[0])
        of_offset.append([before[1], after[1]])
        std = float(np.sqrt(tool.covariance[36, 36]))
        squares.append(((np.log(tool.mass) - both.theta[PIECE][0]) / std) ** 2)
        against.append(std / both.pooled_std(same_session))
    assert 0.8 < np.mean(nees) < 1.2
    assert 0.95 < np.mean(against) < 1.1
    assert max(against) < 1.3
    low, high = chi2.ppf([0.005, 0.995], 20) / 20
    assert low < np.mean(squares) < high
    if same_session:  # an offset that is carried over is as honest as it was
        assert np.mean(of_offset, axis=0)[1] < 1.2 * max(1.0, np.mean(of_offset, axis=0)[0])


def test_an_offset_of_the_same_session_weighs_a_workpiece_that_is_hardly_turned() -> None:
    """Within 5 deg of one pose, weight and an offset of its own look alike."""
    both = Both(3, FEW, cone=np.radians(5.0))
    anew, same = (both.two_steps(a_rig_of(session)) for session in (False, True))
    assert same.mass_std < 0.3 * anew.mass_std
    assert (same.offset_std < anew.offset_std).all()
    mass = np.exp(both.theta[PIECE][0])
    for tool in (anew, same):
        assert abs(tool.mass - mass) < 3.5 * tool.mass_std


def test_a_sensor_that_was_zeroed_in_between_is_told() -> None:
    both = Both(4)
    tool = tw.identify_tool(RIG, both.logs[0])
    zeroed = replace(both.logs[1], raw=both.logs[1].raw - both.logs[1].raw[0])
    refused = tw.identify_tool(RIG, zeroed, on=tool)
    assert not refused.verdict.usable
    assert any("zeroed in between" in reason for reason in refused.verdict.reasons)
    assert tw.identify_tool(a_rig_of(False), zeroed, on=tool).verdict.usable


def test_a_record_before_the_tool_is_of_no_session_with_it() -> None:
    both = Both(5)
    tool = tw.identify_tool(RIG, both.logs[0])
    early = replace(both.logs[1], time_ns=both.logs[1].time_ns - 200 * 10**9)
    with pytest.raises(InputError, match=r"before the offset of --on at .*pool_offsets: false"):
        tw.identify_tool(RIG, early, on=tool)
    tw.identify_tool(a_rig_of(False), early, on=tool)


def test_two_records_of_a_workpiece_share_the_offset_that_walked() -> None:
    """Cut in two, the second record is worth what it was: the walk links the parts."""
    both = Both(6)
    tool = tw.identify_tool(RIG, both.logs[0])
    whole = tw.identify_tool(RIG, both.logs[1], on=tool)
    log = both.logs[1]
    assert log.twist is not None
    assert log.gravity is not None
    assert log.attitude is not None
    parts = [
        replace(
            log, time_ns=log.time_ns[part], raw=log.raw[part], twist=log.twist[part],
            gravity=log.gravity[part], attitude=log.attitude[part],
        )
        for part in (slice(None, 6), slice(6, None))
    ]  # fmt: skip
    cut = tw.identify_tool(RIG, parts, on=tool)
    assert cut.mass == pytest.approx(whole.mass, abs=0.5 * whole.mass_std)
    assert cut.mass_std == pytest.approx(whole.mass_std, rel=0.15)


def test_what_is_below_is_in_contact_wrenches_exports_and_what_sits_on_top(tmp_path: Path) -> None:
    """A pose of both is no contact, controllers are told of both, and a third body is weighed on both."""
    both = Both(8)
    first = tw.identify_tool(RIG, both.logs[0])
    tool = tw.identify_tool(RIG, both.logs[1], on=first)
    tool.write_yaml(tmp_path / "tool.yaml")
    read = tw.read_tool(tmp_path / "tool.yaml")
    assert read.covariance.tobytes() == tool.covariance.tobytes()
    assert tool.mass == pytest.approx(np.exp(both.theta[PIECE][0]), abs=4 * tool.mass_std)

    masses = np.exp([both.theta[TOOL][0], both.theta[PIECE][0]])
    centers = np.array([both.theta[TOOL][1:], both.theta[PIECE][1:]])
    for one in (tool.whole, read.whole):
        assert one.mass == pytest.approx(masses.sum(), abs=4 * one.mass_std)
        away = one.center_of_mass - masses @ centers / masses.sum()
        assert (np.abs(away) < 4 * one.center_of_mass_std).all()
    assert tool.exported.mass == pytest.approx(tool.whole.mass)
    assert np.allclose(tool.exported.center_of_mass, tool.whole.center_of_mass)
    held = json.loads(tool_exports(read, ["franka"])["tool_franka.json"])
    assert held["mass"] == tool.exported.mass
    assert f"the tool below it, of {np.exp(read.below[0]):.6g} kg" in held["comment"]

    contact = contact_of(both.logs[1], read)
    assert np.nanmax(contact.chi2) < 40.0  # no contact; the lower tool's weight were 8 to 25 N of it
    assert np.nanmax(np.abs(contact.wrench[:, :3])) < 2.0

    third = tw.identify_tool(RIG, replace(both.logs[1], time_ns=both.logs[1].time_ns + 10**12), on=read)
    assert third.mass < 0.05  # nothing sits on both
    assert np.exp(third.below[0]) == pytest.approx(masses.sum(), rel=0.05)


def test_a_file_that_says_what_is_below_without_its_covariance_is_refused(tmp_path: Path) -> None:
    both = Both(9)
    tool = tw.identify_tool(RIG, both.logs[1], on=tw.identify_tool(RIG, both.logs[0]))
    data = tool.to_mapping()
    alone = data["covariance"]
    data["covariance"] = {"names": alone["names"][:57], "matrix": alone["matrix"][:57, :57]}
    write_yaml(tmp_path / "tool.yaml", data)
    with pytest.raises(InputError, match=r"covariance\.names.*67 names.*below"):
        tw.read_tool(tmp_path / "tool.yaml")
    del data["below"]  # a file from before there was one: the upper body alone
    write_yaml(tmp_path / "tool.yaml", data)
    assert tw.read_tool(tmp_path / "tool.yaml").whole.mass == tool.mass
