"""Processes of the tests: each is started, read from and ended by its own handle."""

from __future__ import annotations

import queue
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence


class Process:
    """A process and the lines it prints.

    It is ended by a signal, and killed if it does not end within `grace` seconds; a line is awaited for `patience`
    seconds.
    """

    def __init__(
        self,
        command: Sequence[str],
        environment: Mapping[str, str],
        *,
        politely: signal.Signals = signal.SIGTERM,
        grace: float = 5.0,
        patience: float = 20.0,
    ) -> None:
        self.process = subprocess.Popen(
            command, env=dict(environment), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, bufsize=1
        )
        self.seen: list[str] = []
        self._politely, self._grace, self._patience = politely, grace, patience
        self._lines: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def line(self, beginning: str = "", timeout: float | None = None) -> str:
        """Return the next line with this beginning; fail with the last lines printed if there is none in time."""
        until = time.monotonic() + (self._patience if timeout is None else timeout)
        while (left := until - time.monotonic()) > 0:
            try:
                line = self._lines.get(timeout=left)
            except queue.Empty:
                break
            if line is None:
                break
            if line.startswith(beginning):
                return line
        raise AssertionError(f"no line {beginning!r} from {self.process.args!r}: {self.seen[-20:]}")

    def told_to_end(self) -> None:
        """Request it to end, without waiting."""
        self.process.send_signal(self._politely)  # no effect on a finished process

    def stop(self) -> None:
        """End it by a signal, or else kill it."""
        self.told_to_end()
        try:
            self.process.wait(self._grace)
        except subprocess.TimeoutExpired:
            self.kill()

    def kill(self) -> None:
        """Kill it, as a crash would."""
        self.process.kill()
        self.process.wait(self._patience)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            text = line.rstrip("\n")
            self.seen.append(text)
            self._lines.put(text)
        self._lines.put(None)
