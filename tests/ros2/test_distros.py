"""Where a ROS 2 cannot be had, the tests say why; where it can, nobody else is in its domain."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

from tests.ros2 import distros


def test_two_at_once_never_have_the_same_domain() -> None:
    with distros.free_domain() as one, distros.free_domain() as other:
        assert one != other
        assert {one, other} <= set(range(1, 101))


def test_a_process_of_ros_2_gets_nothing_of_another_ros_and_stays_on_this_machine(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "AMENT_PREFIX_PATH", "RMW_IMPLEMENTATION"):
        monkeypatch.setenv(name, "/opt/ros/other")
    given = distros.environment(42)
    assert "/opt/ros/other" not in given.values()
    assert (given["ROS_DOMAIN_ID"], given["ROS_AUTOMATIC_DISCOVERY_RANGE"]) == ("42", "LOCALHOST")
    assert given["PATH"] == os.environ["PATH"]


def test_without_a_compiler_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(distros, "ROOT", tmp_path)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    distro = distros.Distro("jazzy")
    distro.folder.mkdir()
    with pytest.raises(
        distros.Missing, match=r"without gcc, g\+\+.*: apt-get install --no-install-recommends gcc g\+\+"
    ):
        distros.build_interfaces(distro)


def test_what_cannot_be_installed_is_told_in_the_installer_s_words() -> None:
    command = [sys.executable, "-c", "raise SystemExit('ERROR: no such wheel')"]
    with pytest.raises(distros.Missing, match="not to be had: ERROR: no such wheel"):
        distros.run(command, "not to be had")


def test_a_step_is_done_once_and_again_when_what_it_is_made_of_changes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(distros, "ROOT", tmp_path)
    distro, done = distros.Distro("jazzy"), []
    distro.folder.mkdir()
    for parts in (["a"], ["a"], ["b"]):
        distros.once(distro, "step", parts, lambda parts=parts: done.append(parts))
    assert done == [["a"], ["b"]]


def test_a_step_that_failed_is_tried_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(distros, "ROOT", tmp_path)
    distro = distros.Distro("jazzy")
    distro.folder.mkdir()
    done: list[int] = []

    def fail() -> None:
        raise distros.Missing("no network")

    with pytest.raises(distros.Missing):
        distros.once(distro, "step", ["a"], fail)
    distros.once(distro, "step", ["a"], lambda: done.append(1))
    assert done == [1]
