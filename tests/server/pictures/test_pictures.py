"""Pictures of all encodings, compared to those of OpenCV from the same bytes with cv_bridge's conversions."""

from __future__ import annotations

import struct
from itertools import product
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosld.server.pictures.picture import draw_compressed, write_picture
from rosld.server.pictures.picture_cache import (
    JPEG,
    MAX_PIXELS,
    PNG,
    CannotDraw,
    DepthRange,
    PictureForm,
    UnknownPicture,
)
from rosld.server.pictures.raw_image import ENCODINGS, RawImage, draw_depth, draw_raw

SHOWN = DepthRange()


def image(encoding: str, values: np.ndarray, *, padding: int = 0, big: bool = False, width: int = 0) -> RawImage:
    """Return an Image whose rows are those of an array, each with this number of bytes of padding."""
    ordered = values.astype(values.dtype.newbyteorder(">" if big else "<"))
    rows = np.ascontiguousarray(ordered).reshape(values.shape[0], -1).view(np.uint8)
    filled = np.pad(rows, ((0, 0), (0, padding)), constant_values=0xA5)
    height = {"nv21": values.shape[0] * 2 // 3, "nv24": values.shape[0] // 3}.get(encoding, values.shape[0])
    data = filled.ravel()
    return RawImage(encoding, width or values.shape[1], height, filled.shape[1], big, data)


def seen(raw: RawImage) -> np.ndarray:
    """Return the picture as OpenCV reads the resulting PNG: BGR, BGRA or grey."""
    file = write_picture(draw_raw(raw), PictureForm(PNG))
    return cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_UNCHANGED)


def as_bytes(values: np.ndarray) -> np.ndarray:
    if values.dtype == np.uint8:
        return values
    if values.dtype.kind == "f":
        return np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8)
    return cv2.convertScaleAbs(values, alpha=255 / 65535)


