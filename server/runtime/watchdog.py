"""Watchdog of the event loop: measures its pauses, and finds the code that caused them.

A timer on the loop is due every few milliseconds; its delay is the length of a pause. A thread checks the same clock,
and samples the stack of the loop's thread while the timer is late.
"""

from __future__ import annotations

import asyncio
import faulthandler
import logging
import re
import tempfile
import threading
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec import Struct

import rosld

_log = logging.getLogger("rosld")

BEAT_SECONDS = 0.01
WATCH_SECONDS = 0.05
"""Interval of the thread's checks: each wakes the processor, and only a pause that it meets gets a stack."""
LATE_SECONDS = 0.02
"""Minimum length of a pause whose stack is sampled."""
LOGGED_SECONDS = 0.1
"""Minimum length of a logged pause; on a busy machine the system itself causes shorter ones."""
LONG_SECONDS = 1.0
"""Minimum length of a pause that is a warning in any case, and logged with its stack."""
LOG_INTERVAL_SECONDS = 60.0
RECENT_SECONDS = 60.0
_SLOTS = 6
_FRAMES = 12
_PACKAGE = Path(rosld.__file__).parent
_RUNNERS = ("/asyncio/runners.py", "/uvloop/__init__.py")
"""Files that run a loop: their callers are idle."""


class Pause(Struct, frozen=True):
    """A pause of the event loop: its length, and the time that the loop's thread was working, in seconds.

    `ended_ns` is the wall-clock time of its end. `code` is the innermost running function of rosld, `stack` the
    complete stack; both are None if the loop's thread was waiting.
    """

    seconds: float
    busy: float
    ended_ns: int
    code: str | None = None
    stack: str | None = None


class Pauses(Struct, frozen=True):
    """The longest pause since the start of the server, and the seconds of the longest in the last minute.

    `busiest` is the pause in which the loop's thread itself worked the longest; if others have the processor, or the
    interpreter's lock, that is less than the longest.
    """

    longest: Pause
    busiest: Pause
    recent: float


class Watchdog:
    """Meter of the pauses of the loop on which it is started."""

    def __init__(self) -> None:
        self.count, self.seconds = 0, 0.0
        """Number of pauses of at least `LATE_SECONDS`, and their total length."""
        self._longest = self._busiest = Pause(0.0, 0.0, time.time_ns())
        self._slots: deque[tuple[float, float]] = deque(maxlen=_SLOTS + 1)
        self._due = 0.0
        self._busy = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._loop_thread = 0
        self._sample: tuple[float, str | None, str | None] = (0.0, None, None)
        self._to_log: Pause | None = None
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start to measure the running loop."""
        self._loop_thread = threading.get_ident()
        self._schedule(asyncio.get_running_loop())
        self._thread = threading.Thread(target=self._watch, name="loop-watchdog", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop measuring. Idempotent."""
        self._ended.set()
        if self._timer is not None:
            self._timer.cancel()

    @property
    def pauses(self) -> Pauses:
        """Measurements so far."""
        since = time.monotonic() - RECENT_SECONDS
        return Pauses(
            self._longest, self._busiest, max((seconds for at, seconds in self._slots if at >= since), default=0.0)
        )

    # --- on the loop

    def _schedule(self, loop: asyncio.AbstractEventLoop) -> None:
        self._busy = time.thread_time()
        self._due = time.monotonic() + BEAT_SECONDS
        self._timer = loop.call_later(BEAT_SECONDS, self._beat, loop)

    def _beat(self, loop: asyncio.AbstractEventLoop) -> None:
        now, due = time.monotonic(), self._due
        self._record(now, max(0.0, now - due), due)
        self._schedule(loop)

    def _record(self, now: float, late: float, due: float) -> None:
        if late >= LATE_SECONDS:
            self.count += 1
            self.seconds += late
        slots, width = self._slots, RECENT_SECONDS / _SLOTS
        if not slots or now - slots[-1][0] >= width:
            slots.append((now, late))
        elif late > slots[-1][1]:
            slots[-1] = (slots[-1][0], late)
        busy = time.thread_time() - self._busy
        if late <= self._longest.seconds and busy <= self._busiest.busy and late < LOGGED_SECONDS:
            return
        sampled, code, stack = self._sample
        if sampled != due:
            code = stack = None
        pause = Pause(late, busy, time.time_ns(), code, stack)
        if late > self._longest.seconds:
            self._longest = pause
        if busy > self._busiest.busy:
            self._busiest = pause
        waiting = self._to_log
        if late >= LOGGED_SECONDS and (waiting is None or late > waiting.seconds):
            self._to_log = pause

    # --- in the thread

    def _watch(self) -> None:
        logged = -LOG_INTERVAL_SECONDS
        while not self._ended.wait(WATCH_SECONDS):
            due, now = self._due, time.monotonic()
            if now - due > LATE_SECONDS and self._sample[0] != due:
                self._sample = (due, *self._stack())
            pause = self._to_log
            if pause is not None and now - logged >= LOG_INTERVAL_SECONDS:
                self._to_log, logged = None, now
                _log.log(_level(pause), "%s", describe_pause(pause))

    def _stack(self) -> tuple[str | None, str | None]:
        """Return the innermost function of rosld that the loop's thread runs, and the complete stack."""
        try:
            stack = _thread_stack(self._loop_thread)
        except OSError:  # the disk is full, which is reported elsewhere
            return None, None
        code = running_code(stack)
        return code, None if code is None else "\n".join(map(str, reversed(stack[:_FRAMES])))


