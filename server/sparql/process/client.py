"""The server's end of the query process: sends it changes and work, and starts it again where it dies."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from itertools import count
from typing import cast

from rosld.server.dataset.base import Edit
from rosld.server.dataset.encoding import NAMESPACE, VARIABLE
from rosld.server.http.problem import Problem
from rosld.server.runtime.memory import (
    DATASET_PER_CHARACTER,
    DATASET_PER_TRIPLE,
    Memory,
    NotEnoughMemory,
    available,
)
from rosld.server.sparql.disconnect import HangUp
from rosld.server.sparql.limits import Limits, busy, crashed, out_of_memory, out_of_time, restarting
from rosld.server.sparql.process.fork import HEAD as FRAME
from rosld.server.sparql.process.fork import OUT_OF_MEMORY, Ended, Piece
from rosld.server.sparql.process.frames import (
    AtWork,
    Buffer,
    Cancel,
    Change,
    Drop,
    Job,
    Kind,
    Reply,
    Tidy,
    packed,
)
from rosld.server.sparql.process.work import Work

_log = logging.getLogger("rosld.sparql")

HEAD = 1024 * 1024
"""Bytes that are gathered before the first is sent: up to these, an answer is sent whole or refused."""
_CHUNK = 256 * 1024
_RECEIVED = 256 * 1024
_AHEAD = 4 * 1024 * 1024
"""Bytes that may be on their way to the process before others should be made."""
_LARGE = 64 * 1024
"""Bytes of a job from which on memory is asked for: less is within the margin."""
_PER_BYTE = 3
"""Bytes that a job takes in the process before it is begun, for each of its own."""
_PATIENCE = 2.0
"""Seconds that a query waits for a process that is being started."""
_AT_ONCE = 1.0
"""A process that lives no longer is not started again at once."""
_LONGEST_PAUSE = 30.0
_START = "import sys; sys.path[:] = sys.argv[1:-3]; from rosld.server.sparql.process.main import main; main()"
"""What the process runs: with the same modules as the server, wherever that found them."""


class Aborted(Exception):
    """Results that had begun to be sent cannot be completed; the connection must break, or they would look whole."""


class _Pending:
    """A job under way. `first` comes to the result where it is made in the process, else to a fork's pipe."""

    __slots__ = ("ended", "first", "is_over", "on_wait", "work")

    def __init__(self, loop: asyncio.AbstractEventLoop, work: Work, on_wait: Callable[[], None]) -> None:
        self.first: asyncio.Future[bytes | int] = loop.create_future()
        self.ended: asyncio.Future[Ended] | None = None
        self.is_over = False
        self.on_wait = on_wait
        self.work = work


