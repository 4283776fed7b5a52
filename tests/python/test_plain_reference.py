"""The core beside a plain NumPy reference of the same equations, stage by stage and over the whole loop.

The reference is not part of the repository: it is looked for in `../shared/reference`, or where
TRUEWRENCH_REFERENCE points, and the tests are skipped where it is absent.
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from truewrench import _core

FOLDER = Path(os.environ.get("TRUEWRENCH_REFERENCE") or Path(__file__).parents[3] / "shared" / "reference")
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not (FOLDER / "estimate.py").exists(), reason=f"no reference in {FOLDER}"),
]

# kind, size, motion, gravity: ordinary sizes of ten kinds, where d enters and where it stays out
RECORDS = (
    ("clean", 1.0, "six", False),
    ("clean", 1.0, "six", True),
    ("clean", 1.0, "one", False),
    ("clock", 2e-3, "six", False),
    ("velocity_filter", 40.0, "six", True),
    ("nonlinearity", 1e-3, "six", False),
    ("drift", 5e-4, "six", False),
    ("contact", 5e-2, "six", False),
    ("spikes", 5e-2, "six", True),
    ("step", 7e-3, "six", False),
)


@pytest.fixture(scope="module")
def plain() -> dict[str, ModuleType]:
    sys.path.insert(0, str(FOLDER))
    try:
        return {name: importlib.import_module(name) for name in ("simulate", "fit", "estimate", "judge")}
    finally:
        sys.path.remove(str(FOLDER))


def _statement(rig: Any) -> Any:
    s = _core.Statement()
    s.range, s.sign, s.noise, s.nominal = rig.range, 1.0, rig.noise / rig.range, np.eye(6)
    s.gain_prior, s.offset_prior = rig.gain_prior, np.full(6, rig.offset_prior)
    s.gravity, s.tilt_prior = rig.gravity, rig.tilt_sigma if np.any(rig.gravity) else 0.0
    root = np.sqrt(np.diag(rig.inertia))
    inertia = [rig.inertia_sigma * root[i] * root[j] for i, j in PAIRS]
    s.body_prior = [np.concatenate([[rig.mass_sigma], [rig.com_sigma] * 3, inertia])]
    return s


def _log(rig: Any, record: Any) -> Any:
    log = _core.RecordedLog()
    log.source = _core.Source.twist
    log.payload, log.point = _core.Payload(rig.mass, rig.com, rig.inertia), rig.com
    log.time, log.raw = record.t, record.raw / rig.range
    if record.attitude is not None:
        log.R_sensor_root = np.ascontiguousarray(record.attitude.transpose(0, 2, 1)).reshape(-1, 9)
    twist = _core.MotionStream()
    twist.time, twist.value, twist.sigma = record.t, record.twist, rig.motion_noise
    twist.group = np.array([0, 0, 0, 1, 1, 1], dtype=np.int32)
    twist.time_offset_prior = rig.time_offset_prior
    log.motion = [twist]
    return log


def _places(columns: Any, layout: Any) -> np.ndarray:
    """Where each parameter of the reference stands in the core's theta."""
    at, out = np.array(columns.at), np.zeros(layout.size, dtype=int)
    for place, begin, count in (
        (layout.C, columns.C, 36),
        (layout.b, columns.b, 6),
        (layout.u, columns.u, 6),
        (layout.s, columns.clock[0], 1),
        (layout.kappa, columns.clock[0] + 1, 1),
    ):
        out[place] = at[begin : begin + count]
    body = columns.body_in_theta
    for place, begin, count in (
        (layout.mass, body, 1),
        (layout.com, body + 1, 3),
        (layout.inertia, body + 4, 6),
    ):
        out[place] = range(begin, begin + count)
    if layout.gravity:
        out[layout.gamma], out[layout.tilt] = at[columns.gamma], at[columns.tilt : columns.tilt + 2]
    for place, begin in zip(layout.steps, columns.steps, strict=True):
        out[place] = at[begin : begin + 6]
    return out