def _level(pause: Pause) -> int:
    """Return the log level of a pause; a short one without code of rosld is due to a busy machine."""
    return logging.WARNING if pause.code is not None or pause.seconds >= LONG_SECONDS else logging.INFO


def describe_pause(pause: Pause) -> str:
    """Return the description of a pause for the log, with the stack of a long one."""
    where = f", in {pause.code}" if pause.code else ""
    head = f"the event loop was paused for {pause.seconds:.2f} s, {pause.busy:.2f} s of them at work{where}"
    return f"{head}\n{pause.stack}" if pause.stack and pause.seconds >= LONG_SECONDS else head


def running_code(stack: Sequence[StackFrame]) -> str | None:
    """Return the innermost function of rosld on a stack as `module.function`, None if the loop was idle."""
    for frame in stack:
        if frame.file.endswith(_RUNNERS):
            return None
        file = Path(frame.file)
        if file.is_relative_to(_PACKAGE):
            return ".".join((_PACKAGE.name, *file.relative_to(_PACKAGE).with_suffix("").parts, frame.function))
    return None


_THREAD = re.compile(r"(?:Current thread|Thread) 0x([0-9a-f]+)")
_FRAME = re.compile(r'  File "(.*)", line (\d+|\?\?\?) in (.*)')


class StackFrame(NamedTuple):
    """A call on a stack: its file, the line that runs (`???` if unknown) and the name of the function."""

    file: str
    line: str
    function: str

    def __str__(self) -> str:
        """Return the frame as a line of a traceback."""
        return f'  File "{self.file}", line {self.line}, in {self.function}'


def _thread_stack(thread: int) -> Sequence[StackFrame]:
    """Return the stack of a thread by its identifier, innermost call first; empty if the thread has ended.

    `faulthandler` writes all stacks while it holds the interpreter's lock. Walking the frames in Python
    (`sys._current_frames`) lets the thread run between two steps, which has crashed CPython 3.11. Takes about 1 ms for
    thirty threads. Raises OSError if there is no room for a temporary file.
    """
    found: list[StackFrame] = []
    is_there = False
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as file:
        faulthandler.dump_traceback(file, all_threads=True)
        file.seek(0)
        for line in file:
            if head := _THREAD.match(line):
                is_there = int(head[1], 16) == thread
            elif is_there and (frame := _FRAME.match(line)):
                found.append(StackFrame(*frame.groups()))
    return found
