"""A colour map of distances: near is warm and bright, far is cold and dark, what is unknown is black. Pure."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PIL import Image

from rosld.server.pictures.form import CannotDraw, DepthRange

_ANCHORS = ((255, 238, 150), (252, 170, 60), (222, 80, 60), (150, 40, 120), (70, 45, 160), (25, 45, 95))
"""Colours from the nearest to the farthest, at equal distances from each other: brightness falls all the way."""
_COLOURS = 255


def _palette() -> bytes:
    """768 bytes: black for what is unknown, then the colours from the nearest to the farthest."""
    places = np.linspace(0, len(_ANCHORS) - 1, _COLOURS)
    anchors = np.array(_ANCHORS, dtype=np.float64)
    channels = [np.interp(places, np.arange(len(_ANCHORS)), anchors[:, channel]) for channel in range(3)]
    colours: npt.NDArray[np.uint8] = np.stack(channels, axis=-1).round().astype(np.uint8)
    return bytes(3) + colours.tobytes()


_PALETTE = _palette()


def draw_depth(depth: npt.NDArray[np.generic], scale: float, shown: DepthRange) -> Image.Image:
    """Return the colours of an array of distances, `scale` metres each; 0, NaN and infinities are unknown.

    Raises CannotDraw where `shown` is no range.
    """
    if not shown.nearest < shown.farthest:
        raise CannotDraw(f"The range {shown.nearest:g} to {shown.farthest:g} has no distances in it")
    nearest, span = shown.nearest / scale, (shown.farthest - shown.nearest) / scale
    with np.errstate(all="ignore"):
        distances = depth.astype(np.float32)
        places = (distances - np.float32(nearest)) * np.float32((_COLOURS - 1) / span)
        is_known = np.isfinite(distances) & (distances != 0)
        index = np.where(is_known, np.clip(np.nan_to_num(places), 0, _COLOURS - 1) + 1, 0).astype(np.uint8)
    height, width = index.shape
    picture = Image.frombuffer("P", (width, height), np.ascontiguousarray(index), "raw", "P", 0, 1)
    picture.putpalette(_PALETTE)
    return picture.convert("RGB")
