"""Event stream of a view of space: drawings, and their poses in the fixed frame of the view."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence

import orjson
from msgspec import Struct

from rosld.adapters.base import Watch
from rosld.adapters.model import RosError
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.event_stream import HEADERS, EndlessResponse, EventWriter, SendChunk, event_frame
from rosld.server.robot.live_topics import LiveTopics
from rosld.server.robot.scene import Drawings, DrawnSample, LiveFrames
from rosld.server.space.drawing import pose_json
from rosld.server.space.transforms import FrameBuffer, NoTransform, Transform

PERIOD = 0.04
"""Minimum seconds between two events: 25 events per second."""
_LONGEST = 1.0
"""Maximum seconds between two updates."""
_FRAMES_PERIOD = 0.1
_GOALS_PERIOD = 0.5
_MAX_FRAMES = 200
"""Maximum number of drawn frames."""


class ShownTopic(Struct, frozen=True):
    """A topic of a view: its name, the label of its type, and references relative to the host.

    `picture` is the reference of a grid's picture, `cloud` of a point cloud's data, `history` of its recorded numbers,
    up to the field; empty if there is none.
    """

    name: str
    kind: str
    href: str
    picture: str = ""
    history: str = ""
    cloud: str = ""


class SpaceSource(Struct, frozen=True):
    """Data source of a stream; `frames` is None for an agent that may not read them.

    `goals` returns the targets that accept poses, and the time for their headers, None under simulated time.
    `has_cloud_files`: the reader loads point clouds from files, so that the stream need not contain the points.
    """

    topics: LiveTopics
    drawings: Drawings
    frames: LiveFrames | None
    shown: Callable[[], Sequence[ShownTopic]]
    is_valid: Callable[[], bool]
    goals: Callable[[], Awaitable[tuple[Sequence[Mapping[str, object]], float | None]]]
    has_cloud_files: bool = False


class SpaceStream(EndlessResponse):
    """Stream of a view and its changes, until its reader disconnects or the server ends.

    Each event is a JSON object without unchanged members. `show`: the topics of the view, first of all and after each
    change. `frame`: the fixed frame of the view. `frames`: the name, parent and pose of each frame connected to it.
    `things`: by index, the drawing of a new message (`drawing`), and the pose of the message's frame (`pose`) or why it
    is unknown (`problem`). `goals`: the targets that accept a pose, with the time for its header (`now`, in seconds).
    """

    def __init__(self, broadcasters: Broadcasters, source: SpaceSource, fixed: str) -> None:
        """Initialize; `fixed` is the fixed frame of the view, or empty to choose the best one."""
        super().__init__(broadcasters, HEADERS)
        self._source = source
        self._fixed = fixed

    async def write(self, send_chunk: SendChunk) -> None:
        writer, woken = EventWriter(send_chunk), asyncio.Event()
        await writer.open()
        with contextlib.ExitStack() as stack:
            view = _View(self._source, self._fixed, woken.set, stack)
            while self._source.is_valid():
                found = await view.take()
                await (writer.send(event_frame(orjson.dumps(found))) if found else writer.keep_alive())
                await asyncio.sleep(PERIOD)
                with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
                    await asyncio.wait_for(woken.wait(), _LONGEST)
                woken.clear()


class _View:
    """State of one reader: the parts already sent."""

    def __init__(self, source: SpaceSource, fixed: str, wake: Callable[[], None], stack: contextlib.ExitStack) -> None:
        self._source = source
        self._fixed = fixed
        self._wake = wake
        self._stack = stack
        self._shown: Sequence[ShownTopic] | None = None
        self._watches: dict[str, Watch] = {}
        self._sent_drawings: dict[str, DrawnSample] = {}
        self._sent_poses: dict[str, object] = {}
        self._frame: str | None = None
        self._frames: object = None
        self._framed_at = 0.0
        self._goals: Sequence[Mapping[str, object]] = ()
        self._aimed_at = 0.0
        if source.frames is not None:
            stack.callback(source.frames.watch(wake).close)
        stack.callback(self._close)

    def _close(self) -> None:
        for watch in self._watches.values():
            watch.close()

    async def take(self) -> dict[str, object]:
        """Return the new parts as an event; empty without any."""
        event: dict[str, object] = {}
        shown = self._source.shown()
        if shown != self._shown:
            await self._show(shown)
            event["show"] = [
                {"label": each.name, "kind": each.kind, "href": each.href, "history": each.history} for each in shown
            ]
        if time.monotonic() - self._aimed_at >= _GOALS_PERIOD:
            self._aimed_at = time.monotonic()
            goals, now = await self._source.goals()
            if goals != self._goals:
                event["goals"], event["now"] = goals, now
                self._goals = goals
        drawings = [(place, each, await self._source.drawings.newest(each.name)) for place, each in enumerate(shown)]
        buffer = FrameBuffer() if self._source.frames is None else await self._source.frames.look()
        fixed = self._fixed or buffer.default_frame() or _first_frame([found for _, _, found in drawings])
        if fixed is not None and fixed != self._frame:
            event["frame"] = self._frame = fixed
            self._framed_at = 0.0
        parts = [
            part
            for place, each, found in drawings
            if found is not None and (part := self._part(place, each, found, buffer, fixed or ""))
        ]
        if parts:
            event["things"] = parts
        if fixed is not None and (frames := self._moved_frames(buffer, fixed)) is not None:
            event["frames"] = frames
        return event

    async def _show(self, shown: Sequence[ShownTopic]) -> None:
        """Follow the topics of a changed view."""
        names = {each.name for each in shown}
        for name in self._watches.keys() - names:
            self._watches.pop(name).close()
        for name in names - self._watches.keys():
            with contextlib.suppress(RosError):
                self._watches[name] = await self._source.topics.watch(name, self._wake)
        self._shown, self._sent_drawings, self._sent_poses = shown, {}, {}

    def _part(
        self, place: int, shown: ShownTopic, found: DrawnSample, buffer: FrameBuffer, fixed: str
    ) -> dict[str, object]:
        """Return the new part of a topic; empty without any."""
        is_new = self._sent_drawings.get(shown.name) is not found
        placed, problem = place_drawing(found, buffer, fixed)
        pose = None if placed is None else pose_json(placed)
        if not is_new and self._sent_poses.get(shown.name) == (pose, problem):
            return {}
        self._sent_drawings[shown.name], self._sent_poses[shown.name] = found, (pose, problem)
        part: dict[str, object] = {"place": place, "pose": pose, "problem": problem}
        if is_new:
            is_file = self._source.has_cloud_files and bool(shown.cloud) and found.drawing is not None
            part["drawing"] = {} if is_file else orjson.Fragment(found.json)
            part["in"] = "" if found.drawing is None else found.drawing.frame
            if shown.picture and found.drawing is not None:
                part["picture"] = f"{shown.picture}&v={found.sample.epoch}.{found.sample.sequence}"
            if shown.cloud and found.drawing is not None:
                part["cloud"] = f"{shown.cloud}&v={found.sample.epoch}.{found.sample.sequence}"
        return part

    def _moved_frames(self, buffer: FrameBuffer, fixed: str) -> object:
        """Return all frames if one has moved since they were sent, else None."""
        now = time.monotonic()
        if now - self._framed_at < _FRAMES_PERIOD:
            return None
        self._framed_at = now
        found = frames_json(buffer, fixed)
        if found == self._frames:
            return None
        self._frames = found
        return found


def frames_json(buffer: FrameBuffer, fixed: str) -> list[dict[str, object]]:
    """Return the frames connected to a frame, each with its parent and its pose there."""
    newest = buffer.newest
    found: list[dict[str, object]] = []
    for name in list(buffer.names)[:_MAX_FRAMES]:
        try:
            pose = pose_json(buffer.look_up(fixed, name))
        except NoTransform:
            continue
        found.append({"name": name, "parent": newest[name].parent if name in newest else None, "pose": pose})
    return found


def _first_frame(drawings: Sequence[DrawnSample | None]) -> str | None:
    """Return a frame of some drawing, for a robot without transforms."""
    return next((each.drawing.frame for each in drawings if each and each.drawing and each.drawing.frame), None)


def place_drawing(found: DrawnSample, buffer: FrameBuffer, fixed: str) -> tuple[Transform | None, str]:
    """Return the pose of a message's frame in another at its time, or why it is unknown."""
    if found.drawing is None:
        return None, found.problem
    try:
        return buffer.look_up(fixed, found.drawing.frame, found.drawing.stamp_ns or None), ""
    except NoTransform as error:
        return None, f"{error}"