def random(kind: str, shape: tuple[int, ...], seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    if kind.startswith("f"):
        return generator.uniform(-0.2, 1.2, shape).astype(kind)
    return generator.integers(0, np.iinfo(kind).max, shape, dtype=kind, endpoint=True)


ORDERS = ("rgb", "bgr", "rgba", "bgra")
DEPTHS = (("8U", "u1"), ("16U", "u2"), ("32F", "f4"), ("64F", "f8"))
COLOURS = [
    *((f"{order}{bits}", kind, order) for order in ORDERS for bits, kind in ((8, "u1"), (16, "u2"))),
    *((f"{bits}C{count}", kind, "bgra"[:count]) for bits, kind in DEPTHS for count in (3, 4)),
]


BYTE_ORDERS = (False, True)


def difference(raw: RawImage, expected: np.ndarray) -> int:
    """Return the largest difference of a channel from OpenCV's result."""
    return int(np.abs(seen(raw).astype(int) - expected).max())


def test_colours_are_those_that_opencv_sees() -> None:
    for (encoding, kind, order), big in product(COLOURS, BYTE_ORDERS):
        values = random(kind, (7, 10, len(order)), 3)
        expected = as_bytes(values)[:, :, [order.index(channel) for channel in "bgra"[: len(order)]]]
        assert difference(image(encoding, values, padding=3, big=big), expected) <= (kind != "u1"), (encoding, big)


def test_grey_is_that_which_opencv_sees() -> None:
    for (encoding, kind), big in product((("mono8", "u1"), ("8UC1", "u1"), ("mono16", "u2")), BYTE_ORDERS):
        values = random(kind, (5, 9), 4)
        assert difference(image(encoding, values, padding=5, big=big), as_bytes(values)) <= 1, (encoding, big)


PATTERNS = {"rggb": cv2.COLOR_BayerBG2BGR, "bggr": cv2.COLOR_BayerRG2BGR,
            "gbrg": cv2.COLOR_BayerGR2BGR, "grbg": cv2.COLOR_BayerGB2BGR}  # fmt: skip


def test_bayer_patterns_are_interpolated_as_opencv_does() -> None:
    for (pattern, code), (bits, kind) in product(PATTERNS.items(), ((8, "u1"), (16, "u2"))):
        values = random(kind, (12, 15), 5)
        found = seen(image(f"bayer_{pattern}{bits}", values, padding=2)).astype(int)
        assert np.abs(found - as_bytes(cv2.cvtColor(values, code)))[1:-1, 1:-1].max() <= 1, (pattern, bits)


def test_yuv_of_two_pixels_in_four_bytes_is_what_opencv_sees() -> None:
    codes = {"yuv422": cv2.COLOR_YUV2BGR_UYVY, "uyvy": cv2.COLOR_YUV2BGR_UYVY,
             "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2, "yuyv": cv2.COLOR_YUV2BGR_YUY2}  # fmt: skip
    values = random("u1", (6, 8, 2), 6)
    for encoding, code in codes.items():
        assert difference(image(encoding, values, padding=4), cv2.cvtColor(values, code)) <= 2, encoding


def test_yuv_in_planes_is_what_opencv_sees() -> None:
    values = random("u1", (12, 10), 7)
    expected = cv2.cvtColor(values, cv2.COLOR_YUV2BGR_NV21)
    assert difference(image("nv21", values), expected) <= 2
    luma, colours = random("u1", (6, 8), 8), random("u1", (6, 4, 2), 9)
    planes = np.concatenate([luma, colours.repeat(2, axis=1).reshape(12, 8)])
    chroma = np.stack([colours[:, :, 0], colours[:, :, 1]], axis=-1).reshape(6, 8)
    expected = cv2.cvtColor(np.stack([luma, chroma], axis=-1), cv2.COLOR_YUV2BGR_YUY2)
    assert difference(image("nv24", planes), expected) <= 2


def test_distances_become_darker_and_the_unknown_is_black() -> None:
    metres = np.array([[0.0, 0.5, 2.0, 5.0, 9.9, 50.0, np.nan, np.inf]], dtype="f4")
    colours = np.asarray(draw_depth(metres, 1.0, SHOWN)).astype(int)[0]
    brightness = colours @ (0.299, 0.587, 0.114)
    assert not colours[[0, 6, 7]].any()
    assert all(np.diff(brightness[1:6]) < 0)
    for encoding, values in (
        ("16UC1", np.nan_to_num(metres * 1000, posinf=0).astype("u2")),
        ("16SC1", np.nan_to_num(metres[:, :5] * 1000, posinf=0).astype("i2")),
        ("32SC1", np.nan_to_num(metres * 1000, posinf=0).astype("i4")),
        ("32FC1", metres),
        ("64FC1", metres.astype("f8")),
    ):
        for big in (False, True):
            found = seen(image(encoding, values, big=big))[0, :, ::-1]
            assert np.abs(found.astype(int) - colours[: len(found)]).max() <= 3, encoding
    near = np.asarray(draw_depth(metres, 1.0, DepthRange(0.0, 1.0)))[0]
    assert (near[2] == near[5]).all()


def test_every_encoding_that_is_drawn_is_compared_here() -> None:
    compared = {each[0] for each in COLOURS} | {"mono8", "8UC1", "mono16", "yuv422", "uyvy", "yuv422_yuy2", "yuyv"}
    compared |= {"nv21", "nv24", "16UC1", "16SC1", "32SC1", "32FC1", "64FC1"}
    compared |= {f"bayer_{pattern}{bits}" for pattern in PATTERNS for bits in (8, 16)}
    assert compared == set(ENCODINGS)


def test_what_is_no_picture_is_refused_in_words() -> None:
    good = image("rgb8", random("u1", (4, 6, 3), 1))
    for changes, words in (
        ({"encoding": "8UC2"}, "encoding is not supported; the supported ones are rgb8, bgr8"),
        ({"step": 17}, "a row of 6 pixels of rgb8 takes 18 bytes, but step is 17"),
        ({"height": 5}, "truncated: it needs 90 bytes, but data has 72"),
        ({"width": 0}, "0 by 4 pixels, so there is nothing to show"),
        ({"width": 2**31, "height": 2**31}, f"the limit is {MAX_PIXELS:,}"),
        ({"step": 2**31}, "truncated"),
        ({"encoding": "nv21", "width": 5, "step": 5, "height": 3}, "nv21 has colours for squares"),
        ({"encoding": "uyvy", "width": 5, "step": 10}, "two pixels in four bytes"),
    ):
        fields = {name: getattr(good, name) for name in RawImage.__struct_fields__} | changes
        with pytest.raises(CannotDraw, match=words):
            draw_raw(RawImage(**fields))


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(ENCODINGS),
    st.integers(0, 9) | st.integers(0, 2**32 - 1),
    st.integers(0, 9) | st.integers(0, 2**32 - 1),
    st.integers(0, 80) | st.integers(0, 2**32 - 1),
    st.booleans(),
    st.binary(max_size=700),
)
def test_any_fields_are_drawn_or_refused(
    encoding: str, width: int, height: int, step: int, big: bool, data: bytes
) -> None:
    raw = RawImage(encoding, width, height, step, big, np.frombuffer(data, np.uint8))
    try:
        picture = draw_raw(raw)
    except CannotDraw:
        return
    assert picture.size == (width, height)
    assert cv2.imdecode(np.frombuffer(write_picture(picture, PictureForm(JPEG)), np.uint8), 1).shape[:2] == (
        height,
        width,
    )


def png(values: np.ndarray) -> bytes:
    return cv2.imencode(".png", values)[1].tobytes()


def drawn(format: str, data: bytes, **form: Any) -> np.ndarray:
    return np.asarray(draw_compressed(format, data, SHOWN, **form))


def test_files_of_all_kinds_are_read() -> None:
    colours = cv2.GaussianBlur(random("u1", (240, 320, 3), 2), (21, 21), 0)
    assert (drawn("bgr8; png compressed bgr8", png(colours)) == colours[:, :, ::-1]).all()
    jpeg = cv2.imencode(".jpg", colours)[1].tobytes()
    assert (
        np.abs(drawn("jpeg", jpeg).astype(int) - cv2.imdecode(np.frombuffer(jpeg, np.uint8), 1)[:, :, ::-1]).max() < 9
    )
    assert drawn("jpeg", jpeg, width=80).shape == (60, 80, 3)
    grey = random("u2", (6, 5), 3)
    assert np.abs(drawn("mono16; png compressed mono16", png(grey)).astype(int) - as_bytes(grey)).max() <= 1
    metres = np.array([[0.0, 1.0, 4.0, 8.0]], dtype="f4")
    expected = np.asarray(draw_depth(metres, 1.0, SHOWN)).astype(int)
    millimetres = png((metres * 1000).astype("u2"))
    assert np.abs(drawn("16UC1; png compressed 16UC1", millimetres) - expected).max() <= 3
    assert np.abs(drawn("16UC1; compressedDepth png", struct.pack("<iff", 0, 0, 0) + millimetres) - expected).max() <= 3
    inverse = np.where(metres == 0, 0, 3000 / np.maximum(metres, 0.1) - 5).round().astype("u2")
    quantized = struct.pack("<iff", 1, 3000.0, -5.0) + png(inverse)
    assert np.abs(drawn("32FC1; compressedDepth", quantized) - expected).max() <= 3


HUGE = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">II", 60000, 60000) + b"\x08\0\0\0\0" + bytes(30)


