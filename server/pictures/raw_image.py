"""Pictures of sensor_msgs/Image in all encodings of `sensor_msgs/image_encodings.h`; depth images in colour. No I/O."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from PIL import Image

from rosld.adapters.model import Message
from rosld.server.pictures.picture_cache import DEFAULT_RANGE, CannotDraw, DepthRange, UnknownPicture, require_size

_ANCHORS = ((255, 238, 150), (252, 170, 60), (222, 80, 60), (150, 40, 120), (70, 45, 160), (25, 45, 95))
"""Colours from the nearest to the farthest at equal intervals, with decreasing brightness."""
_COLOURS = 255


def _palette() -> bytes:
    """Return a palette of 768 bytes: black for unknown distances, then the colours from the nearest to the farthest."""
    places = np.linspace(0, len(_ANCHORS) - 1, _COLOURS)
    anchors = np.array(_ANCHORS, dtype=np.float64)
    channels = [np.interp(places, np.arange(len(_ANCHORS)), anchors[:, channel]) for channel in range(3)]
    colours: npt.NDArray[np.uint8] = np.stack(channels, axis=-1).round().astype(np.uint8)
    return bytes(3) + colours.tobytes()


_PALETTE = _palette()


def draw_depth(depth: npt.NDArray[np.generic], scale: float, shown: DepthRange) -> Image.Image:
    """Return the coloured picture of distances in units of `scale` metres; 0, NaN and infinities are unknown.

    Raises CannotDraw if `shown` is empty.
    """
    if not shown.nearest < shown.farthest:
        raise CannotDraw(f"The range {shown.nearest:g} to {shown.farthest:g} is empty")
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


_RED = {"rggb": (0, 0), "bggr": (1, 1), "gbrg": (1, 0), "grbg": (0, 1)}
"""Row and column of the first red pixel in each pattern."""
PATTERNS = tuple(_RED)


def demosaic(mosaic: npt.NDArray[np.uint8], pattern: str) -> npt.NDArray[np.uint8]:
    """Return red, green and blue of each pixel. The image is mirrored at its edges."""
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


Plane = npt.NDArray[np.uint8]

_VALUES = np.arange(256, dtype=np.float64)
_SHIFT = 5
"""Fraction bits: sums of three terms fit in 16 bits."""


def _table(values: npt.NDArray[np.float64]) -> npt.NDArray[np.int16]:
    return np.round(values * (1 << _SHIFT)).astype(np.int16)


_LUMA = _table(np.maximum(_VALUES - 16, 0) * 1.164) + np.int16(1 << (_SHIFT - 1))
_RED_V = _table((_VALUES - 128) * 1.596)
_GREEN_V = _table((_VALUES - 128) * -0.813)
_GREEN_U = _table((_VALUES - 128) * -0.391)
_BLUE_U = _table((_VALUES - 128) * 2.018)


def convert_yuv(luma: Plane, u: Plane, v: Plane) -> Plane:
    """Return red, green and blue of each pixel; all planes have one value per pixel."""
    brightness = _LUMA[luma]
    channels = (brightness + _RED_V[v], brightness + _GREEN_V[v] + _GREEN_U[u], brightness + _BLUE_U[u])
    found = np.empty((*luma.shape, 3), dtype=np.uint8)
    for number, channel in enumerate(channels):
        found[:, :, number] = np.clip(channel >> _SHIFT, 0, 255)
    return found


def convert_packed(pairs: npt.NDArray[np.uint8], *, luma_first: bool) -> Plane:
    """Convert YUV 4:2:2 in rows of four bytes for two pixels: Y U Y V (`luma_first`) or U Y V Y."""
    first, second = (0, 1) if luma_first else (1, 0)
    luma = pairs[:, :, first::2].reshape(pairs.shape[0], -1)
    u, v = pairs[:, :, second], pairs[:, :, second + 2]
    return convert_yuv(luma, np.repeat(u, 2, axis=1), np.repeat(v, 2, axis=1))


_MILLIMETRES, _METRES = 0.001, 1.0
_ABSTRACT = re.compile(r"(8|16|32|64)([USF])C([0-9]{1,3})")
_KINDS = {"U": "u", "S": "i", "F": "f"}


class RawImage(Struct, frozen=True):
    """Fields of a sensor_msgs/Image."""

    encoding: str
    width: int
    height: int
    step: int
    is_bigendian: bool
    data: npt.NDArray[np.uint8]


def read_raw_image(message: Message) -> RawImage:
    """Return the fields of a message. Raises CannotDraw if they differ, as types of one name may differ."""
    try:
        width, height, step = (int(read_field(message, name)) for name in ("width", "height", "step"))
    except (TypeError, ValueError) as error:
        raise CannotDraw("The message has other fields than a sensor_msgs/Image") from error
    encoding, is_bigendian = str(read_field(message, "encoding")), bool(read_field(message, "is_bigendian"))
    return RawImage(encoding, width, height, step, is_bigendian, read_bytes(message))


def read_field(message: Message, name: str) -> Any:
    """Return the value of a field. Raises CannotDraw if it does not exist."""
    found = getattr(message, name, None)
    if found is None:
        raise CannotDraw(f"The message has no field {name}, as images have")
    return found


def read_bytes(message: Message) -> npt.NDArray[np.uint8]:
    """Return the field `data`. Raises CannotDraw if it is not an array of bytes."""
    found = np.asarray(read_field(message, "data"))
    if found.dtype != np.uint8 or found.ndim != 1:
        raise CannotDraw("The field data of the message is not an array of bytes")
    return np.ascontiguousarray(found)


Draw = Callable[[RawImage, DepthRange], Image.Image]


def draw_raw(image: RawImage, shown: DepthRange = DEFAULT_RANGE) -> Image.Image:
    """Return the picture of an image, in mode L, RGB or RGBA. Raises CannotDraw."""
    draw = _DRAWINGS.get(image.encoding)
    if draw is None:
        raise UnknownPicture(
            f"Its encoding is not supported; the supported ones are {', '.join(_DRAWINGS)}", image.encoding
        )
    require_size(image.width, image.height)
    return draw(image, shown)


def depth_scale(encoding: str) -> float | None:
    """Return the unit of a depth image's encoding in metres, or None for other encodings."""
    return _DEPTHS.get(encoding)


