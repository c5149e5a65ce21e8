"""Forms of pictures, types of messages with pictures, and errors. Imports no drawing library."""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct

from rosld.server.runtime.process_memory import PROCESS_MEMORY

JPEG, PNG = "image/jpeg", "image/png"
RAW_IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
DRAWN_TYPES = (RAW_IMAGE, COMPRESSED_IMAGE, OCCUPANCY_GRID)
"""Message types that can be drawn as pictures."""


class DepthRange(NamedTuple):
    """Distances in metres of the nearest and the farthest colour."""

    nearest: float = 0.0
    farthest: float = 10.0


DEFAULT_RANGE = DepthRange()


class PictureForm(Struct, frozen=True):
    """Form of a requested picture: its media type, maximum width, and the distances of colours."""

    media_type: str = JPEG
    width: int | None = None
    shown: DepthRange = DEFAULT_RANGE


def can_draw(type_name: str) -> bool:
    """Whether messages of a type are pictures."""
    return type_name in DRAWN_TYPES


MAX_PIXELS = 36_000_000
"""Maximum number of pixels of a picture: 8K video has 33 million."""
_PER_PIXEL = 24
"""Maximum bytes per pixel while drawing: 64 bits in four channels, and the same as floats."""


class CannotDraw(ValueError):
    """A message that cannot be drawn as a picture. The message is a sentence without its full stop.

    `words` are quoted from the message, such as its encoding, and are not part of the sentence.
    """

    def __init__(self, sentence: str, words: str | None = None) -> None:
        super().__init__(sentence)
        self.words = words


class UnknownPicture(CannotDraw):
    """Pictures of this kind are not supported, regardless of their data."""


def require_size(width: int, height: int) -> None:
    """Raise CannotDraw if a picture has no pixels, or too many.

    Raises NotEnoughMemory if there is not enough memory to draw it.
    """
    if width <= 0 or height <= 0:
        raise CannotDraw(f"The image is {width} by {height} pixels, so there is nothing to show")
    if width * height > MAX_PIXELS:
        raise CannotDraw(f"The image has {width} by {height} pixels, but the limit is {MAX_PIXELS:,}")
    PROCESS_MEMORY.require(width * height * _PER_PIXEL, f"a picture of {width} by {height} pixels")
