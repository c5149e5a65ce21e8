"""Which tests run one after the other where several run side by side: those that share what takes long to start."""

from __future__ import annotations

import re

from xdist.scheduler import LoadFileScheduling

ROBOTS = ("embedded", "rospy", "jazzy", "kilted")
"""The aircraft of the paper's tests, as the names of tests have them."""


class ByFileOrRobot(LoadFileScheduling):
    """File by file; the tests of the paper robot by robot, so that each aircraft is started once for all of them."""

    def _split_scope(self, nodeid: str) -> str:
        file, _, name = nodeid.partition("::")
        if file.startswith("tests/paper/"):
            named = re.split(r"[\[\]-]", name)
            return next((f"tests/paper {robot}" for robot in ROBOTS if robot in named), file)
        return file