def test_files_that_cannot_be_read_are_refused() -> None:
    for format, data, words in (
        ("jpeg", b"\xff\xd8\xff and then nothing", "not a readable JPEG or PNG file"),
        ("png", b"GIF89a" + bytes(40), "not a readable JPEG or PNG file"),
        ("png", png(np.zeros((9, 9), "u1"))[:-30], "cannot be read"),
        ("png", HUGE, "PNG file|pixels"),
        ("16UC1; compressedDepth rvl", bytes(40), "compressedDepth png"),
        ("16UC1; compressedDepth", bytes(12) + png(np.zeros((3, 3, 3), "u1")), "colours instead of distances"),
    ):
        with pytest.raises(CannotDraw, match=words):
            draw_compressed(format, data, SHOWN)


def test_a_picture_is_made_smaller_and_never_larger() -> None:
    picture = draw_raw(image("rgba8", random("u1", (30, 40, 4), 1)))
    for width, shape in ((20, (15, 20)), (40, (30, 40)), (400, (30, 40)), (1, (1, 1))):
        file = np.frombuffer(write_picture(picture, PictureForm(JPEG, width)), np.uint8)
        assert cv2.imdecode(file, cv2.IMREAD_UNCHANGED).shape == (*shape, 3)
    with pytest.raises(UnknownPicture):
        draw_raw(RawImage("jpeg", 1, 1, 3, False, np.zeros(3, np.uint8)))
