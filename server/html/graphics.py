"""Graphics of pages: plots of numbers over time, pictures, and messages in space."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from urllib.parse import quote

from msgspec import Struct

from rosld.adapters.model import Message, MessageSchema
from rosld.ontology.describe_views import PlottedNumber
from rosld.server.html.site import Site
from rosld.server.html.view import escape_controls, time_view
from rosld.server.pictures.picture_cache import COMPRESSED_IMAGE, DEFAULT_RANGE, OCCUPANCY_GRID, CannotDraw, can_draw
from rosld.server.space.drawing import can_place
from rosld.server.space.transforms import FrameNode, Transform, heading


def plot_query(references: Sequence[str]) -> str:
    """Return the query of the plot of these numbers."""
    return "?" + "&".join(f"y={quote(each, safe='/:')}" for each in references) if references else ""


def plot_lines(numbers: Sequence[PlottedNumber], site: Site) -> list[dict[str, str | int | None]]:
    """Return the label, the unit and the recording of each number; labels name topics if there are several."""
    is_single = len({number.topic for number in numbers}) == 1
    return [
        {
            "label": number.field if is_single else f"{site.short_name(number.topic)} {number.field}",
            "unit": number.quantity.symbol,
            "series": None if number.series is None else site.href(number.series),
        }
        for number in numbers
    ]


def plot_prefix(topic: str, site: Site) -> str | None:
    """Return the prefix of references to plots of a topic, to which a field's path is added; None if not permitted."""
    path = site.href(topic)
    if path is None or not topic.startswith(f"{site.base}topics/") or not site.may("GET", f"{site.base}plot"):
        return None
    below = topic.removeprefix(site.base)
    return f"{site.root}plot?y={quote(f'{below}#', safe='/:')}"


MAX_WIDTH, MAX_RATE = 960, 15
"""Query of pictures on pages: limits of the width in pixels and of the frame rate."""


class PictureView(Struct, frozen=True):
    """The picture of a message: its URL, the URL of its stream (or empty), and its caption.

    `refused` is the reason why it cannot be drawn. `width` and `height` are 0 if unknown.
    """

    still: str
    motion: str = ""
    words: str = ""
    refused: str = ""
    width: int = 0
    height: int = 0


def picture_view(schema: MessageSchema, message: Message, query: str, *, moves: bool) -> PictureView | None:
    """Return the picture of a message, or None. `query` is the query string of the page."""
    if not can_draw(schema.ref.name):
        return None
    from rosld.server.pictures.raw_image import ENCODINGS, read_raw_image  # Pillow, as in `PictureCache`

    before = f"?{query}&" if query else "?"
    still = f"{before}format=jpeg&width={MAX_WIDTH}"
    if schema.ref.name == OCCUPANCY_GRID:
        return PictureView(f"{before}format=png&width={MAX_WIDTH}", words="Light is free, dark is occupied.")
    motion = f"{before}format=mjpeg&width={MAX_WIDTH}&rate={MAX_RATE}" if moves and not query else ""
    if schema.ref.name == COMPRESSED_IMAGE:
        return PictureView(still, motion, _words(str(getattr(message, "format", "")).partition(";")[0].strip()))
    try:
        image = read_raw_image(message)
    except CannotDraw as error:
        return PictureView(still, refused=f"{error}.")
    if image.encoding not in ENCODINGS:
        return PictureView(
            still, refused=f"Images of the encoding {escape_controls(image.encoding[:40])} cannot be shown."
        )
    if image.width <= 0 or image.height <= 0:
        return PictureView(still, refused="The image has no pixels.")
    shown = min(image.width, MAX_WIDTH)
    return PictureView(
        still, motion, _words(image.encoding), "", shown, max(1, round(image.height * shown / image.width))
    )


def _words(encoding: str) -> str:
    from rosld.server.pictures.raw_image import depth_scale

    if depth_scale(encoding) is None:
        return ""
    nearest, farthest = DEFAULT_RANGE
    return f"Distances from {nearest:g} m (bright) to {farthest:g} m (dark); black is unknown. Set others with ?range=."


VIEW_3D = "3d"
"""Value of `?view=` for three dimensions."""
_MAX_DEPTH = 12
"""Maximum depth of indentation of frames."""


def frame_row(node: FrameNode, site: Site, node_url: Callable[[str], str]) -> Mapping[str, object]:
    """Return a frame in the table of frames, with its depth and description; a root was not `received`."""
    newest = node.newest
    anchors = (site.anchor(node_url(each)) for each in node.publishers if each)
    return {
        "name": escape_controls(node.name),
        "depth": min(node.depth, _MAX_DEPTH),
        "parent": "" if newest is None else escape_controls(newest.parent),
        "where": "" if newest is None else pose_words(newest.transform),
        "is_static": newest is not None and newest.is_static,
        "received": None if newest is None else time_view(newest.source.received_ns),
        "publishers": tuple(each for each in anchors if each is not None),
        "problem": escape_controls(node.problem),
    }


def space_query(frame: str, references: Sequence[str], *, is_3d: bool = False) -> str:
    """Return the query string of the view of these topics in a fixed frame, from above or in three dimensions."""
    pairs = [("frame", frame)] if frame else []
    pairs += [("show", each) for each in references]
    pairs += [("view", VIEW_3D)] if is_3d else []
    query = "&".join(f"{name}={quote(value.encode('utf-8', 'replace'), safe='/:')}" for name, value in pairs)
    return f"?{query}" if query else ""


def topic_view(type_name: str, url: str, site: Site) -> str:
    """Return the URL of the view of one topic; empty if its messages cannot be drawn or the reader may not see them."""
    if not can_place(type_name) or not site.may("GET", f"{site.base}space") or not url.startswith(site.base):
        return ""
    return f"{site.root}space{space_query('', [url.removeprefix(site.base)])}"


def pose_words(pose: Transform) -> str:
    """Return a pose in words."""
    x, y, z = pose.translation
    above = f", {z:.2f} m up" if abs(z) >= 0.005 else ""
    return f"{x:.2f}, {y:.2f} m{above}, turned by {math.degrees(heading(pose)):.0f}°"
