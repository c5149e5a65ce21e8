"""Which tests run one after the other where several run side by side: those that share what takes long to start."""

from __future__ import annotations

import re

from xdist.scheduler import LoadFileScheduling

ROBOTS = ("embedded", "rospy", "jazzy", "kilted")
"""The aircraft of the paper's tests and the rovers, as the names of tests have them."""
BY_ROBOT = ("tests/paper/", "tests/rover/")
BY_TEST = ("tests/ros2/test_adapter.py",)
"""Files each test of which is a run of tests of its own: minutes."""


class ByFileOrRobot(LoadFileScheduling):
    """File by file; tests of the paper and of the rover robot by robot, so that each robot is started once for all."""

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)


def group_of(nodeid: str) -> str:
    """Name the tests that run one after the other on one worker with the test of this id."""
    file, _, name = nodeid.partition("::")
    for folder in BY_ROBOT:
        if file.startswith(folder):
            named = re.split(r"[\[\]-]", name)
            return next((f"{folder} {robot}" for robot in ROBOTS if robot in named), file)
    return nodeid if file in BY_TEST else file
