"""A picture of a message: drawn, made smaller, written as a file. Pure, for a thread."""

from __future__ import annotations

import io

from PIL import Image

from rosld.adapters.model import Message, MessageSchema, Sample
from rosld.server.pictures.compressed_image import draw_compressed, file_type, is_depth
from rosld.server.pictures.form import COMPRESSED_IMAGE, OCCUPANCY_GRID, PNG, RAW_IMAGE, PictureForm
from rosld.server.pictures.occupancy_grid import draw_grid
from rosld.server.pictures.raw_image import ENCODINGS, draw_raw, read_bytes, read_field, read_raw_image
from rosld.server.pictures.refusal import MAX_PIXELS, CannotDraw, UnknownPicture

_QUALITY = 80
_JPEG_SIDE = 65_500
"""Pixels of a side of a JPEG, as libjpeg writes it; the format has room for 65,535."""
_PNG_EFFORT = 1
"""Of zlib: 6 takes six times as long, and the file is 15 % smaller."""


def draw_sample(schema: MessageSchema, sample: Sample, form: PictureForm) -> bytes:
    """The file of a sample's picture. Raises CannotDraw, and ValueError for bytes that are no such message."""
    message = schema.codec.decode(sample.data, sample.encoding)
    if schema.ref.name == COMPRESSED_IMAGE:
        return _compressed(message, form)
    if schema.ref.name == RAW_IMAGE:
        return write_picture(draw_raw(read_raw_image(message), form.shown), form)
    if schema.ref.name == OCCUPANCY_GRID:
        return write_picture(draw_grid(message, form.width), PictureForm(form.media_type))
    raise UnknownPicture(f"A {schema.ref.name} is no picture")


def is_drawable(schema: MessageSchema, message: Message) -> bool:
    """Whether a message says of itself that it can be drawn, by its encoding or first bytes; no pixel is looked at."""
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
    """The file of a picture. Raises UnknownPicture where it has more pixels a side than a JPEG may have."""
    small = _shrink(picture, form.width)
    target = io.BytesIO()
    if form.media_type == PNG:
        small.save(target, "PNG", compress_level=_PNG_EFFORT)
        return target.getvalue()
    if max(small.size) > _JPEG_SIDE:
        words = f"The picture has {small.width} by {small.height} pixels, and a JPEG at most {_JPEG_SIDE} a side"
        raise UnknownPicture(f"{words}: ask for image/png, or for a smaller one by ?width=")
    _without_transparency(small).save(target, "JPEG", quality=_QUALITY)
    return target.getvalue()


def _without_transparency(picture: Image.Image) -> Image.Image:
    """The picture as JPEG can hold it: what is transparent in a palette is grey."""
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
    """The file as it came where that is what is wanted, else one drawn anew."""
    format, data = str(read_field(message, "format")), read_bytes(message).tobytes()
    if form.width is None and file_type(data) == form.media_type and not is_depth(format):
        return data
    return write_picture(draw_compressed(format, data, form.shown, form.width), form)
