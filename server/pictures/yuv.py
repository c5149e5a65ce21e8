"""YUV to RGB as cameras mean it: ITU-R BT.601, luma from 16 to 235, chroma from 16 to 240. Pure."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Plane = npt.NDArray[np.uint8]

_VALUES = np.arange(256, dtype=np.float64)
_SHIFT = 5
"""Bits after the point: sums of three terms stay within 16 bits."""


def _table(values: npt.NDArray[np.float64]) -> npt.NDArray[np.int16]:
    return np.round(values * (1 << _SHIFT)).astype(np.int16)


_LUMA = _table(np.maximum(_VALUES - 16, 0) * 1.164) + np.int16(1 << (_SHIFT - 1))
_RED_V = _table((_VALUES - 128) * 1.596)
_GREEN_V = _table((_VALUES - 128) * -0.813)
_GREEN_U = _table((_VALUES - 128) * -0.391)
_BLUE_U = _table((_VALUES - 128) * 2.018)


def convert_yuv(luma: Plane, u: Plane, v: Plane) -> Plane:
    """Red, green and blue of each pixel; all planes have one value a pixel."""
    brightness = _LUMA[luma]
    channels = (brightness + _RED_V[v], brightness + _GREEN_V[v] + _GREEN_U[u], brightness + _BLUE_U[u])
    found = np.empty((*luma.shape, 3), dtype=np.uint8)
    for number, channel in enumerate(channels):
        found[:, :, number] = np.clip(channel >> _SHIFT, 0, 255)
    return found


def convert_packed(pairs: npt.NDArray[np.uint8], *, luma_first: bool) -> Plane:
    """Of YUV 4:2:2 in rows of four bytes for two pixels: Y U Y V (`luma_first`) or U Y V Y."""
    first, second = (0, 1) if luma_first else (1, 0)
    luma = pairs[:, :, first::2].reshape(pairs.shape[0], -1)
    u, v = pairs[:, :, second], pairs[:, :, second + 2]
    return convert_yuv(luma, np.repeat(u, 2, axis=1), np.repeat(v, 2, axis=1))
