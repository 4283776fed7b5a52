"""Words that callers pass from Python are one of those that there are."""

from typing import Any

import pytest

import truewrench as tw
from truewrench.correction.contact.run import View
from truewrench.model.log import Log
from truewrench.model.rig import Rig


@pytest.fixture
def log(rig: Rig) -> Log:
    return tw.simulate(rig, seed=0).log


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"estimator": "MAP"}, "estimator: found 'MAP', expected one of map, online, ekf, ls"),
        ({"estimator": None}, "estimator: found None"),
        ({"estimator": "ls", "smooth": "foo"}, "smooth: found 'foo'"),
        ({"estimator": "ekf", "process_density": -1.0}, "process_density: found -1.0"),
    ],
)
def test_calibrate_refuses_what_it_does_not_know(
    rig: Rig, log: Log, options: dict[str, Any], said: str
) -> None:
    with pytest.raises(tw.InputError, match=said):
        tw.calibrate(rig, log, **options)


def test_plan_and_view_refuse_what_they_do_not_know(rig: Rig) -> None:
    for options in ({"method": "zzz"}, {"criterion": "Z"}):
        with pytest.raises(tw.InputError, match=r"expected one of"):
            tw.plan(rig, **options)  # type: ignore[arg-type]
    with pytest.raises(tw.InputError, match="axes: found 'foo', expected one of sensor, base"):
        View(axes="foo")  # type: ignore[arg-type]
    for at in ((1.0, 2.0), (float("nan"),) * 6):
        with pytest.raises(tw.InputError, match="six numbers"):
            View(at)
