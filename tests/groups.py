"""Which tests run one after the other on one worker: those of a file, and those that share what takes long to start."""

from __future__ import annotations

import re

ROBOTS = ("embedded", "rospy", "jazzy", "kilted")
"""The aircraft of the paper's tests and the rovers, as the names of tests have them."""
BY_ROBOT = ("tests/paper/", "tests/rover/")
BY_TEST = ("tests/ros2/test_adapter.py",)
"""Files each test of which is a run of tests of its own: minutes."""


def group_of(nodeid: str) -> str:
    """Name the tests that run one after the other on one worker with the test of this id."""
    file, _, name = nodeid.partition("::")
    for folder in BY_ROBOT:
        if file.startswith(folder):
            named = re.split(r"[\[\]-]", name)
            return next((f"{folder} {robot}" for robot in ROBOTS if robot in named), file)
    return nodeid if file in BY_TEST else file
