"""Views of space on pages: the address of a view, and its rows in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from urllib.parse import quote

from rosld.server.html.site import Anchor, Site
from rosld.server.html.timestamps import time_view
from rosld.server.html.view import View, escape_controls
from rosld.server.space.drawing import can_place
from rosld.server.space.frame_tree import FrameNode
from rosld.server.space.transform import Transform, heading

VIEW_3D = "3d"
"""`?view=` of what is drawn in three dimensions."""
_MAX_DEPTH = 12
"""Of the indentation of frames."""


@dataclass(frozen=True, slots=True)
class SpaceRow:
    """A topic of a view: how its messages are called, the frame they name, where that is, or why it is not known."""

    topic: Anchor | None
    kind: str
    frame: str
    where: str
    problem: str


@dataclass(frozen=True, slots=True)
class FrameRow:
    """A frame in the table of frames: how deep it is, and what is said of it; `received` is None of a root."""

    name: str
    depth: int
    parent: str
    where: str
    is_static: bool
    received: View | None
    publishers: tuple[Anchor, ...]
    problem: str


def frame_row(node: FrameNode, site: Site, node_url: Callable[[str], str]) -> FrameRow:
    """The row of a frame."""
    newest = node.newest
    anchors = (site.anchor(node_url(each)) for each in node.publishers if each)
    return FrameRow(
        escape_controls(node.name),
        min(node.depth, _MAX_DEPTH),
        "" if newest is None else escape_controls(newest.parent),
        "" if newest is None else pose_words(newest.transform),
        newest is not None and newest.is_static,
        None if newest is None else time_view(newest.source.received_ns),
        tuple(each for each in anchors if each is not None),
        escape_controls(node.problem),
    )


def space_query(frame: str, references: Sequence[str], *, is_3d: bool = False) -> str:
    """The query of the view that is fixed to a frame and shows these topics, from above or in three dimensions."""
    asked = [("frame", frame)] if frame else []
    asked += [("show", each) for each in references]
    asked += [("view", VIEW_3D)] if is_3d else []
    said = "&".join(f"{name}={quote(value.encode('utf-8', 'replace'), safe='/:')}" for name, value in asked)
    return f"?{said}" if said else ""


def topic_view(type_name: str, url: str, site: Site) -> str:
    """The address of the view of one topic; empty where its messages are not drawn, or may not be looked at."""
    if not can_place(type_name) or not site.may("GET", f"{site.base}space") or not url.startswith(site.base):
        return ""
    return f"{site.root}space{space_query('', [url.removeprefix(site.base)])}"


def pose_words(pose: Transform) -> str:
    """Where something is, as people say it."""
    x, y, z = pose.translation
    above = f", {z:.2f} m up" if abs(z) >= 0.005 else ""
    return f"{x:.2f}, {y:.2f} m{above}, turned by {math.degrees(heading(pose)):.0f}°"
