"""A real ROS 1 system for tests: Debian's rosmaster on a free port, and nodes on the system's own Python.

A test process has one rosmaster, which is cleared between tests; a new one is started if a test has killed it or needs
a second one at the same time. Every process started here is ended by its own handle.
"""

from __future__ import annotations

import atexit
import json
import os
import socket
import subprocess
import time
import xmlrpc.client
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.processes import Process

ROSMASTER = Path("/usr/bin/rosmaster")
PYTHON = "/usr/bin/python3"
NODES = Path(__file__).parent / "nodes"
PACKAGES = Path(__file__).parents[2] / "debian-ros.txt"
PATIENCE = 20.0


def require_ros() -> None:
    """Skip the test, with a hint how to install ROS, if it is missing; fail instead under CI."""
    if not ROSMASTER.exists():
        _missing("no ROS 1 here")


def require(what: str, *modules: str) -> None:
    """Skip the test, with a hint how to install them, if the system's Python lacks modules; fail under CI."""
    if subprocess.run([PYTHON, "-c", f"import {', '.join(modules)}"], capture_output=True, check=False).returncode:
        _missing(f"{what} needs {', '.join(modules)}")


def _missing(why: str) -> None:
    words = f"{why}: apt-get install --no-install-recommends {' '.join(PACKAGES.read_text().split())}"
    if os.environ.get("CI") == "true":
        pytest.fail(words)
    pytest.skip(words)


def free_port() -> int:
    """Return a port without a listener."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class RosSystem:
    """A rosmaster and the nodes started on it."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self._running: list[Process] = []
        self._master: Process | None = None
        self.use(folder)

    def use(self, folder: Path) -> None:
        """Let nodes started later store their files in a folder."""
        self.environment = {
            "ROS_MASTER_URI": f"http://127.0.0.1:{self.port}",
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder),
            "ROS_LOG_DIR": str(folder / "log"),
            "ROS_PYTHON_VERSION": "3",
            "PATH": "/usr/bin:/bin",
            "HOME": str(folder),
            "PYTHONUNBUFFERED": "1",
            "LANG": "C.UTF-8",
        }
        (folder / "log").mkdir(parents=True, exist_ok=True)

    @property
    def source(self) -> str:
        """Return the source argument of `rosld serve`."""
        return f"ros1://127.0.0.1:{self.port}"

    @property
    def master(self) -> Any:
        """Return the master's API, for queries."""
        return xmlrpc.client.ServerProxy(f"http://127.0.0.1:{self.port}")

    def start_master(self) -> None:
        """Start an empty rosmaster, and wait until it answers."""
        command = [str(ROSMASTER), "--core", "-p", str(self.port)]
        self._master = Process(command, self.environment, patience=PATIENCE)
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            try:
                self.master.getPid("/test")
                return
            except OSError:
                time.sleep(0.05)
        raise AssertionError(f"rosmaster did not start: {self._master.seen}")

    def kill_master(self) -> None:
        """End the master as a crash would."""
        assert self._master is not None
        self._master.kill()
        self._master = None

    @property
    def master_process(self) -> subprocess.Popen[str]:
        """Return the process of the master."""
        assert self._master is not None
        return self._master.process

    def start(self, command: Sequence[str], **environment: str) -> Process:
        """Start a program in this system."""
        running = Process(command, {**self.environment, **environment}, patience=PATIENCE)
        self._running.append(running)
        return running

    def node(self, script: str, *arguments: str, **environment: str) -> Process:
        """Start one of the nodes next to this file and wait until it is ready."""
        running = self.start([PYTHON, str(NODES / script), *arguments], **environment)
        running.line("ready")
        return running

    def publish(self, topic: str, type_name: str, value: str, *, rate: float = 10, name: str | None = None) -> Process:
        """Publish a value (YAML) repeatedly with rostopic, and wait until the master has registered it."""
        before = set(self.publishers(topic))
        named = [f"__name:={name}"] if name else []
        running = self.start(["/usr/bin/rostopic", "pub", "-r", str(rate), topic, type_name, value, *named])
        self.until(lambda: set(self.publishers(topic)) - before, f"a publisher of {topic}")
        return running

    def run(self, *command: str, timeout: float = PATIENCE) -> str:
        """Return the output of a ROS program."""
        done = subprocess.run(
            command, env=self.environment, capture_output=True, text=True, timeout=timeout, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def yaml(self, text: str) -> Any:
        """Return the content of a YAML document; parsed by the system's Python, which has a parser."""
        program = "import json, sys, yaml; json.dump(yaml.safe_load(sys.stdin), sys.stdout)"
        done = subprocess.run([PYTHON, "-c", program], input=text, capture_output=True, text=True, check=True)
        return json.loads(done.stdout)

    def publishers(self, topic: str) -> list[str]:
        """Return the nodes that the master lists as publishers of a topic."""
        return dict(self.master.getSystemState("/test")[2][0]).get(topic, [])

    def until(self, true: Any, what: str, timeout: float = PATIENCE) -> None:
        """Wait until a condition on the system holds."""
        end = time.monotonic() + timeout
        while not true():
            assert time.monotonic() < end, f"never came: {what}"
            time.sleep(0.05)

    def end_nodes(self) -> None:
        """End every node started here."""
        for running in reversed(self._running):
            running.told_to_end()
        for running in reversed(self._running):
            running.stop()
        self._running.clear()

    def clear_master(self) -> None:
        """Remove all parameters, and the registrations of nodes that did not remove their own."""
        publishers, subscribers, services = self.master.getSystemState("/test")[2]
        for unregister, kind in (
            (self.master.unregisterPublisher, publishers),
            (self.master.unregisterSubscriber, subscribers),
        ):
            for topic, nodes in kind:
                for node in nodes:
                    unregister(node, topic, self.master.lookupNode("/test", node)[2])
        for service, nodes in services:
            for node in nodes:
                self.master.unregisterService(node, service, self.master.lookupService("/test", service)[2])
        for name in self.master.getParam("/test", "/")[2]:
            self.master.deleteParam("/test", name)

    def close(self) -> None:
        """End every process started here."""
        self.end_nodes()
        if self._master is not None:
            self._master.stop()


_idle: list[RosSystem] = []
"""The master of this process, while no test uses it."""


@contextmanager
def running(folder: Path) -> Iterator[RosSystem]:
    """Run an empty rosmaster; end everything started on it afterwards. Skip the test without ROS 1."""
    require_ros()
    system = _idle.pop() if _idle else RosSystem(folder)
    master = system._master
    try:
        if master is None:
            system.start_master()
            master = system._master
        else:
            system.use(folder)
        yield system
    finally:
        system.end_nodes()
        if _idle or master is None or master is not system._master or master.process.poll() is not None:
            system.close()
        else:
            system.clear_master()
            _idle.append(system)


@atexit.register
def _close() -> None:
    for system in _idle:
        system.close()
