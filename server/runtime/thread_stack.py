"""The stack of a thread that runs meanwhile.

Frames of another thread must not be walked in Python: between two steps that thread goes on, and CPython 3.11 has been
seen to end the process by that. `faulthandler` writes the stacks of all threads while it keeps the interpreter's lock.
"""

from __future__ import annotations

import faulthandler
import re
import tempfile
from collections.abc import Iterable, Sequence
from typing import NamedTuple

_THREAD = re.compile(r"(?:Current thread|Thread) 0x([0-9a-f]+)")
_FRAME = re.compile(r'  File "(.*)", line (\d+|\?\?\?) in (.*)')


class StackFrame(NamedTuple):
    """A call on a stack: its file, the line that runs (`???` where it is unknown) and the name of the function."""

    file: str
    line: str
    function: str

    def __str__(self) -> str:
        """As a traceback has it."""
        return f'  File "{self.file}", line {self.line}, in {self.function}'


def thread_stack(thread: int) -> Sequence[StackFrame]:
    """The stack of the thread of this identifier, the innermost call first; empty where it has ended.

    Takes about 1 ms for thirty threads. Raises OSError where there is no room for a temporary file.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as file:
        faulthandler.dump_traceback(file, all_threads=True)
        file.seek(0)
        return stack_of(thread, file)


def stack_of(thread: int, lines: Iterable[str]) -> Sequence[StackFrame]:
    """What the lines that `faulthandler` writes say of one thread."""
    found: list[StackFrame] = []
    is_there = False
    for line in lines:
        if head := _THREAD.match(line):
            is_there = int(head[1], 16) == thread
        elif is_there and (frame := _FRAME.match(line)):
            found.append(StackFrame(*frame.groups()))
    return found
