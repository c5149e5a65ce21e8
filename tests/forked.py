"""`rosld` and its query process in forks of a process that has imported them.

A server needs a fifth of the CPU until it answers, a query process a tenth. Otherwise they are the same programs, each
with its own process, main thread and descriptors. Tests of the command line run the command itself, and every other
separate process starts its query process in the usual way.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from multiprocessing.context import get_spawning_popen
from typing import Any, TextIO, cast

from rosld.server.dataset.encoding import NAMESPACE, VARIABLE
from rosld.server.sparql.process.connection import SpawnedProcess
from rosld.server.sparql.process.frames import SharedStatus

os.environ[VARIABLE] = NAMESPACE  # the private namespace of the server is that of its query process
_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["tests.forked_imports"])


class _Descriptor:
    """A file descriptor passed to a fork."""

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


def _run_query_process(connection: _Descriptor, status: _Descriptor, test: str) -> None:
    from rosld.server.sparql.process.keeper import main

    os.setsid()
    os.dup2(connection.number, 0)
    os.close(connection.number)
    os.environ["PYTEST_CURRENT_TEST"] = test
    sys.argv = ["-c", str(status.number)]
    main()


class ForkedProcess:
    """A running process, with the used part of the interface of `subprocess.Popen`."""

    def __init__(self, process: multiprocessing.process.BaseProcess, *args: str) -> None:
        self.args = args
        self._process = process
        process.start()

    @property
    def pid(self) -> int:
        assert self._process.pid is not None
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        """Return its exit code, None while it runs, or the negative number of a signal."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Return its exit code once it has ended; raise `subprocess.TimeoutExpired`."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0)
        return self._process.exitcode

    def send_signal(self, number: signal.Signals) -> None:
        """Send it a signal, unless it has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it has just ended, which has not been reported yet
                os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill it, as a crash would."""
        self.send_signal(signal.SIGKILL)


class ForkedCommand(ForkedProcess):
    """`rosld` with these arguments; its output is in `stdout`, its log goes to the descriptor `errors`."""

    def __init__(self, *arguments: str, errors: int = 2) -> None:
        sys.audit("subprocess.Popen", "rosld", arguments, None, None)
        reading, writing = os.pipe()
        self.stdout: TextIO = os.fdopen(reading, encoding="utf-8")
        given = (arguments, _Descriptor(writing), _Descriptor(errors), dict(os.environ))
        super().__init__(_CONTEXT.Process(target=_run, args=given), "rosld", *arguments)
        os.close(writing)

    def wait(self, timeout: float | None = None) -> int:
        code = super().wait(timeout)
        self.stdout.close()
        return code


def fork_query_process() -> SpawnedProcess:
    """Replacement of `rosld.server.sparql.process.connection.spawn`."""
    ours, theirs = socket.socketpair()
    with theirs, tempfile.TemporaryFile() as file:
        file.truncate(SharedStatus.SIZE)
        test = os.environ.get("PYTEST_CURRENT_TEST", "")
        given = (_Descriptor(theirs.fileno()), _Descriptor(file.fileno()), test)
        process = ForkedProcess(_CONTEXT.Process(target=_run_query_process, args=given, daemon=True))
        status = SharedStatus(file.fileno())
    ours.setblocking(False)
    return cast("subprocess.Popen[bytes]", process), ours, status
