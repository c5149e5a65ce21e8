"""nav_msgs/OccupancyGrid as a picture: free is light, occupied dark, unknown transparent. Pure."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PIL import Image

from rosld.adapters.model import Message
from rosld.server.pictures.raw_image import read_field
from rosld.server.pictures.refusal import CannotDraw, require_size

_UNKNOWN = 0
"""The place of what is unknown in the palette: 1 to 101 are the occupancies from 0 to 100."""
_FREE, _OCCUPIED = 246, 24
"""The greys of what is certain."""


def draw_grid(message: Message, width: int | None = None) -> Image.Image:
    """The picture of a grid with its first row below (REP 103), in mode P. Raises CannotDraw.

    At most `width` columns: of the cells that one pixel stands for, the one that is occupied most is drawn.
    """
    info = read_field(message, "info")
    columns, rows = int(read_field(info, "width")), int(read_field(info, "height"))
    cells = np.asarray(read_field(message, "data"))
    require_size(columns, rows)
    if cells.dtype.kind not in "iu" or cells.size != columns * rows:
        words = f"{columns} by {rows} cells are {columns * rows:,}, and data has {cells.size:,}"
        raise CannotDraw(f"The grid contradicts itself: {words}")
    values = np.clip(cells.astype(np.int8, copy=False), -1, 100).reshape(rows, columns)
    factor = shrink_factor(columns, width)
    picture = Image.fromarray((_shrink(values, factor) + 1).astype(np.uint8)[::-1], "P")
    picture.putpalette(_palette())
    picture.info["transparency"] = _UNKNOWN
    return picture


def shrink_factor(columns: int, width: int | None) -> int:
    """The cells of a side of the square that one pixel stands for."""
    return 1 if width is None or columns <= width else -(-columns // width)


def _shrink(values: npt.NDArray[np.int8], factor: int) -> npt.NDArray[np.int8]:
    """Each square of cells as its maximum, so that walls stay; what juts out above and on the right is unknown."""
    if factor == 1:
        return values
    rows, columns = values.shape
    high, wide = -(-rows // factor), -(-columns // factor)
    padded = np.full((high * factor, wide * factor), -1, np.int8)
    padded[:rows, :columns] = values
    found: npt.NDArray[np.int8] = padded.reshape(high, factor, wide, factor).max(axis=(1, 3))
    return found


def _palette() -> bytes:
    greys = [0, *(round(_FREE + (_OCCUPIED - _FREE) * each / 100) for each in range(101))]
    return bytes(grey for each in greys for grey in (each, each, each))
