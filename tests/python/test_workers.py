"""Processes that die lose no work but their own."""

from __future__ import annotations

import os

import pytest

from truewrench.campaign.workers import Lost, in_processes


def test_every_item_comes_back_once_with_its_result() -> None:
    items = [f"{k} ** 2" for k in range(7)]
    assert dict(in_processes(eval, items, 2)) == {f"{k} ** 2": k**2 for k in range(7)}


def test_death_of_a_process_costs_only_the_item_it_held() -> None:
    killed = "__import__('os').kill(__import__('os').getpid(), 9)"
    items = ["1 + 1", killed, "2 + 2", "undefined", "3 + 3"]
    found = dict(in_processes(eval, items, 2))
    assert {item: found[item] for item in items[::2]} == {"1 + 1": 2, "2 + 2": 4, "3 + 3": 6}
    assert found[killed] == Lost("its process was killed by SIGKILL, 2 times")
    assert found["undefined"] == Lost("its process ended with status 1, 2 times")
    assert dict(in_processes(eval, [killed], 1, attempts=1)) == {
        killed: Lost("its process was killed by SIGKILL")
    }


def test_linear_algebra_has_one_thread_in_a_process_and_our_environment_stays() -> None:
    before = dict(os.environ)
    (found,) = in_processes(os.getenv, ["OPENBLAS_NUM_THREADS"], 1)
    assert found == ("OPENBLAS_NUM_THREADS", "1")
    assert dict(os.environ) == before


def test_process_that_cannot_start_is_a_fault_and_not_a_lost_item() -> None:
    with pytest.raises(RuntimeError, match="before it could take any work"):
        list(in_processes(_NotThere(), ["1"], 1))


class _NotThere:
    """Cannot be unpickled where it is sent."""

    def __reduce__(self) -> tuple[object, ...]:
        return eval, ("undefined",)

    def __call__(self, item: str) -> str:
        return item
