"""`rosld` in a fork of a process that has imported it.

A server takes a fifth of the CPU until it answers. It is the same program otherwise, with a process, a main thread and
descriptors of its own; the command itself is run by the tests of the command line.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from multiprocessing.context import get_spawning_popen
from typing import Any, TextIO

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["tests.forked_imports"])


class _Descriptor:
    """A file descriptor that a fork is given."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __getstate__(self) -> object:
        popen: Any = get_spawning_popen()
        return popen.DupFd(popen.duplicate_for_child(self.number))

    def __setstate__(self, copy: Any) -> None:
        self.number = copy.detach()


def _run(arguments: tuple[str, ...], output: _Descriptor, errors: _Descriptor, environment: dict[str, str]) -> None:
    from rosld.server.cli.main import main

    for standard, given in ((1, output), (2, errors)):
        os.dup2(given.number, standard)
        os.close(given.number)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["rosld", *arguments]
    main(prog_name="rosld")


class ForkedProcess:
    """A `rosld` that runs, with what the tests use of `subprocess.Popen`."""

    def __init__(self, *arguments: str) -> None:
        self.args = ["rosld", *arguments]
        reading, writing = os.pipe()
        self.stdout: TextIO = os.fdopen(reading, encoding="utf-8")
        given = (arguments, _Descriptor(writing), _Descriptor(2), dict(os.environ))
        self._process = _CONTEXT.Process(target=_run, args=given)
        self._process.start()
        os.close(writing)

    @property
    def pid(self) -> int:
        assert self._process.pid is not None
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        """Its exit code, None while it runs; what ended by a signal has that number, negative."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code once it has ended; raise `subprocess.TimeoutExpired`."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0)
        self.stdout.close()
        return self._process.exitcode

    def send_signal(self, number: signal.Signals) -> None:
        """Send it a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it as a crash would."""
        self.send_signal(signal.SIGKILL)