@pytest.mark.parametrize("form", [None, "matern", "walk"])
@pytest.mark.parametrize("gravity", [False, True])
def test_one_state_gives_one_linearisation(
    plain: dict[str, ModuleType], form: str | None, gravity: bool
) -> None:
    rig, record, _ = plain["simulate"].simulate(3, in_gravity=gravity, duration=4.0, scenario=1)
    theirs = plain["fit"].Fit(rig, record, 0.05, form, steps=[1.7])
    plain["estimate"].start(theirs)
    rng = np.random.default_rng(0)
    small = theirs.layout.sigma < 0.05
    theirs.theta += 0.3 * theirs.layout.sigma * rng.standard_normal(theirs.layout.size) * small
    theirs.delta[:] = 1e-4
    theirs.e[:] = 0.0 if form is None else 1e-4 * rng.standard_normal(theirs.e.shape)
    theirs.lagged = theirs.theta[:36].reshape(6, 6).copy()

    statement, log = _statement(rig), _log(rig, record)
    ours = _core.make_fit(statement, [log], [0.05], [[1.7]], getattr(_core.Form, form or "none"))
    at = _places(ours.columns(0), theirs.layout)
    for name in ("theta", "prior"):
        value = np.zeros(at.size)
        value[at] = getattr(theirs, name)
        setattr(ours, name, value)
    ours.lagged = theirs.lagged
    ours.set_motion(0, 0, theirs.c)
    ours.set_discrepancy(0, 0, theirs.e)
    sizes = ours.sizes(0)
    sizes.q, sizes.raw_factor, sizes.motion_factor = theirs.q, theirs.factor[:2], [theirs.factor[2:]]
    if form is not None:
        sizes.k, sizes.delta = theirs.k, theirs.delta

    theirs.predict()
    ours.predict()
    assert np.abs(ours.rows(0)["residual"] - theirs.r_raw).max() < 1e-9
    assert np.abs(ours.motion_residual(0, 0) - theirs.r_twist).max() < 1e-9
    theirs.weight[:] = 1.0
    ours.reweigh()
    theirs.linearise()
    theirs.solve()
    assert ours.linearise()
    assert ours.solve()
    active = theirs.active
    assert sorted(at[active]) == list(ours.active)
    assert abs(ours.objective() - theirs.objective()) < 1e-9 * theirs.objective()
    plain_determinant = theirs.chol.logdet + np.linalg.slogdet(theirs.S[np.ix_(active, active)])[1]
    assert abs(ours.log_determinant() - plain_determinant) < 0.5

    band, cross = theirs.chol.band(), np.concatenate([theirs.Z[:-1], theirs.Z[1:]], 1)
    ZP = cross @ theirs.P
    band = band + np.matmul(ZP, cross.transpose(0, 2, 1))
    used = np.array(
        [
            ((theirs.H[i] * band).sum() - 2 * (theirs.F[i] * ZP).sum() + (theirs.Htt[i] * theirs.P).sum())
            / theirs.factor[i] ** 2
            for i in range(4)
        ]
    )
    traces = ours.traces(0, 0)
    assert traces["motion"][0] == pytest.approx(used[2:], rel=5e-3)
    before = sizes.raw_factor.copy()
    theirs.advance()
    ours.advance()
    theirs.resize()
    ours.resize()
    # the sizes after one step hold the traces of the sensor's rows
    assert sizes.raw_factor / before == pytest.approx(theirs.factor[:2] / before, rel=5e-3)
    assert sizes.q == pytest.approx(theirs.q, rel=5e-3)
    if form is not None:
        assert sizes.delta == pytest.approx(theirs.delta, rel=5e-3)


