"""Time of a log."""

import numpy as np

from truewrench.model.log import Log


def test_time_keeps_nanoseconds_a_lifetime_after_1970() -> None:
    start = 4_000_000_000_000_000_000  # 2096; a double of seconds resolves half a microsecond there
    log = Log(None, "default", "", np.array([start, start + 1, start + 10**9 + 1]), np.zeros((3, 6)))
    np.testing.assert_array_equal(log.time, [0.0, 1e-9, 1_000_000_001 * 1e-9])
