"""The contract suite and the adapter's own tests on a real ROS 2, run by the Python of a distro."""

from __future__ import annotations

import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from tests.ros2 import distros
from tests.ros2.system import quick_environment

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
MAX_SECONDS = 600.0

pytestmark = [pytest.mark.slow, pytest.mark.ros2]


def failures(report: Path) -> list[str]:
    """Return the tests of a JUnit report that did not pass, each with its reason."""
    found = []
    for case in ElementTree.parse(report).iter("testcase"):
        for kind in ("failure", "error", "skipped"):
            for one in case.iter(kind):
                found.append(f"{kind}: {case.get('classname')}::{case.get('name')}\n{one.text or one.get('message')}")
    return found


def run(distro: str, folder: Path, *arguments: str) -> None:
    """Run tests in a distro's venv; check that none failed, and that some ran."""
    python = distros.require(distro).python
    report = folder / "report.xml"
    with distros.free_domain() as domain:
        environment = quick_environment(domain, ROSLD_ROS2_PYTHON=python)
        options = ("-q", "-p", "no:cacheprovider", f"--junit-xml={report}", f"--basetemp={folder / 'temporary'}")
        done = subprocess.run(
            [python, "-m", "pytest", *options, *arguments],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=MAX_SECONDS,
            check=False,
        )
    assert report.exists(), done.stdout + done.stderr
    failed = failures(report)
    assert not failed, "\n\n".join(failed)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_adapter_of_ros_2_fulfils_its_contract_and_passes_its_own_tests(tmp_path: Path) -> None:
    live = sorted(map(str, (ROOT / "tests" / "adapters" / "ros2").glob("test_live_*.py")))
    run("kilted", tmp_path, "tests/contracts", *live, "-k", "ros2")


def test_the_types_of_the_other_distro_are_known(tmp_path: Path) -> None:
    run("jazzy", tmp_path, "tests/adapters/ros2/test_live_types.py", "-k", "every_type_installed_here")
