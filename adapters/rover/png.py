"""PNG (ISO/IEC 15948) of an image of 8 bits a colour. Pure."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_TRUECOLOUR = 2
_QUICK = 1
"""The level of compression: the images have large even areas, which any level makes small."""


def encode(image: NDArray[np.uint8]) -> bytes:
    """Return the file of an image of rows, columns and red, green and blue."""
    rows, columns, _ = image.shape
    lines = np.zeros((rows, 1 + 3 * columns), dtype=np.uint8)  # each begins with its filter: 0 is none
    lines[:, 1:] = image.reshape(rows, -1)
    header = struct.pack(">IIBBBBB", columns, rows, 8, _TRUECOLOUR, 0, 0, 0)
    data = zlib.compress(lines.tobytes(), _QUICK)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
