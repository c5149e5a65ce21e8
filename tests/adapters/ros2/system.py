"""A real ROS 2 system for tests: nodes in processes of their own, on the Python of a venv that has rclpy.

Its name is in ROSLD_ROS2_PYTHON. These tests run in that venv, for rosld imports rclpy as well. Every process started
here is ended by its own handle, and everything stays on the loopback interface, in a domain of its own.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.processes import Process
from tests.ros2.distros import free_domain

PYTHON = "ROSLD_ROS2_PYTHON"
NODES = Path(__file__).parent / "nodes"
PROFILES = Path(__file__).parent / "quick.xml"
PATIENCE = 60.0


def require_ros() -> str:
    """The Python that has rclpy; skips, saying what to do, where this one has none. Fails instead under CI."""
    python = os.environ.get(PYTHON)
    if python is None:
        words = (
            f"no ROS 2 here: run these tests with the Python of a venv made by "
            f"`pip install -e '.[test,ros2-jazzy]'`, and name it in {PYTHON}"
        )
        pytest.skip(words)
    try:
        import rclpy
    except ImportError as error:
        pytest.fail(f"{PYTHON} is set, but {sys.executable} has no rclpy: run the tests with {python} ({error})")
    assert rclpy is not None
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    old = any((Path(sys.prefix) / "lib").glob("libfastrtps.so*"))  # Jazzy and before
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE" if old else "FASTDDS_DEFAULT_PROFILES_FILE"] = str(PROFILES)
    return python


def environment(domain: int) -> dict[str, str]:
    """What a process of nodes is started with: what this one has, but for what its own Python makes for itself."""
    kept = dict(os.environ)
    kept.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
    kept.pop("LD_LIBRARY_PATH", None)
    kept["ROS_DOMAIN_ID"] = str(domain)
    return kept


class Ros2System:
    """Nodes in one domain."""

    def __init__(self) -> None:
        self.python = require_ros()
        self._kept = ExitStack()
        self.domain = self._kept.enter_context(free_domain())
        self.options = ""
        self._processes: list[Process] = []

    @property
    def source(self) -> str:
        """How rosld is told of it."""
        return f"ros2:?domain={self.domain}{self.options}"

    def node(self, script: str, *arguments: str) -> Process:
        """Start a script of `nodes/` and wait until it is ready."""
        command = [self.python, str(NODES / script), *arguments]
        running = Process(command, environment(self.domain), politely=signal.SIGINT, patience=PATIENCE)
        self._processes.append(running)
        running.line("ready")
        return running

    def close(self) -> None:
        """End every process."""
        for running in self._processes:
            if running.process.poll() is None:
                running.stop()
        self._kept.close()
