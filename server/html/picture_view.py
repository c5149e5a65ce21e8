"""The picture of a message on its page: an image that is there without scripts, and moves with them."""

from __future__ import annotations

from dataclasses import dataclass

from rosld.adapters.model import Message, MessageSchema
from rosld.server.html.view import escape_controls
from rosld.server.pictures.form import COMPRESSED_IMAGE, DEFAULT_RANGE, OCCUPANCY_GRID, can_draw
from rosld.server.pictures.refusal import CannotDraw

MAX_WIDTH, MAX_RATE = 960, 15
"""Of the picture on a page: at most so many pixels wide, and so many times a second."""


@dataclass(frozen=True, slots=True)
class PictureView:
    """The picture of a message: where it is, where it moves (empty: nowhere), and what is to be said beside it.

    `refused` says why it is not drawn. `width` and `height` are 0 where they are not known.
    """

    still: str
    motion: str = ""
    words: str = ""
    refused: str = ""
    width: int = 0
    height: int = 0


def picture_view(schema: MessageSchema, message: Message, query: str, *, moves: bool) -> PictureView | None:
    """The picture of a message, None where it is none. `query` is what the URL of its page ends in."""
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
            still, refused=f"Images of the encoding {escape_controls(image.encoding[:40])} are not drawn."
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
    return f"Distances from {nearest:g} m (bright) to {farthest:g} m (dark); black is unknown. ?range= asks for others."
