"""Parts of an arm that were sampled at times of their own."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from truewrench.robot.parts import on_common_rows

Array = NDArray[np.float64]


def motion(time: Array, joints: int) -> Array:
    return np.sin(2.0 * time[:, None] + np.arange(joints))


def sampled(*times: Array, joints: int = 2) -> tuple[Array, Array]:
    """The union of all times, and on it the joints of each part at its own."""
    time = np.unique(np.concatenate(times))
    out = np.full((time.size, joints * len(times)), np.nan)
    for k, own in enumerate(times):
        here = slice(joints * k, joints * (k + 1))
        out[np.searchsorted(time, own), here] = motion(own, joints * len(times))[:, here]
    return time, out


@given(st.integers(20, 200), st.integers(20, 200), st.floats(0.0, 0.01))
def test_all_parts_stand_on_the_rows_of_the_slowest(first: int, second: int, apart: float) -> None:
    a, b = np.arange(first) / first, apart + np.arange(second) / second
    time, joints = sampled(a, b)
    found, parts = on_common_rows(time, joints)
    rows = np.flatnonzero(np.isfinite(found).all(axis=1))
    if len(parts) == 1:  # most rows have all joints
        np.testing.assert_array_equal(found, joints)
        return
    slowest = a if parts[0] == [0, 1] else b
    assert slowest.size == min(first, second)
    assert np.isin(time[rows], slowest).all()
    assert rows.size >= slowest.size - 2 - slowest.size // 20
    widest = 1.0 / min(first, second)
    assert np.abs(found[rows] - motion(time[rows], 4)).max() < (2.0 * widest) ** 4 + 1e-12


def test_nothing_is_interpolated_in_a_gap() -> None:
    fast = np.arange(0.0, 4.0, 1e-3)
    time, joints = sampled(np.arange(0.0, 4.0, 2.5e-3), fast[(fast < 1.0) | (fast > 1.1)])
    found, parts = on_common_rows(time, joints)
    assert len(parts) == 2
    whole = time[np.isfinite(found).all(axis=1)]
    assert not np.any((whole > 1.0) & (whole < 1.1))
    assert np.any(whole < 1.0)
    assert np.any(whole > 1.1)


def test_noise_of_interpolated_samples_is_no_larger_and_does_not_repeat() -> None:
    rng = np.random.default_rng(0)
    slow, fast = np.arange(0.0, 200.0, 1e-2), np.arange(0.0, 200.0, 7e-3)
    time, joints = sampled(slow, fast)
    noise = rng.standard_normal(joints.shape)
    found = on_common_rows(time, joints + noise)[0] - on_common_rows(time, joints)[0]
    rest = found[np.isfinite(found).all(axis=1)]
    variance = rest.var(axis=0)
    np.testing.assert_allclose(variance[:2], 1.0, rtol=0.05)
    assert (variance[2:] < 1.0).all()
    # white in its low frequencies: means over a hundred rows are as uncertain as they are said to be
    means = rest[: rest.shape[0] // 100 * 100].reshape(-1, 100, 4).mean(axis=1)
    assert (100.0 * means.var(axis=0) < 1.3).all()


def test_a_joint_that_misses_samples_is_no_part_of_its_own() -> None:
    time, joints = sampled(np.arange(0.0, 1.0, 1e-2))
    joints[::3, 1] = np.nan
    found, parts = on_common_rows(time, joints)
    assert parts == [[0, 1]]
    np.testing.assert_array_equal(found, joints)