def _to_the_end_of_upsilon(fit: Any) -> None:
    """The reference moves upsilon one step of (10.6) an iteration and stops without it."""
    if fit.form is not None:
        return
    for _ in range(60):
        before = fit.prior[fit.layout.u][0]
        fit.linearise()
        fit.solve()
        fit.advance()
        fit.resize()
        if abs(np.log(fit.prior[fit.layout.u][0] / before)) < 0.02:
            return


@pytest.fixture
def _tau_to_its_end(plain: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference's tau creeps, has not ended after 25 steps, and has no end but the record's length."""
    fit = plain["fit"].Fit
    creep = fit._resize_tau

    def within(self: Any, parts: Any) -> float:
        before = self.k
        creep(self, parts)
        self.set_k(max(self.k, 1.0 / (self.spline.h * self.spline.intervals)))
        return abs(float(np.log(self.k / before)))

    monkeypatch.setattr(fit, "_resize_tau", within)
    monkeypatch.setattr(fit.run, "__defaults__", (80,))


@pytest.mark.parametrize(("kind", "size", "motion", "gravity"), RECORDS)
@pytest.mark.usefixtures("_tau_to_its_end")
def test_the_whole_loop_agrees(
    plain: dict[str, ModuleType], kind: str, size: float, motion: str, gravity: bool
) -> None:
    rig, record, _ = plain["simulate"].simulate(7000, (kind,), (size,), motion, gravity, scenario=1)
    rig.discrepancy = None
    theirs = plain["estimate"].estimate(rig, record)
    if theirs.fit.form == "matern":  # counts over one period of the motion, as walks do in the reference
        x = theirs.fit.k * plain["judge"].period(theirs.fit)
        theirs.size2 = theirs.size2 * min(1.0, 2.0 * (1.0 - (1.0 + x) * np.exp(-x)))
    verdict = plain["judge"].judge(theirs, rig)
    ours = _core.estimate(_statement(rig), [_log(rig, record)], _core.Settings())
    assert ours.status == _core.Status.ok
    _to_the_end_of_upsilon(theirs.fit)
    sigma = np.sqrt(np.diag(verdict.covariance))
    steps, their_steps = list(ours.fit.columns(0).step_times), [float(t) for t in theirs.fit.steps]
    # the reference places a step where a block begins, and masks what lies between
    near = 0.1 if steps == pytest.approx(their_steps) else 0.3
    assert steps == pytest.approx(their_steps, abs=5.0 * theirs.fit.h + 1e-9)
    assert np.abs((ours.fit.theta[:36] - theirs.fit.theta[:36]) / sigma).max() < near
    # the reference integrates the pose by rectangles: 4e-4 in A, which is a tenth of 1 - A at one frequency
    theirs.fit.mask = np.asarray(ours.fit.rows(0)["masked"]).ravel() > 0.0
    assert pytest.approx(plain["judge"].pose_share(theirs.fit)[0], abs=2e-3) == ours.pose.A
    before = np.diag(theirs.covariance)[:36]
    at = np.array(ours.fit.columns(0).at)[:36]
    before_ours = np.diag(ours.covariance)[at] + np.diag(ours.added)
    assert np.sqrt(before_ours) == pytest.approx(np.sqrt(before), rel=0.03)
    hidden = (verdict.A / (1.0 - verdict.A)) / (ours.pose.A / (1.0 - ours.pose.A))
    total = before_ours + hidden * (np.diag(ours.gain_covariance) - before_ours)
    assert np.sqrt(total) == pytest.approx(sigma, rel=0.03)
    assert ours.fit.spacing(0) == pytest.approx(theirs.fit.h)
    form = str(ours.fit.sizes(0).form).rsplit(".", 1)[-1]
    assert form == (theirs.fit.form or "none")
    disagree = min(ours.halves.p, ours.quarters.p) < 5e-4
    assert disagree == ("disagree" in verdict.reasons)
    assert bool(ours.unresolved[0]) == ("unresolved" in verdict.reasons)
