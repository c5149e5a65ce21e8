"""Workers that run tasks: this process, processes that are replaced when they die, or those of a Dask cluster."""

from __future__ import annotations

import gc
import multiprocessing
import os
import pickle
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import ExitStack, suppress
from importlib import import_module
from multiprocessing import connection, util
from typing import Any

import rosld
from rosld.server.cli.failure import ExitCode, Failure
from rosld.server.cli.parts import DEATH, Answer, Part, Task, run_task
from rosld.server.cli.recording_inputs import close_recordings

_SILENCE = 1.0
"""Seconds without a result after which the pool looks for dead processes."""
_CONNECT = 5
"""Maximum seconds for reaching a Dask scheduler."""


class InProcess(Executor):
    """Executor that runs each task at once in this thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def _begin_worker() -> None:
    """Prepare a worker process, which ends when its parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of the terminal
    gc.freeze()
    util.Finalize(None, close_recordings, exitpriority=10)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Pool:
    """Workers: this process, `workers` processes, or those of a Dask scheduler. Dead processes are replaced."""

    def __init__(self, workers: int, dask: str | None = None) -> None:
        """Connect to the Dask scheduler, if any. Raises Failure."""
        self.shares_disk = dask is None
        self._stack = ExitStack()
        self._limit = workers + 2 if workers > 1 else 1
        self._make: Callable[[], Executor] = InProcess
        if dask is not None:
            client = self._stack.enter_context(_dask_client(dask))
            self._limit = 2 * max(1, sum(client.nthreads().values()))
            self._make = lambda: client.get_executor(pure=False)
        elif workers > 1:
            # A fork of this process would copy its threads' locks; a fork of the server has the modules loaded.
            context = multiprocessing.get_context("forkserver")
            context.set_forkserver_preload(["rosld.server.cli.lift", "rosld.server.cli.workers"])
            self._make = lambda: ProcessPoolExecutor(workers, context, _begin_worker)
        self._executor = self._make()

    def answers(self, waiting: deque[Task]) -> Iterator[tuple[Task, Answer]]:
        """Run tasks, and yield each with its answer, until `waiting` is empty; more may be added meanwhile.

        All tasks of a pool fail when one worker dies. They run again, after a second time one by one, to find the task
        that kills workers. Raises Failure if workers cannot run tasks.
        """
        running: dict[Future[Answer], Task] = {}
        suspects: deque[Task] = deque()
        deaths: Counter[Part] = Counter()
        while waiting or suspects or running:
            queue, limit = (suspects, 1) if suspects else (waiting, self._limit)
            while queue and len(running) < limit:
                try:
                    running[self._submit(queue[0])] = queue[0]
                except BrokenExecutor:
                    if running:
                        break
                    self._renew()
                else:
                    queue.popleft()
            done, _ = wait_for(running, _SILENCE, return_when=FIRST_COMPLETED)
            if not done and isinstance(self._executor, ProcessPoolExecutor):
                with suppress(BrokenExecutor):
                    # This wakes its manager, which may not yet watch a process that died as soon as it was started.
                    self._executor.submit(bool)
                continue
            if any(each.done() and _is_broken(each) for each in running):
                wait_for(running)
            dead: list[Task] = []
            for future in [each for each in running if each.done()]:
                task = running.pop(future)
                if _is_broken(future):
                    dead.append(task)
                else:
                    yield task, _answer(future)
            if not dead:
                continue
            self._renew()
            deaths.update(task.part for task in dead)
            for task in reversed(dead):
                if len(dead) == 1:
                    yield task, DEATH
                else:
                    (waiting if deaths[task.part] < 2 else suspects).appendleft(task)

    def _submit(self, task: Task) -> Future[Answer]:
        return self._executor.submit(run_task, rosld.__version__, pickle.dumps(task))

    def _renew(self) -> None:
        self._executor.shutdown(wait=True)  # a worker of a broken pool may still be writing
        self._executor = self._make()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, kind: type[BaseException] | None, *args: object) -> None:
        """End the workers, in the midst of their tasks after an exception."""
        if kind is not None and isinstance(self._executor, ProcessPoolExecutor):
            for process in list((self._executor._processes or {}).values()):
                process.kill()
        if isinstance(self._executor, ProcessPoolExecutor | InProcess):
            self._executor.shutdown(cancel_futures=True)
        else:
            self._executor.shutdown(wait=kind is None)
        self._stack.close()
        close_recordings()


def _dask_client(address: str) -> Any:
    try:
        distributed = import_module("distributed")
    except ImportError as error:
        raise Failure("--dask needs Dask: pip install 'rosld[dask]'") from error
    try:
        return distributed.Client(address, timeout=_CONNECT, set_as_default=False)
    except Exception as error:  # of the network, of the address, of its protocol
        raise Failure(f"--dask {address}: {error}", ExitCode.UNREACHABLE) from error


def _is_broken(future: Future[Answer]) -> bool:
    return future.cancelled() or isinstance(future.exception(), BrokenExecutor | CancelledError)


def _answer(future: Future[Answer]) -> Answer:
    error = future.exception()
    if error is None:
        answer = future.result()
        if answer.is_final:
            raise Failure(str(answer.error))
        return answer
    if type(error).__name__ == "KilledWorker":  # Dask has given the task to several workers, which all died
        return DEATH
    raise Failure(f"the workers cannot run tasks of rosld: {type(error).__name__}: {error}") from error