class QueryProcess:
    """The process. Belongs to one loop; `start` and `close` it there.

    `version` changes with each change of a dataset, `generation` with each start: a new process holds nothing, which is
    told to whoever has watched for it (`watch_start`).
    """

    def __init__(self, concurrency: int, queue: int) -> None:
        self._arguments = (str(concurrency), str(queue))
        self._versions = count(1)
        self._numbers = count(1)
        self._datasets = count(1)
        self.version = 0
        self.generation = 0
        self._jobs: dict[int, _Pending] = {}
        self._popen: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._output: deque[memoryview] = deque()
        self._descriptors: deque[int] = deque()
        self._ahead: deque[tuple[int, int]] = deque()
        """The changes that may not have been made yet: the number of each since the start, and the bytes for it."""
        self._taken: asyncio.Future[None] | None = None
        self._up = asyncio.Event()
        self._down: asyncio.Task[None] | None = None
        self._closed = False
        self._on_start: list[Callable[[], None]] = []
        self._on_change: list[Callable[[Mapping[str, str | None], Sequence[Edit]], None]] = []

    @property
    def pid(self) -> int | None:
        """The number of the process, None while there is none."""
        return None if self._popen is None else self._popen.pid

    def watch_start(self, told: Callable[[], None]) -> None:
        """Call `told` whenever the process has been started again, and holds nothing."""
        self._on_start.append(told)

    def watch(self, told: Callable[[Mapping[str, str | None], Sequence[Edit]], None]) -> None:
        """Call `told` with each change of the first dataset from now on."""
        self._on_change.append(told)

    async def start(self) -> None:
        """Start the process; it need not be waited for. Raises OSError."""
        self._loop = asyncio.get_running_loop()
        popen, connection, at_work = await self._loop.run_in_executor(None, self._spawn)
        if self._closed:
            popen.kill()
            connection.close()
            return
        self._popen, self._socket, self._at_work = popen, connection, at_work
        self._memory = Memory(lambda: available(popen.pid))
        self._changes = count(1)
        self._ahead.clear()
        self._buffer = Buffer()
        self._started = time.monotonic()
        self.generation += 1
        self.version = next(self._versions)
        for told in self._on_start:
            told()
        self._loop.add_reader(connection, self._receive)
        self._up.set()

    def _spawn(self) -> tuple[subprocess.Popen[bytes], socket.socket, AtWork]:
        ours, theirs = socket.socketpair()
        with theirs, tempfile.TemporaryFile() as file:
            try:
                file.truncate(AtWork.SIZE)
                command = [sys.executable, "-c", _START, *sys.path, str(file.fileno()), *self._arguments]
                popen = subprocess.Popen(
                    command,
                    stdin=theirs.fileno(),
                    stdout=subprocess.DEVNULL,
                    pass_fds=(file.fileno(),),
                    env={**os.environ, VARIABLE: NAMESPACE},
                    start_new_session=True,
                )
                at_work = AtWork(file.fileno())
            except BaseException:
                ours.close()
                raise
        ours.setblocking(False)
        return popen, ours, at_work

    async def close(self) -> None:
        """End the process, with all that it does. Idempotent."""
        self._closed = True
        if self._down is not None:
            self._down.cancel()
        self._disconnect()
        popen, self._popen = self._popen, None
        if popen is not None:
            popen.kill()
            await self._loop.run_in_executor(None, popen.wait)
        self._fail_all(restarting(1))

    async def ready(self, until: float) -> None:
        """Wait a moment for the process to be there. Raises Problem 503 where it is not."""
        if self._up.is_set():
            return
        try:
            await asyncio.wait_for(self._up.wait(), max(0.0, min(_PATIENCE, until - time.monotonic())))
        except asyncio.TimeoutError as error:
            raise restarting(1) from error

    # --- what it is told

    def change(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = (), dataset: int = 0) -> None:
        """Replace graphs, then do edits, as `Store.replace`: all that is asked afterwards sees it.

        A graph that cannot be stored is left out, and told of in the log. Raises Problem 503 where there is no process,
        and NotEnoughMemory where the process has none for what is added.
        """
        if not graphs and not edits:
            return
        added = [*filter(None, graphs.values()), *(edit.added for edit in edits if edit.added)]
        characters = sum(map(len, added))
        needed = characters * DATASET_PER_CHARACTER + sum(text.count("\n") for text in added) * DATASET_PER_TRIPLE
        if needed:
            self._require(needed, f"the dataset, for changes of {characters} characters,")
        self._send(packed(Change(dataset, dict(graphs), [*edits])))
        self._ahead.append((next(self._changes), needed))
        if dataset == 0:
            self.version = next(self._versions)
            for told in self._on_change:
                told(graphs, edits)

    def new_dataset(self) -> int:
        """The number of another dataset, with nothing in it."""
        return next(self._datasets)

    def drop(self, dataset: int) -> None:
        """Let go of another dataset."""
        with contextlib.suppress(Problem):
            self._send(packed(Drop(dataset)))

    async def answer(
        self,
        work: Work,
        limits: Limits,
        until: float,
        hung_up: HangUp | None = None,
        dataset: int = 0,
    ) -> bytes | AsyncIterator[bytes]:
        """What the work writes: all bytes where they are few, else an iterator, which raises Aborted where it breaks.

        `until` is when the time is over (monotonic), `limits.seconds` is what this comes from. Whoever hangs up has the
        work ended. Raises what the work raises, and Problems: 503 where a limit is reached, too much is being done or
        the process must be started again, 500 where the work ended the process that did it.
        """
        return await _Evaluation(self, work, limits, until, hung_up).run(dataset)

    async def result(self, work: Work, limits: Limits, until: float, hung_up: HangUp | None = None) -> bytes:
        """All that the work writes. Raises as `answer` does."""
        found = await self.answer(work, limits, until, hung_up)
        if isinstance(found, bytes):
            return found
        try:
            return b"".join([chunk async for chunk in found])
        except Aborted as error:
            raise error.__cause__ or Problem(503, str(error)) from None

    def result_for_thread(self, work: Work, seconds: float) -> bytes:
        """The same for another thread. Raises TimeoutError."""
        coming = asyncio.run_coroutine_threadsafe(
            self.result(work, Limits(seconds), time.monotonic() + seconds), self._loop
        )
        return coming.result(seconds + 1)

    def begin(self, work: Work, limits: Limits, dataset: int, on_wait: Callable[[], None]) -> tuple[int, _Pending]:
        """Have work begun. For `_Evaluation`."""
        number, pending = next(self._numbers), _Pending(self._loop, work, on_wait)
        data = packed(Job(number, dataset, work, limits.seconds, limits.memory))
        if len(data) > _LARGE:
            self._require(len(data) * _PER_BYTE, f"a request of {len(data)} bytes")
        self._send(data)
        self._jobs[number] = pending
        return number, pending

    def cancel(self, number: int) -> None:
        """End a job that is not wanted any more. For `_Evaluation`."""
        pending = self._jobs.get(number)
        if pending is not None and not pending.is_over:
            pending.is_over = True
            with contextlib.suppress(Problem):
                self._send(packed(Cancel(number)))

    def forget(self, number: int) -> None:
        """Nothing more is expected of a job. For `_Evaluation`."""
        self._jobs.pop(number, None)

    def _require(self, needed: int, what: str) -> None:
        """Raise NotEnoughMemory where the process has none for this and the changes that it is still to make."""
        if self._socket is None:
            raise restarting(1)
        made = self._at_work.changes
        while self._ahead and self._ahead[0][0] <= made:
            self._ahead.popleft()
        try:
            self._memory.require(needed + sum(each for _, each in self._ahead), what)
        except NotEnoughMemory:
            self._send(packed(Tidy()))
            raise

    # --- the connection

    def _send(self, data: bytes) -> None:
        if self._socket is None:
            raise restarting(1)
        view = memoryview(data)
        if not self._output:
            view = view[self._write(view) :]
            if view:
                self._loop.add_writer(self._socket, self._flush)
        if view:
            self._output.append(view)

    def _write(self, view: memoryview) -> int:
        assert self._socket is not None
        try:
            return self._socket.send(view)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:  # it is dead, which is noticed by reading
            return len(view)

    def _flush(self) -> None:
        if self._output:
            view = self._output.popleft()
            view = view[self._write(view) :]
            if view:
                self._output.appendleft(view)
        if not self._output and self._socket is not None:
            self._loop.remove_writer(self._socket)
        self._tell_taken()

    async def drained(self) -> None:
        """Return when the process has taken most of what it was sent, or is gone."""
        while sum(map(len, self._output)) > _AHEAD:
            self._taken = self._taken or self._loop.create_future()
            await asyncio.shield(self._taken)

    def _tell_taken(self) -> None:
        taken, self._taken = self._taken, None
        if taken is not None and not taken.done():
            taken.set_result(None)

    def _receive(self) -> None:
        assert self._socket is not None
        try:
            data, descriptors, _, _ = socket.recv_fds(self._socket, _RECEIVED, 64, socket.MSG_CMSG_CLOEXEC)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data, descriptors = b"", []
        self._descriptors.extend(descriptors)
        if not data:
            self._lost()
            return
        for message in self._buffer.feed(data):
            self._take(cast("Reply", message))

    def _take(self, reply: Reply) -> None:
        kind, number, value = reply
        if kind is Kind.REFUSED:
            graph, why = cast("tuple[str, str]", value)
            _log.error("%s is left out of the dataset: %s", graph, why)
            return
        descriptor = self._descriptors.popleft() if kind is Kind.FORKED else -1
        pending = self._jobs.get(number)
        if pending is None or (pending.first.done() and kind is not Kind.ENDED):
            if descriptor >= 0:
                os.close(descriptor)
            return
        pending.is_over |= kind in (Kind.DONE, Kind.RAISED, Kind.ENDED)
        match kind:
            case Kind.DONE:
                pending.first.set_result(cast("bytes", value))
            case Kind.RAISED:
                pending.first.set_exception(pickle.loads(cast("bytes", value)))  # from our own process
            case Kind.FORKED:
                pending.ended = self._loop.create_future()
                pending.ended.add_done_callback(_looked_at)
                pending.first.set_result(descriptor)
            case Kind.WAITING:
                pending.on_wait()
            case Kind.ENDED:
                if pending.ended is not None and not pending.ended.done():
                    pending.ended.set_result(cast("Ended", value))

    # --- its death

    def _disconnect(self) -> None:
        connection, self._socket = self._socket, None
        self._up.clear()
        if connection is None:
            return
        self._loop.remove_reader(connection)
        self._loop.remove_writer(connection)
        connection.close()
        self._output.clear()
        self._tell_taken()
        while self._descriptors:
            os.close(self._descriptors.popleft())

    def _lost(self) -> None:
        self._disconnect()
        if not self._closed:
            self._down = self._loop.create_task(self._start_again())

    async def _start_again(self) -> None:
        """Tell of the death to whom it concerns, and start the process again."""
        assert self._popen is not None
        status = await self._loop.run_in_executor(None, self._popen.wait)
        self._blame(status)
        pause = 0.0 if time.monotonic() - self._started > _AT_ONCE else 0.1
        while not self._closed:
            await asyncio.sleep(pause)
            try:
                await self.start()
            except (OSError, MemoryError, RuntimeError) as error:  # no memory, no process, no thread
                _log.error("the query process cannot be started again now: %s", error)
                pause = min(_LONGEST_PAUSE, max(0.5, 2 * pause))
            else:
                return

    def _blame(self, status: int) -> None:
        """Fail all jobs: what it was at where that ended it, all others with a 503."""
        guilty = None if status == -signal.SIGKILL else self._jobs.get(self._at_work.number)
        what = "" if guilty is None else f" by {_shown(guilty.work)}"
        how = f"signal {-status}" if status < 0 else f"exit {status}"
        _log.error("the query process was ended%s (%s); it is started again", what, how)
        if guilty is not None and not guilty.first.done():
            guilty.first.set_exception(_why_crashed(status))
        self._fail_all(restarting(1))

    def _fail_all(self, problem: Problem) -> None:
        for pending in self._jobs.values():
            if not pending.first.done():
                pending.first.set_exception(problem)
            elif pending.ended is not None and not pending.ended.done():
                pending.ended.set_exception(problem)
        self._jobs.clear()


