"""Which tests run side by side."""

from __future__ import annotations

from xdist.scheduler import LoadFileScheduling

from tests.groups import group_of


class ByFileOrRobot(LoadFileScheduling):
    """File by file; tests of the paper and of the rover robot by robot, so that each robot is started once for all."""

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)
