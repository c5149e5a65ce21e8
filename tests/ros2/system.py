"""A real ROS 2 system for tests: nodes in their own processes and in their own domain."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.processes import Process
from tests.ros2.distros import environment, free_domain, require

NODES = Path(__file__).parent / "nodes"
PROFILES = str(Path(__file__).parent / "quick.xml")
PATIENCE = 60.0
GRACE = 3.0


def quick_environment(domain: int, **more: str) -> dict[str, str]:
    """Return the environment of a process whose participants are discovered, and missed, within seconds."""
    profiles = {"FASTRTPS_DEFAULT_PROFILES_FILE": PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE": PROFILES}
    return environment(domain, **profiles, **more)


class System:
    """A domain, and the nodes started in it by a Python that has rclpy."""

    def __init__(self, python: str, domain: int) -> None:
        self.python = python
        self.environment = quick_environment(domain)
        self.source = f"ros2:?domain={domain}"
        self.domain = domain
        self._running: list[Process] = []

    def node(self, script: str, *arguments: str, folder: Path = NODES) -> Process:
        """Start one of the nodes next to this file, or in another folder, and wait until it is ready."""
        command = [self.python, str(folder / script), *arguments]
        running = Process(command, self.environment, politely=signal.SIGINT, grace=GRACE, patience=PATIENCE)
        self._running.append(running)
        running.line("ready")
        return running

    def close(self) -> None:
        """End every process started here."""
        for running in self._running:
            running.told_to_end()
        for running in self._running:
            running.stop()


@contextmanager
def running(name: str | None = None) -> Iterator[System]:
    """Run a ROS 2 on loopback: that of a distro, or of the Python that runs this.

    Skips the test, with the reason, if a distro is unavailable.
    """
    python = sys.executable if name is None else require(name).python
    with free_domain() as domain:
        found = System(python, domain)
        try:
            yield found
        finally:
            found.close()
