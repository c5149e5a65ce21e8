"""How a picture is wanted, and which messages are pictures. Needs nothing that draws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

JPEG, PNG = "image/jpeg", "image/png"
RAW_IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
DRAWN_TYPES = (RAW_IMAGE, COMPRESSED_IMAGE, OCCUPANCY_GRID)
"""The types of messages that are pictures."""


class DepthRange(NamedTuple):
    """The distances, in metres, that the nearest and the farthest colour stand for."""

    nearest: float = 0.0
    farthest: float = 10.0


DEFAULT_RANGE = DepthRange()


@dataclass(frozen=True, slots=True)
class PictureForm:
    """How a picture is wanted: its media type, at most how wide, and the distances that colours stand for."""

    media_type: str = JPEG
    width: int | None = None
    shown: DepthRange = DEFAULT_RANGE


def can_draw(type_name: str) -> bool:
    """Whether messages of a type are pictures."""
    return type_name in DRAWN_TYPES
