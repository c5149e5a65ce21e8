"""sensor_msgs/CompressedImage as a picture: JPEG and PNG files, and distances of compressedDepth. Pure."""

from __future__ import annotations

import io
import struct

import numpy as np
import numpy.typing as npt
from PIL import Image

from rosld.server.pictures.colour_map import draw_depth
from rosld.server.pictures.form import JPEG, PNG, DepthRange
from rosld.server.pictures.raw_image import depth_scale, to_bytes
from rosld.server.pictures.refusal import CannotDraw, UnknownPicture, require_size

_MAGIC = ((b"\xff\xd8\xff", JPEG), (b"\x89PNG\r\n\x1a\n", PNG))
_DEPTH_HEADER = struct.Struct("<iff")
"""Of compressed_depth_image_transport: the algorithm, and the two numbers of its quantization."""
_FORMATS = ("JPEG", "PNG")


def file_type(data: bytes) -> str | None:
    """The media type of a file that browsers show as it is, by its first bytes."""
    return next((media_type for magic, media_type in _MAGIC if data.startswith(magic)), None)


def is_depth(format: str) -> bool:
    """Whether the format of a CompressedImage is that of distances, as `16UC1; compressedDepth png`."""
    return "compressedDepth" in format or depth_scale(_encoding(format)) is not None


def draw_compressed(format: str, data: bytes, shown: DepthRange, width: int | None = None) -> Image.Image:
    """The picture of a CompressedImage; of a large JPEG that is to be at most `width` wide a part of the pixels.

    Raises CannotDraw.
    """
    if "compressedDepth" in format:
        return _draw_depth_file(format, data, shown)
    found = _open(data)
    if found.format == "JPEG" and width is not None:
        found.draft(None, (width, max(1, width * found.height // found.width)))
    picture = _load_pixels(found)
    if not picture.mode.startswith("I"):
        return picture
    scale = depth_scale(_encoding(format))
    values = np.asarray(picture)
    if scale is not None:
        return draw_depth(values, scale, shown)
    grey = to_bytes(np.clip(values, 0, 65535).astype(np.uint16))
    return Image.frombuffer("L", picture.size, np.ascontiguousarray(grey), "raw", "L", 0, 1)


def _encoding(format: str) -> str:
    """The encoding of what was compressed: `16UC1` of `16UC1; png compressed`."""
    return format.partition(";")[0].strip()


def _draw_depth_file(format: str, data: bytes, shown: DepthRange) -> Image.Image:
    if "rvl" in format or len(data) <= _DEPTH_HEADER.size:
        raise UnknownPicture("Its format is not drawn: distances are, as compressedDepth png", format)
    _, scale, offset = _DEPTH_HEADER.unpack_from(data)
    picture = _open(data[_DEPTH_HEADER.size :])
    values = np.asarray(_load_pixels(picture))
    if values.ndim != 2:
        raise CannotDraw("The file of a compressedDepth image has colours, so no distances")
    if not _encoding(format).startswith("32FC1"):
        return draw_depth(values, 0.001, shown)
    return draw_depth(_dequantize(values, scale, offset), 1.0, shown)


def _dequantize(values: npt.NDArray[np.generic], scale: float, offset: float) -> npt.NDArray[np.generic]:
    """Metres of inverse distances; 0 is none."""
    numbers = values.astype(np.float32)
    with np.errstate(all="ignore"):
        found: npt.NDArray[np.generic] = np.where(numbers == 0, np.float32("nan"), scale / (numbers - offset))
    return found


def _open(data: bytes) -> Image.Image:
    """The picture of a file, of which only the head is read; one that would be too large is refused."""
    try:
        found = Image.open(io.BytesIO(data), formats=_FORMATS)
    except (OSError, ValueError, SyntaxError, struct.error, Image.DecompressionBombError) as error:
        raise CannotDraw(f"data is no {' or '.join(_FORMATS)} file that can be read") from error
    require_size(found.width, found.height)
    return found


def _load_pixels(picture: Image.Image) -> Image.Image:
    """The pixels in mode L, RGB, RGBA or one of those of 16 bits."""
    try:
        picture.load()
    except (OSError, ValueError, SyntaxError, struct.error) as error:
        raise CannotDraw(f"The file in data cannot be read: {error}") from error
    if picture.mode.startswith("I") or picture.mode in ("L", "RGB", "RGBA"):
        return picture
    return picture.convert("RGBA" if "transparency" in picture.info or picture.mode in ("LA", "PA") else "RGB")
