"""A real ROS 2 system of a distro for tests: nodes in processes of their own, in a domain of their own."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.processes import Process
from tests.ros2.distros import Distro, environment, free_domain, require

NODES = Path(__file__).parent / "nodes"
PATIENCE = 20.0
GRACE = 3.0


class System:
    """A domain of a distro, and the nodes started in it."""

    def __init__(self, distro: Distro, domain: int) -> None:
        self.python = distro.python
        self.domain = domain
        self.environment = environment(domain)
        self._running: list[Process] = []

    @property
    def source(self) -> str:
        """What `rosld serve` is given."""
        return f"ros2:?domain={self.domain}"

    def node(self, script: str, *arguments: str, folder: Path = NODES) -> Process:
        """Start one of the nodes beside this file, or in another folder, and wait until it is ready."""
        command = [self.python, str(folder / script), *arguments]
        running = Process(command, self.environment, politely=signal.SIGINT, grace=GRACE, patience=PATIENCE)
        self._running.append(running)
        running.line("ready")
        return running

    def close(self) -> None:
        """End every process started here."""
        for running in reversed(self._running):
            running.stop()


@contextmanager
def running(name: str) -> Iterator[System]:
    """A ROS 2 of a distro, on loopback, in a domain of its own; skips, saying why, where it cannot be had."""
    distro = require(name)
    with free_domain() as domain:
        found = System(distro, domain)
        try:
            yield found
        finally:
            found.close()
