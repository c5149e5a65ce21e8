"""Workers that run tasks: this process, processes that are replaced when they die, or those of a Dask cluster."""

from __future__ import annotations

import gc
import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import ExitStack, suppress
from importlib import import_module
from multiprocessing import connection, util
from multiprocessing.process import BaseProcess
from typing import Any, NamedTuple

import rosld
from rosld.server.cli.failure import ExitCode, Failure
from rosld.server.cli.parts import DEATH, Answer, Task, run_task
from rosld.server.cli.recording_inputs import close_recordings

_CONNECT = 5
"""Maximum seconds for reaching a Dask scheduler."""


class InProcess(Executor):
    """Executor that runs each task at once in this thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


class _Worker(NamedTuple):
    """A process, and this end of the pipe through which it gets tasks and answers them."""

    process: BaseProcess
    pipe: connection.Connection


class Processes(Executor):
    """Executor of processes: each has a thread here that hands it a task and awaits the answer.

    The death of a process ends its own task, with DEATH, and no other. A ProcessPoolExecutor would end all tasks, and
    may wait for ever for a process that it was starting when another died.
    """

    def __init__(self, count: int) -> None:
        # A fork of this process would copy its threads' locks; a fork of the server has the modules loaded.
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["rosld.server.cli.lift", "rosld.server.cli.workers"])
        self._threads = ThreadPoolExecutor(count)
        self._idle: list[_Worker] = []
        self._all: set[_Worker] = set()
        self._lock = threading.Lock()
        self._is_killed = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        return self._threads.submit(self._run, fn, args)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes; the tasks that they have been given are finished first."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for worker in self._all:
            worker.pipe.close()
            worker.process.join()

    def kill(self) -> None:
        """Kill the processes in the midst of their tasks, and start no more."""
        with self._lock:
            self._is_killed = True
            for worker in self._all:
                worker.process.kill()

    def _run(self, *task: Any) -> Any:
        with self._lock:
            if self._is_killed:
                raise CancelledError
            worker = self._idle.pop() if self._idle else self._start()
        try:
            worker.pipe.send(task)
            answer = worker.pipe.recv()
        except (OSError, EOFError):
            worker.process.kill()
            worker.process.join()  # nobody writes to the folder of its part any more
            with self._lock:
                self._all.discard(worker)
            worker.pipe.close()
            return DEATH
        with self._lock:
            self._idle.append(worker)
        return answer

    def _start(self) -> _Worker:
        here, there = self._context.Pipe()
        process = self._context.Process(target=_work, args=(there,), daemon=True)
        process.start()
        there.close()
        worker = _Worker(process, here)
        self._all.add(worker)
        return worker


def _work(pipe: connection.Connection) -> None:
    """Run the tasks that come through a pipe until it or the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of the terminal
    gc.freeze()
    util.Finalize(None, close_recordings, exitpriority=10)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            function, arguments = pipe.recv()
            pipe.send(function(*arguments))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Pool:
    """Workers: this process, `workers` processes, or those of a Dask scheduler."""

    def __init__(self, workers: int, dask: str | None = None) -> None:
        """Connect to the Dask scheduler, if any. Raises Failure."""
        self.shares_disk = dask is None
        self._stack = ExitStack()
        self._limit = workers + 2 if workers > 1 else 1
        self._executor: Executor
        if dask is not None:
            client = self._stack.enter_context(_dask_client(dask))
            self._limit = 2 * max(1, sum(client.nthreads().values()))
            self._executor = client.get_executor(pure=False)
        else:
            self._executor = Processes(workers) if workers > 1 else InProcess()

    def answers(self, waiting: deque[Task]) -> Iterator[tuple[Task, Answer]]:
        """Run tasks, and yield each with its answer, until `waiting` is empty; more may be added meanwhile.

        The answer of a task whose worker died is DEATH. Raises Failure if workers cannot run tasks.
        """
        running: dict[Future[Answer], Task] = {}
        while waiting or running:
            while waiting and len(running) < self._limit:
                task = waiting.popleft()
                running[self._executor.submit(run_task, rosld.__version__, pickle.dumps(task))] = task
            done, _ = wait_for(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield running.pop(future), _answer(future)

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, kind: type[BaseException] | None, *args: object) -> None:
        """End the workers, in the midst of their tasks after an exception."""
        if kind is not None and isinstance(self._executor, Processes):
            self._executor.kill()
            self._executor.shutdown()
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


def _answer(future: Future[Answer]) -> Answer:
    if future.cancelled():  # by the Dask scheduler
        return DEATH
    error = future.exception()
    if error is None:
        answer = future.result()
        if answer.is_final:
            raise Failure(str(answer.error))
        return answer
    if type(error).__name__ == "KilledWorker":  # Dask has given the task to several workers, which all died
        return DEATH
    raise Failure(f"the workers cannot run tasks of rosld: {type(error).__name__}: {error}") from error