def _looked_at(future: asyncio.Future[Ended]) -> None:
    """Nobody may ask for it."""
    if not future.cancelled():
        future.exception()


def _shown(work: Work) -> str:
    text = repr(work)
    return text if len(text) <= 2000 else text[:2000] + "..."


def _why_crashed(status: int) -> Problem:
    return crashed(f"signal {-status}" if status < 0 else f"exit {status}")


def _why_ended(ended: Ended, limits: Limits) -> Problem:
    """Why a fork ended that did not say so."""
    status, words = ended
    if "memory allocation of" in words or (os.WIFEXITED(status) and os.WEXITSTATUS(status) == OUT_OF_MEMORY):
        return out_of_memory(limits.memory)
    if not os.WIFSIGNALED(status):
        return crashed(f"exit {os.WEXITSTATUS(status)}")
    number = os.WTERMSIG(status)
    return out_of_time(limits.seconds) if number == signal.SIGALRM else crashed(f"signal {number}")


class _Evaluation:
    """One piece of work: sent, waited for within its time, and its bytes passed on as they come."""

    def __init__(self, process: QueryProcess, work: Work, limits: Limits, until: float, hung_up: HangUp | None) -> None:
        self._process = process
        self._work = work
        self._limits = limits
        self._until = until
        self._hung_up = hung_up
        self._watch: asyncio.Future[None] | None = None
        self._number = 0
        self._transport: asyncio.ReadTransport | None = None

    async def run(self, dataset: int) -> bytes | AsyncIterator[bytes]:
        """The result. Raises as `QueryProcess.answer` does."""
        loop = asyncio.get_running_loop()
        seconds = max(0.0, self._until - time.monotonic())
        limits = self._limits._replace(seconds=seconds)
        self._number, self._pending = self._process.begin(self._work, limits, dataset, self._watch_client)
        timer = loop.call_later(seconds, self._give_up)
        body: bytes | AsyncIterator[bytes] | None = None
        try:
            first = await self._pending.first
            body = first if isinstance(first, bytes) else await self._from_fork(first)
            return body
        finally:
            timer.cancel()
            if body is None or isinstance(body, bytes):
                self._end()

    def _give_up(self) -> None:
        """The time is over."""
        first = self._pending.first
        if not first.done():
            is_waiting = self._watch is not None
            first.set_exception(busy() if is_waiting else out_of_time(self._limits.seconds))
            self._process.cancel(self._number)

    def _watch_client(self) -> None:
        """It takes a while: see whether the client hangs up."""
        if self._hung_up is not None and self._watch is None:
            self._watch = asyncio.ensure_future(self._hung_up())
            self._watch.add_done_callback(self._left)

    def _left(self, watch: asyncio.Future[None]) -> None:
        """The client has hung up, unless the watch was ended."""
        if watch.cancelled() or watch.exception() is not None:
            return
        self._process.cancel(self._number)
        if not self._pending.first.done():
            self._pending.first.set_exception(_gone())
        elif self._transport is not None:
            self._reader.set_exception(_gone())

    def _end(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
        if self._transport is not None:
            self._transport.close()
        self._process.cancel(self._number)
        self._process.forget(self._number)

    # --- a fork's result

    async def _from_fork(self, descriptor: int) -> bytes | AsyncIterator[bytes]:
        self._watch_client()
        self._reader = asyncio.StreamReader(_CHUNK)
        protocol = asyncio.StreamReaderProtocol(self._reader)
        pipe = os.fdopen(descriptor, "rb", 0)
        self._transport, _ = await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, pipe)
        head: list[bytes] = []
        size = 0
        while size < HEAD:
            data = await self._next()
            if data is None:
                return b"".join(head)
            head.append(data)
            size += len(data)
        return self._stream(b"".join(head))

    async def _stream(self, head: bytes) -> AsyncIterator[bytes]:
        try:
            yield head
            while (data := await self._next_or_abort()) is not None:
                yield data
        finally:
            self._end()

    async def _next_or_abort(self) -> bytes | None:
        try:
            return await self._next()
        except Problem as problem:
            raise Aborted(problem.detail) from problem
        except Exception as error:
            raise Aborted(str(error)) from error

    async def _next(self) -> bytes | None:
        """The next bytes; None at the end. Raises what the work raised, and why it ended early."""
        try:
            return await asyncio.wait_for(self._piece(), max(0.0, self._until - time.monotonic()))
        except asyncio.TimeoutError as error:
            raise out_of_time(self._limits.seconds) from error

    async def _piece(self) -> bytes | None:
        try:
            kind, size = FRAME.unpack(await self._reader.readexactly(FRAME.size))
            data = await self._reader.readexactly(size)
        except asyncio.IncompleteReadError:
            assert self._pending.ended is not None
            raise _why_ended(await self._pending.ended, self._limits) from None
        if kind == Piece.DATA.value:
            return data
        if kind == Piece.RAISED.value:
            error: Exception = pickle.loads(data)  # from our own process
            raise error
        return None


def _gone() -> Problem:
    return Problem(503, "The client has hung up.")
