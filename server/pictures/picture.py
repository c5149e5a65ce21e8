"""Pictures of messages (images, compressed images, grids): drawn, resized, encoded. No I/O; runs in a thread."""

from __future__ import annotations

import io
import struct

import numpy as np
import numpy.typing as npt
from PIL import Image

from rosld.adapters.model import Message, MessageSchema, Sample
from rosld.server.pictures.picture_cache import (
    COMPRESSED_IMAGE,
    JPEG,
    MAX_PIXELS,
    OCCUPANCY_GRID,
    PNG,
    RAW_IMAGE,
    CannotDraw,
    DepthRange,
    PictureForm,
    UnknownPicture,
    require_size,
)
from rosld.server.pictures.raw_image import (
    ENCODINGS,
    depth_scale,
    draw_depth,
    draw_raw,
    read_bytes,
    read_field,
    read_raw_image,
    to_bytes,
)

_UNKNOWN = 0
"""Palette index of unknown cells; 1 to 101 are the occupancies from 0 to 100."""
_FREE, _OCCUPIED = 246, 24
"""Grey levels of free and occupied cells."""


def draw_grid(message: Message, width: int | None = None) -> Image.Image:
    """Return the picture of a grid with its first row at the bottom (REP 103), in mode P. Raises CannotDraw.

    At most `width` columns: a pixel for several cells shows the most occupied one.
    """
    info = read_field(message, "info")
    columns, rows = int(read_field(info, "width")), int(read_field(info, "height"))
    cells = np.asarray(read_field(message, "data"))
    require_size(columns, rows)
    if cells.dtype.kind not in "iu" or cells.size != columns * rows:
        words = f"{columns} by {rows} cells are {columns * rows:,}, but data has {cells.size:,}"
        raise CannotDraw(f"The grid is inconsistent: {words}")
    values = np.clip(cells.astype(np.int8, copy=False), -1, 100).reshape(rows, columns)
    factor = shrink_factor(columns, width)
    picture = Image.fromarray((_shrink_grid(values, factor) + 1).astype(np.uint8)[::-1], "P")
    picture.putpalette(_palette())
    picture.info["transparency"] = _UNKNOWN
    return picture


