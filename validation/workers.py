"""Work for several processes of this machine, or of a Dask cluster, through joblib."""

from __future__ import annotations

import functools
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from threadpoolctl import ThreadpoolController

from crane_exudyn.effects import registry
from crane_exudyn.errors import CraneError, counted

Task = tuple[Any, ...]


class WorkerEnded(CraneError):
    """A worker process was ended from outside."""


_LOOK = 0.5  # s
#: s in which a scheduler has to answer
ANSWER = 10.0
#: schedulers that work is sent to at this moment, the last one before the others
_schedulers: list[str] = []


def results_of(
    tasks: Sequence[Task],
    jobs: int,
    order: Literal["generator", "generator_unordered"] = "generator",
) -> Iterator[Any]:
    """Yield the results of tasks (function, *arguments), which know the user's own effects.

    Worker processes leave Ctrl-C to the process that started them, and end with it, however it ends.

    Args:
        tasks: functions of modules, with arguments that can be pickled.
        jobs: processes; one task after the other in this process for 1. Within `scheduled` it is left to the scheduler.
        order: whether results come in the order of the tasks, or as they are done.

    Raises:
        WorkerEnded: a worker process was ended from outside.
        CraneError: a number of processes that is none.
    """
    jobs = counted(jobs, "jobs")
    if jobs == 1 and not _schedulers:
        yield from (function(*arguments) for function, *arguments in tasks)
        return
    from joblib import Parallel, delayed

    parent = None if _schedulers else os.getpid()
    files = registry.user_files()
    calls = [delayed(_in_worker)(parent, files, _packed(task)) for task in tasks]
    try:
        with _deaf_to_interrupts():
            results = Parallel(n_jobs=-1 if _schedulers else jobs, return_as=order, max_nbytes=None)(calls)
        yield from results
    except BrokenProcessPool as problem:
        raise WorkerEnded(
            f"A worker process was ended from outside, as the system does when memory runs out ({jobs} processes). "
            "Run it again with a smaller --jobs."
        ) from problem


@contextmanager
def own_processes(tasks: Sequence[Task]) -> Iterator[Callable[[], bool]]:
    """Run each task (function, *arguments) in a process of its own while the body runs; yield what says whether some
    still do.

    What a task returns is lost, and so is what one leaves undone that was ended from outside. At the end all are waited
    for; where the body fails they are ended.
    """
    context = multiprocessing.get_context("spawn")
    given = os.getpid(), registry.user_files()
    running = [context.Process(target=_in_worker, args=(*given, _packed(task)), daemon=True) for task in tasks]
    with _deaf_to_interrupts():
        for process in running:
            process.start()
    try:
        yield lambda: any(process.is_alive() for process in running)
    except BaseException:
        for process in running:
            process.terminate()
        raise
    finally:
        for process in running:
            process.join()


def in_parallel(jobs: int, tasks: Sequence[Task]) -> list[Any]:
    """Return the results of tasks in their order; this process does what no other would do sooner."""
    if len(tasks) < 2:
        return [function(*arguments) for function, *arguments in tasks]
    return list(results_of(tasks, min(jobs, len(tasks))))


@contextmanager
def single_threaded() -> Iterator[None]:
    """Let linear algebra work without threads of its own inside: with small matrices these only wait for each other,
    forty times as long as the work takes on a busy machine. Decorates what fits and screens begin with.
    """
    with _linear_algebra().limit(limits=1):
        yield


@functools.cache
def _linear_algebra() -> ThreadpoolController:
    return ThreadpoolController()  # looks through all that is loaded, which takes as long as a small fit's step


@contextmanager
def scheduled(address: str | None) -> Iterator[None]:
    """Send the work that begins inside to a Dask scheduler ("local": one made here); nothing differs for None.

    Raises:
        CraneError: Dask is not installed, or nothing answers at the address.
    """
    if address is None:
        yield
        return
    try:
        from dask.distributed import Client
    except ImportError:
        raise CraneError(
            "A Dask scheduler is asked for, but Dask is not installed. Install it: pip install 'dask[distributed]', "
            "which is all that the extra `cluster` adds."
        ) from None
    from joblib import parallel_config

    try:
        own = {"threads_per_worker": 1, "dashboard_address": None} if address == "local" else {"address": address}
        client = Client(timeout=ANSWER, **own)
    except (OSError, ValueError) as problem:
        raise CraneError(f"No Dask scheduler answers at {address!r}: {problem}. Is it running?") from problem
    with client, parallel_config(backend="dask"):
        _schedulers.append(address)
        try:
            yield
        finally:
            _schedulers.pop()


def _packed(task: Task) -> bytes:
    """Return a task as bytes: unpacking it imports what is compiled with all effects, and must wait until these are
    known.

    The highest protocol keeps arrays read-only that are; compiled code exists for them as they are. What a script
    defines itself (`__main__`) goes along as it is: a worker cannot import it.
    """
    import cloudpickle

    packed: bytes = cloudpickle.dumps(task, pickle.HIGHEST_PROTOCOL)
    return packed


def _in_worker(parent: int | None, files: Sequence[Path], packed: bytes) -> Any:
    if parent not in (None, os.getpid()):
        _end_with(parent)
    for file in files:
        registry.load_effects(file)
    function, *arguments = pickle.loads(packed)
    return function(*arguments)


@functools.cache
def _end_with(parent: int) -> None:
    """Let this process end as soon as `parent` is no longer the one that it belongs to."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C for the moment in which processes are started: they inherit that, down to their first import."""
    if threading.current_thread() is not threading.main_thread():  # only there signals can be set
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
