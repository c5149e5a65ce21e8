"""Bilinear demosaicing of Bayer patterns: what a pixel did not see is the mean of its neighbours that did. Pure."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

_RED = {"rggb": (0, 0), "bggr": (1, 1), "gbrg": (1, 0), "grbg": (0, 1)}
"""Row and column of the first red pixel in each pattern."""
PATTERNS = tuple(_RED)


def demosaic(mosaic: npt.NDArray[np.uint8], pattern: str) -> npt.NDArray[np.uint8]:
    """Red, green and blue of each pixel. The margin is that of the picture mirrored at its outermost pixels."""
    height, width = mosaic.shape
    if height < 2 or width < 2:
        return np.repeat(mosaic[:, :, None], 3, axis=2)
    padded = np.pad(mosaic, 1, mode="reflect").astype(np.uint16)
    up, down, left, right = padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]
    own = padded[1:-1, 1:-1]
    across, along = (left + right + 1) >> 1, (up + down + 1) >> 1
    cross = (up + down + left + right + 2) >> 2
    corners = (padded[:-2, :-2] + padded[:-2, 2:] + padded[2:, :-2] + padded[2:, 2:] + 2) >> 2
    row, column = _RED[pattern]
    found = np.empty((height, width, 3), dtype=np.uint8)
    red_rows, blue_rows = slice(row, None, 2), slice(1 - row, None, 2)
    red_columns, blue_columns = slice(column, None, 2), slice(1 - column, None, 2)
    for first, last, rows, columns, other_columns in (
        (0, 2, red_rows, red_columns, blue_columns),
        (2, 0, blue_rows, blue_columns, red_columns),
    ):
        found[rows, columns, first] = own[rows, columns]
        found[rows, columns, 1] = cross[rows, columns]
        found[rows, columns, last] = corners[rows, columns]
        found[rows, other_columns, 1] = own[rows, other_columns]
        found[rows, other_columns, first] = across[rows, other_columns]
        found[rows, other_columns, last] = along[rows, other_columns]
    return found
