"""Work spread over processes that may die: only the item that a dead process held is lost, by name."""

import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Lost:
    """What is left of an item whose process died every time."""

    reason: str


@dataclass(slots=True)
class _Worker:
    process: SpawnProcess
    connection: Connection
    index: int | None = None  # of the item that it holds


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], processes: int, *, attempts: int = 2
) -> Iterator[tuple[Item, Result | Lost]]:
    """Yield every item with its result, in the order in which they are done.

    The processes are started anew (spawned) with one thread each for linear algebra, so a result does not
    depend on what this process has done before, nor on how many share the work. A script that calls this
    needs the usual `if __name__ == "__main__":`. The function is importable by its name (or a
    `functools.partial` of such); items and results can be pickled. An item is given up after some attempts:
    another program may have caused the first death. RuntimeError: processes die before they take any work.
    """
    waiting, deaths = deque(range(len(items))), Counter[int | None]()  # None: while starting
    workers = [_start(function) for _ in range(min(processes, len(items)))]
    try:
        while workers:
            reporting = wait([worker.connection for worker in workers])
            for worker in [w for w in workers if w.connection in reporting]:
                index, worker.index = worker.index, None
                result: Result | Lost
                try:
                    result = worker.connection.recv()
                except (EOFError, OSError):
                    workers.remove(worker)
                    reason = _death(worker)
                    deaths[index] += 1
                    given_up = deaths[index] >= attempts
                    if index is None and given_up:
                        raise RuntimeError(f"a process {reason} before it could take any work") from None
                    if index is not None and not given_up:
                        waiting.appendleft(index)
                    if waiting:
                        workers.append(_start(function))
                    if not given_up:
                        continue
                    result = Lost(f"its process {reason}" + f", {attempts} times" * (attempts > 1))
                else:
                    if waiting:
                        worker.index = waiting.popleft()
                        with suppress(OSError):  # it died while idle: the next wait says so
                            worker.connection.send(items[worker.index])
                    else:
                        workers.remove(worker)
                        worker.connection.close()  # nothing more to do
                if index is not None:  # else it said that it is ready
                    yield items[index], result
    finally:
        for worker in workers:
            worker.process.terminate()


def _start(function: Callable[[Item], Result]) -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(function, theirs), daemon=True)
    with _single_threaded():
        process.start()
    theirs.close()
    return _Worker(process, ours)


def _death(worker: _Worker) -> str:
    worker.process.join()
    code = worker.process.exitcode or 0
    names = {known.value: known.name for known in signal.Signals}  # but not those of every real-time signal
    return f"was killed by {names.get(-code, -code)}" if code < 0 else f"ended with status {code}"


def _serve(function: Callable[[Item], Result], connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that started us
    connection.send(None)  # ready
    while True:
        try:
            item = connection.recv()
        except EOFError:
            return
        connection.send(function(item))


@contextmanager
def _single_threaded() -> Iterator[None]:
    """The environment of processes whose linear algebra uses one thread."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
