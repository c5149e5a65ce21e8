"""Following of actions: which of them the robot is asked to tell the goals of, and for how long."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from rosld.adapters.base import Adapter, Watch
from rosld.adapters.model import RosError
from rosld.server.runtime.tasks import end_tasks, loop_time

_SWEEP = 1.0


class GoalFollower:
    """Follows actions while somebody looks at them, and for `idle` seconds after that. Belongs to one loop."""

    def __init__(self, adapter: Adapter, idle: float) -> None:
        self._adapter = adapter
        self._idle = idle
        self._followed: dict[str, _Following] = {}
        self._sweeper: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin; needs a running loop."""
        self._sweeper = asyncio.get_running_loop().create_task(self._sweep_for_ever())

    async def stop(self) -> None:
        """Follow nothing more."""
        if self._sweeper is not None:
            await end_tasks([self._sweeper])
        for action in list(self._followed):
            self._unfollow(action)

    async def follow(self, action: str, *, deadline: float) -> bool:
        """Follow all goals of an action from now on; return whether they are followed. The first call waits."""
        following = self._followed.get(action)
        if following is None:
            opening = asyncio.ensure_future(self._adapter.follow_goals(action, deadline=deadline))
            following = self._followed[action] = _Following(opening, 0.0)
        following.looked_at = loop_time()
        try:
            await asyncio.shield(following.opening)
        except RosError:
            if self._followed.get(action) is following:
                del self._followed[action]
            return False
        return True

    def is_followed(self, action: str) -> bool:
        """Whether all goals of an action are announced now."""
        following = self._followed.get(action)
        opening = None if following is None else following.opening
        return opening is not None and opening.done() and not opening.cancelled() and opening.exception() is None

    def keep_following(self, action: str, watch: Watch) -> Watch:
        """The watch, with its action followed, if it is, until it is closed."""
        return _GoalWatch(self._followed.get(action), watch)

    async def _sweep_for_ever(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP)
            horizon = loop_time() - self._idle
            for action, following in list(self._followed.items()):
                if not following.watches and following.looked_at < horizon:
                    self._unfollow(action)

    def _unfollow(self, action: str) -> None:
        opening = self._followed.pop(action).opening
        if not opening.done():
            opening.cancel()
        elif not opening.cancelled() and opening.exception() is None:
            opening.result().close()


@dataclass(slots=True)
class _Following:
    """An action that is followed: the watch of its goals, when it was read last (loop time), how many watch it."""

    opening: asyncio.Future[Watch]
    looked_at: float
    watches: int = 0


class _GoalWatch:
    """A watch that keeps its action followed."""

    def __init__(self, following: _Following | None, watch: Watch) -> None:
        self._following = following
        self._watch = watch
        if following is not None:
            following.watches += 1

    def close(self) -> None:
        """Stop waking. Idempotent."""
        following, self._following = self._following, None
        if following is not None:
            following.watches -= 1
            following.looked_at = loop_time()
        self._watch.close()
