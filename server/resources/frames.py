"""Frames at `/frames`: each below its parent, with its publisher, age and problems."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import orjson

from rosld.adapters.base import Watch
from rosld.ontology.describe_views import Frame, frames_document
from rosld.ontology.literals import date_time
from rosld.server.auth.errors import not_found
from rosld.server.html.forms import Form
from rosld.server.html.page import Csrf, FramesPage, Notice
from rosld.server.html.render import render_frames
from rosld.server.html.site import Site
from rosld.server.http.conditional import digest
from rosld.server.hypermedia.json_schema import (
    BOOLEAN,
    NUMBER,
    TEXT,
    URI,
    JsonSchema,
    json_array,
    json_object,
    nullable,
)
from rosld.server.resources.base import Services, SessionResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.robot.scene import Scene
from rosld.server.runtime.tasks import call_every
from rosld.server.space.drawing import pose_json
from rosld.server.space.transforms import TOPICS, FrameNode, frame_tree

_LOOK_SECONDS = 1.0
_NUMBERS: JsonSchema = {"anyOf": [json_array(NUMBER), {"type": "null"}]}
_PLAIN: JsonSchema = json_object(
    {
        "frames": json_array(
            json_object(
                {
                    "name": TEXT,
                    "parent": nullable(TEXT),
                    "static": BOOLEAN,
                    "pose": _NUMBERS,
                    "received": nullable(TEXT),
                    "publishers": json_array(URI),
                    "problem": TEXT,
                }
            )
        )
    }
)


class FramesResource(SessionResource):
    """The frames of the robot, as one agent may see them."""

    kind = "Frames"
    shape = "Source"
    title = "Frames"
    item = PathItem("The frames of the robot, each with its parent", plain=_PLAIN)
    links = (RESOURCE, RDF_SOURCE)

    path = "frames"
    _nodes: Sequence[FrameNode] = ()

    def __init__(self, services: Services, scene: Scene) -> None:
        super().__init__(services)
        self.scene = scene

    async def select_variant(self, exchange: Exchange) -> Resource:
        """The frames as the agent may see them. Raises a Problem where it may not see the transforms."""
        if not all(exchange.permissions.may_read(self.space.topic(each)) for each in TOPICS):
            raise not_found()
        return self.variant(_permissions=exchange.permissions)

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        """Return a polling watch, because moving frames change all the time."""
        return call_every(_LOOK_SECONDS, wake)

    async def state(self) -> State:
        buffer = await self.scene.frames.look()
        self._nodes = frame_tree(buffer, self.session.adapter.age_ns)
        frames = [self._frame(each) for each in self._nodes]
        plain = orjson.dumps(
            {"frames": [_frame_json(each, frame) for each, frame in zip(self._nodes, frames, strict=True)]}
        )
        return State(partial(frames_document, self.url, frames, self.space.types), lambda: plain, digest(plain))

    def page(self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]) -> bytes:
        return render_frames(FramesPage(site, self.url, tuple(self._nodes), self.space.node, tuple(notices)))

    def _frame(self, node: FrameNode) -> Frame:
        """A frame as it is described, with the nodes that the agent may read."""
        urls = (self.space.node(each) for each in node.publishers if each)
        publishers = tuple(url for url in urls if self._permissions.may_read(url))
        newest = node.newest
        parent, received = (None, None) if newest is None else (newest.parent, newest.source.received_ns)
        return Frame(node.name, parent, received, publishers, node.problem)


def _frame_json(node: FrameNode, frame: Frame) -> dict[str, object]:
    newest = node.newest
    return {
        "name": frame.name,
        "parent": frame.parent,
        "static": newest is not None and newest.is_static,
        "pose": None if newest is None else pose_json(newest.transform),
        "received": None if frame.received_ns is None else date_time(0, frame.received_ns),
        "publishers": frame.publishers,
        "problem": frame.problem,
    }
