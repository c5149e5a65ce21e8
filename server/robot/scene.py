"""What a robot tells of space: its frames, and what is drawn of its topics, shared by all who look."""

from __future__ import annotations

from rosld.server.robot.drawings import Drawings
from rosld.server.robot.live_frames import LiveFrames
from rosld.server.robot.session import Session


class Scene:
    """The frames and the drawings of one robot."""

    def __init__(self, session: Session) -> None:
        settings = session.settings
        self.frames = LiveFrames(
            session.adapter, session.schemas, idle=settings.idle_time, first_value=settings.first_value_wait
        )
        self.drawings = Drawings(session.topics, session.schemas)

    async def close(self) -> None:
        """Follow the frames no more. Idempotent."""
        await self.frames.stop()