def shrink_factor(columns: int, width: int | None) -> int:
    """Return the side of the square of cells that is drawn as one pixel."""
    return 1 if width is None or columns <= width else -(-columns // width)


def _shrink_grid(values: npt.NDArray[np.int8], factor: int) -> npt.NDArray[np.int8]:
    """Return the maximum of each square of cells, so that walls are preserved; cells beyond the edges are unknown."""
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


_MAGIC = ((b"\xff\xd8\xff", JPEG), (b"\x89PNG\r\n\x1a\n", PNG))
_DEPTH_HEADER = struct.Struct("<iff")
"""Header of compressed_depth_image_transport: the algorithm, and the two parameters of its quantization."""
_FORMATS = ("JPEG", "PNG")


def file_type(data: bytes) -> str | None:
    """Return the media type of a file that browsers can show, by its first bytes, or None."""
    return next((media_type for magic, media_type in _MAGIC if data.startswith(magic)), None)


def is_depth(format: str) -> bool:
    """Whether the format of a CompressedImage is a depth image, such as `16UC1; compressedDepth png`."""
    return "compressedDepth" in format or depth_scale(_encoding(format)) is not None


def draw_compressed(format: str, data: bytes, shown: DepthRange, width: int | None = None) -> Image.Image:
    """Return the picture of a CompressedImage. A large JPEG is decoded at a lower resolution of at least `width`.

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
    """Return the encoding of the original image: `16UC1` for `16UC1; png compressed`."""
    return format.partition(";")[0].strip()


def _draw_depth_file(format: str, data: bytes, shown: DepthRange) -> Image.Image:
    if "rvl" in format or len(data) <= _DEPTH_HEADER.size:
        raise UnknownPicture("Its format is not supported: use compressedDepth png for distances", format)
    _, scale, offset = _DEPTH_HEADER.unpack_from(data)
    picture = _open(data[_DEPTH_HEADER.size :])
    values = np.asarray(_load_pixels(picture))
    if values.ndim != 2:
        raise CannotDraw("The file of a compressedDepth image has colours instead of distances")
    if not _encoding(format).startswith("32FC1"):
        return draw_depth(values, 0.001, shown)
    return draw_depth(_dequantize(values, scale, offset), 1.0, shown)


def _dequantize(values: npt.NDArray[np.generic], scale: float, offset: float) -> npt.NDArray[np.generic]:
    """Return metres for quantized inverse distances; 0 is unknown."""
    numbers = values.astype(np.float32)
    with np.errstate(all="ignore"):
        found: npt.NDArray[np.generic] = np.where(numbers == 0, np.float32("nan"), scale / (numbers - offset))
    return found


def _open(data: bytes) -> Image.Image:
    """Open a picture file, reading only its header. Raises CannotDraw if it is too large."""
    try:
        found = Image.open(io.BytesIO(data), formats=_FORMATS)
    except (OSError, ValueError, SyntaxError, struct.error, Image.DecompressionBombError) as error:
        raise CannotDraw(f"data is not a readable {' or '.join(_FORMATS)} file") from error
    require_size(found.width, found.height)
    return found


def _load_pixels(picture: Image.Image) -> Image.Image:
    """Return the picture in mode L, RGB, RGBA or one with 16 bits."""
    try:
        picture.load()
    except (OSError, ValueError, SyntaxError, struct.error) as error:
        raise CannotDraw(f"The file in data cannot be read: {error}") from error
    if picture.mode.startswith("I") or picture.mode in ("L", "RGB", "RGBA"):
        return picture
    return picture.convert("RGBA" if "transparency" in picture.info or picture.mode in ("LA", "PA") else "RGB")


_QUALITY = 80
_JPEG_SIDE = 65_500
"""Maximum side of a JPEG in pixels for libjpeg; the format allows 65,535."""
_PNG_EFFORT = 1
"""Compression level of zlib: 6 takes six times as long for a file that is 15 % smaller."""


def draw_sample(schema: MessageSchema, sample: Sample, form: PictureForm) -> bytes:
    """Return the file of a sample's picture. Raises CannotDraw, and ValueError for undecodable bytes."""
    message = schema.codec.decode(sample.data, sample.encoding)
    if schema.ref.name == COMPRESSED_IMAGE:
        return _compressed(message, form)
    if schema.ref.name == RAW_IMAGE:
        return write_picture(draw_raw(read_raw_image(message), form.shown), form)
    if schema.ref.name == OCCUPANCY_GRID:
        return write_picture(draw_grid(message, form.width), PictureForm(form.media_type))
    raise UnknownPicture(f"A {schema.ref.name} is not a picture")


def is_drawable(schema: MessageSchema, message: Message) -> bool:
    """Whether a message can be drawn, judging by its encoding or first bytes, without decoding pixels."""
    try:
        if schema.ref.name == COMPRESSED_IMAGE:
            format = str(read_field(message, "format"))
            is_file = file_type(read_bytes(message)[:16].tobytes()) is not None
            return is_file or (is_depth(format) and "rvl" not in format)
        if schema.ref.name == RAW_IMAGE:
            image = read_raw_image(message)
            return image.encoding in ENCODINGS and 0 < image.width * image.height <= MAX_PIXELS
        if schema.ref.name == OCCUPANCY_GRID:
            info = read_field(message, "info")
            return 0 < int(read_field(info, "width")) * int(read_field(info, "height")) <= MAX_PIXELS
        return False
    except CannotDraw:
        return False


def write_picture(picture: Image.Image, form: PictureForm) -> bytes:
    """Return the file of a picture. Raises UnknownPicture if it is too large for a JPEG."""
    small = _shrink(picture, form.width)
    target = io.BytesIO()
    if form.media_type == PNG:
        small.save(target, "PNG", compress_level=_PNG_EFFORT)
        return target.getvalue()
    if max(small.size) > _JPEG_SIDE:
        words = f"The picture has {small.width} by {small.height} pixels, but a JPEG has at most {_JPEG_SIDE} per side"
        raise UnknownPicture(f"{words}: ask for image/png, or for a smaller one by ?width=")
    _without_transparency(small).save(target, "JPEG", quality=_QUALITY)
    return target.getvalue()


def _without_transparency(picture: Image.Image) -> Image.Image:
    """Return the picture without transparency, for JPEG: transparent palette colours become grey."""
    if picture.mode == "P":
        opaque = Image.new("RGB", picture.size, (128, 128, 128))
        coloured = picture.convert("RGBA")
        opaque.paste(coloured, mask=coloured.getchannel("A"))
        return opaque
    return picture.convert("RGB") if picture.mode == "RGBA" else picture


def _shrink(picture: Image.Image, width: int | None) -> Image.Image:
    if width is None or width >= picture.width:
        return picture
    height = max(1, round(picture.height * width / picture.width))
    return picture.resize((width, height), Image.Resampling.BOX)


def _compressed(message: Message, form: PictureForm) -> bytes:
    """Return the original file if it has the requested form, else a new one."""
    format, data = str(read_field(message, "format")), read_bytes(message).tobytes()
    if form.width is None and file_type(data) == form.media_type and not is_depth(format):
        return data
    return write_picture(draw_compressed(format, data, form.shown, form.width), form)