def to_bytes(values: npt.NDArray[np.generic]) -> npt.NDArray[np.uint8]:
    """Return values scaled to bytes: full range of unsigned integers, or floats from 0 to 1; NaN becomes 0."""
    if values.dtype.kind == "f":
        with np.errstate(all="ignore"):
            found: npt.NDArray[np.uint8] = np.round(np.clip(np.nan_to_num(values), 0.0, 1.0) * 255).astype(np.uint8)
        return found
    if values.dtype.itemsize == 1:
        return values.astype(np.uint8, copy=False)
    return ((values.astype(np.uint32) + 128) // 257).astype(np.uint8)


def _pixels(image: RawImage, kind: str, channels: int) -> npt.NDArray[np.generic]:
    """Return a view of the values as rows, columns and channels. Raises CannotDraw for truncated data."""
    item = np.dtype(kind).newbyteorder(">" if image.is_bigendian else "<")
    pixel = item.itemsize * channels
    _require_rows(image, image.width * pixel, image.height)
    shape, strides = (image.height, image.width, channels), (image.step, pixel, item.itemsize)
    found: npt.NDArray[np.generic] = np.ndarray(shape, item, image.data, strides=strides)
    return found


def _require_rows(image: RawImage, row: int, rows: int) -> None:
    if image.step < row:
        words = f"a row of {image.width} pixels of {image.encoding} takes {row} bytes, but step is {image.step}"
        raise CannotDraw(f"The image is inconsistent: {words}")
    needed = image.step * (rows - 1) + row
    if image.data.size < needed:
        raise CannotDraw(f"The image is truncated: it needs {needed:,} bytes, but data has {image.data.size:,}")


def _plain(mode: str, order: str, channels: int) -> Draw:
    """Return a drawing function for 8 bits per channel, which Pillow can read directly."""

    def draw(image: RawImage, _: DepthRange) -> Image.Image:
        _require_rows(image, image.width * channels, image.height)
        data, step = image.data, image.step
        if data.size < step * image.height:  # the padding of the last row may be missing
            rows: npt.NDArray[np.uint8] = np.ndarray(
                (image.height, image.width * channels), np.uint8, data, strides=(step, 1)
            )
            data, step = np.ascontiguousarray(rows), image.width * channels
        return Image.frombuffer(mode, (image.width, image.height), data, "raw", order, step, 1)

    return draw


def _channels(kind: str, order: str) -> Draw:
    """Return a drawing function for more than 8 bits per channel; `order` is RGB, BGR, RGBA or BGRA."""
    mode = "RGBA" if len(order) == 4 else "RGB"
    places = [order.index(channel) for channel in mode]

    def draw(image: RawImage, _: DepthRange) -> Image.Image:
        return _picture(to_bytes(_pixels(image, kind, len(order))[:, :, places]), mode)

    return draw


def _picture(values: npt.NDArray[np.uint8], mode: str) -> Image.Image:
    size = (values.shape[1], values.shape[0])
    return Image.frombuffer(mode, size, np.ascontiguousarray(values), "raw", mode, 0, 1)


def _grey16(image: RawImage, _: DepthRange) -> Image.Image:
    return _picture(to_bytes(_pixels(image, "u2", 1)[:, :, 0]), "L")


def _distances(kind: str, scale: float) -> Draw:
    def draw(image: RawImage, shown: DepthRange) -> Image.Image:
        return draw_depth(_pixels(image, kind, 1)[:, :, 0], scale, shown)

    return draw


def _bayer(kind: str, pattern: str) -> Draw:
    def draw(image: RawImage, _: DepthRange) -> Image.Image:
        return _picture(demosaic(to_bytes(_pixels(image, kind, 1)[:, :, 0]), pattern), "RGB")

    return draw


def _packed(*, luma_first: bool) -> Draw:
    def draw(image: RawImage, _: DepthRange) -> Image.Image:
        if image.width % 2:
            raise CannotDraw(f"{image.encoding} has two pixels in four bytes, but the image is {image.width} wide")
        values = _pixels(image, "u1", 2).astype(np.uint8, copy=False)
        pairs = np.ascontiguousarray(values).reshape(image.height, image.width // 2, 4)
        return _picture(convert_packed(pairs, luma_first=luma_first), "RGB")

    return draw


def _planes(image: RawImage, rows: int) -> npt.NDArray[np.uint8]:
    """Return rows of bytes as wide as the picture."""
    _require_rows(image, image.width, rows)
    return _rows(image, image.width, rows)


def _rows(image: RawImage, row: int, rows: int) -> npt.NDArray[np.uint8]:
    found: npt.NDArray[np.uint8] = np.ndarray((rows, row), np.uint8, image.data, strides=(image.step, 1))
    return found


def _nv21(image: RawImage, _: DepthRange) -> Image.Image:
    if image.width % 2 or image.height % 2:
        raise CannotDraw(f"nv21 has colours for squares of four pixels: {image.width} by {image.height} has none")
    planes = _planes(image, image.height * 3 // 2)
    colours = planes[image.height :].repeat(2, axis=0)
    v, u = colours[:, 0::2].repeat(2, axis=1), colours[:, 1::2].repeat(2, axis=1)
    return _picture(convert_yuv(planes[: image.height], u, v), "RGB")


def _nv24(image: RawImage, _: DepthRange) -> Image.Image:
    """Draw rows of luma, followed by rows with two chroma values per pixel, of twice the size."""
    planes = _planes(image, image.height * 3)
    colours = planes[image.height :].reshape(image.height, image.width, 2)
    return _picture(convert_yuv(planes[: image.height], colours[:, :, 0], colours[:, :, 1]), "RGB")


_DEPTHS = {
    "16UC1": _MILLIMETRES,
    "16SC1": _MILLIMETRES,
    "32SC1": _MILLIMETRES,
    "32FC1": _METRES,
    "64FC1": _METRES,
}


def _drawings() -> Mapping[str, Draw]:
    found: dict[str, Draw] = {
        "rgb8": _plain("RGB", "RGB", 3),
        "bgr8": _plain("RGB", "BGR", 3),
        "rgba8": _plain("RGBA", "RGBA", 4),
        "bgra8": _plain("RGBA", "BGRA", 4),
        "mono8": _plain("L", "L", 1),
        "rgb16": _channels("u2", "RGB"),
        "bgr16": _channels("u2", "BGR"),
        "rgba16": _channels("u2", "RGBA"),
        "bgra16": _channels("u2", "BGRA"),
        "mono16": _grey16,
        "8UC1": _plain("L", "L", 1),
        "8UC3": _plain("RGB", "BGR", 3),
        "8UC4": _plain("RGBA", "BGRA", 4),
    }
    for bits, kind in (("16U", "u2"), ("32F", "f4"), ("64F", "f8")):
        found[f"{bits}C3"] = _channels(kind, "BGR")
        found[f"{bits}C4"] = _channels(kind, "BGRA")
    for encoding, scale in _DEPTHS.items():
        match = _ABSTRACT.fullmatch(encoding)
        assert match is not None
        found[encoding] = _distances(f"{_KINDS[match[2]]}{int(match[1]) // 8}", scale)
    for pattern in PATTERNS:
        found[f"bayer_{pattern}8"] = _bayer("u1", pattern)
        found[f"bayer_{pattern}16"] = _bayer("u2", pattern)
    for name in ("yuv422", "uyvy"):
        found[name] = _packed(luma_first=False)
    for name in ("yuv422_yuy2", "yuyv"):
        found[name] = _packed(luma_first=True)
    found |= {"nv21": _nv21, "nv24": _nv24}
    return MappingProxyType(found)


_DRAWINGS = _drawings()
ENCODINGS = tuple(_DRAWINGS)
"""Supported encodings."""
