"""Point clouds (sensor_msgs/PointCloud2): positions and colours of selected points, also as PLY. No I/O."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from rosld.adapters.model import MessageSchema, Sample
from rosld.server.pictures.picture_cache import CannotDraw
from rosld.server.runtime.process_memory import PROCESS_MEMORY
from rosld.server.space.transforms import MAX_COORDINATE, Fields, frame_name, read_stamp

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
DEFAULT_POINTS = 20_000
MAX_POINTS = 200_000
_FORMATS = MappingProxyType({1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"})
"""numpy's type codes for the datatypes of sensor_msgs/PointField."""
_INTENSITIES = ("intensity", "intensities", "reflectivity")
"""Names of fields with the intensity of a point, the most common first."""
_MAX_FIELDS = 1000
_PER_POINT = 64
"""Bytes per point while reading: three coordinates as float64, masks, indexes."""

_Column: TypeAlias = "npt.NDArray[np.generic]"


class Cloud(Struct, frozen=True, eq=False):
    """Points of a message, in `frame` at `stamp_ns`.

    `points` are rows of x, y and z in metres; `colours` rows of red, green and blue, and `intensity` one number per
    point, or None. `total` is the number of valid points in the message.
    """

    frame: str
    stamp_ns: int
    points: npt.NDArray[np.float32]
    total: int
    colours: npt.NDArray[np.uint8] | None = None
    intensity: npt.NDArray[np.float32] | None = None


class _Field(Struct, frozen=True):
    offset: int
    format: str


class _Layout(Struct, frozen=True):
    data: npt.NDArray[np.uint8]
    height: int
    width: int
    point_step: int
    row_step: int
    order: str
    fields: Mapping[str, _Field]

    def column(self, name: str, format: str = "") -> _Column:
        """Return the numbers of a field for all points in order; `format` replaces its type."""
        field = self.fields[name]
        kind = np.dtype(self.order + (format or field.format))
        if field.offset + kind.itemsize > self.point_step:
            last = field.offset + kind.itemsize - 1
            raise CannotDraw(f"The field {name!r} reaches to byte {last} of points of {self.point_step} bytes")
        shape, steps = (self.height, self.width), (self.row_step, self.point_step)
        found: _Column = np.ndarray(shape, kind, self.data, field.offset, steps)
        return found.reshape(-1)


def read_cloud(message: Fields, most: int = DEFAULT_POINTS) -> Cloud:
    """Return at most `most` points of a sensor_msgs/PointCloud2. Raises CannotDraw, and ValueError.

    Points that are NaN, infinite or too far away are omitted. Of the others, evenly spaced ones in the order of the
    message are selected, at the same cost for each point: a voxel grid would spread them more evenly in space, but
    sorts all points of each message, several times until they are few enough. The spacing is not an integer, so that no
    whole ring of a scanner or column of a camera is omitted.
    """
    frame, stamp = frame_name(message.header.frame_id), read_stamp(message.header)
    layout = _layout(message)
    if layout is None:
        return Cloud(frame, stamp, np.zeros((0, 3), np.float32), 0)
    for axis in "xyz":
        if axis not in layout.fields:
            raise CannotDraw(f"The points have no field {axis!r}", ", ".join(layout.fields))
    count = layout.height * layout.width
    PROCESS_MEMORY.require(count * _PER_POINT, f"a cloud of {count:,} points")
    with np.errstate(all="ignore"):  # for signalling NaN, and float64 beyond float32
        coordinates = np.stack([layout.column(axis).astype(np.float64) for axis in "xyz"], axis=1)
        valid = np.flatnonzero((np.abs(coordinates) <= MAX_COORDINATE).all(axis=1))  # false for NaN
        picks = valid[_spread(len(valid), most)]
        points = coordinates[picks].astype(np.float32)
        return Cloud(frame, stamp, points, len(valid), _colours(layout, picks), _intensity(layout, picks))


def _spread(count: int, most: int) -> npt.NDArray[np.intp]:
    """Return at most `most` of `count` indexes, evenly spaced, including the first and the last."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).astype(np.intp)


def _layout(message: Fields) -> _Layout | None:
    """Return the layout of points; None without points. Raises CannotDraw for an inconsistent message."""
    height, width = int(message.height), int(message.width)
    point_step, row_step = int(message.point_step), int(message.row_step)
    data = np.frombuffer(np.ascontiguousarray(message.data, np.uint8), np.uint8)
    if height <= 0 or width <= 0:
        return None
    if point_step <= 0:
        raise CannotDraw(f"The points are {point_step} bytes long, so there is nothing to show")
    if height == 1:
        row_step = width * point_step  # the only row ends with its points, whatever row_step is
    if row_step < width * point_step:
        raise CannotDraw(f"Rows of {row_step:,} bytes are too short for {width:,} points of {point_step:,} bytes")
    size = (height - 1) * row_step + width * point_step
    if len(data) < size:
        raise CannotDraw(f"The cloud has {len(data):,} bytes, but {width:,} by {height:,} points need {size:,}")
    fields: dict[str, _Field] = {}
    for each in message.fields[:_MAX_FIELDS]:
        format = _FORMATS.get(int(each.datatype))
        if format is not None:
            fields.setdefault(str(each.name).encode("utf-8", "replace").decode(), _Field(int(each.offset), format))
    return _Layout(data, height, width, point_step, row_step, ">" if message.is_bigendian else "<", fields)


def _colours(layout: _Layout, picks: npt.NDArray[np.intp]) -> npt.NDArray[np.uint8] | None:
    """Return red, green and blue, from one packed field of four bytes as in PCL, or from three fields of a byte."""
    for name in ("rgb", "rgba"):
        if name in layout.fields and layout.fields[name].format in ("f4", "u4", "i4"):
            packed = layout.column(name, "u4")[picks].astype(np.uint32)
            return np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=1).astype(np.uint8)
    if all(each in layout.fields and layout.fields[each].format == "u1" for each in "rgb"):
        return np.stack([layout.column(each)[picks] for each in "rgb"], axis=1).astype(np.uint8)
    return None


def _intensity(layout: _Layout, picks: npt.NDArray[np.intp]) -> npt.NDArray[np.float32] | None:
    name = next((each for each in _INTENSITIES if each in layout.fields), None)
    return None if name is None else layout.column(name)[picks].astype(np.float32)


_NAMES = {"<f4": "float", "|u1": "uchar"}


def draw_cloud(schema: MessageSchema, sample: Sample, most: int) -> bytes:
    """Return the PLY file of at most `most` points of a sample. Raises CannotDraw, ValueError."""
    if schema.ref.name != POINT_CLOUD:
        raise CannotDraw(f"A {schema.ref.name} is not a point cloud")
    message = schema.codec.decode(sample.data, sample.encoding)
    try:
        return cloud_ply(read_cloud(message, most))
    except (AttributeError, TypeError) as error:
        raise CannotDraw(f"The message has other fields than a {schema.ref.name}") from error
    except OverflowError as error:
        raise CannotDraw(f"{error}") from error


def cloud_ply(cloud: Cloud) -> bytes:
    """Return a cloud as binary PLY, little endian: x, y, z; red, green, blue (uchar) and intensity if available."""
    columns: dict[str, npt.NDArray[np.generic]] = {name: cloud.points[:, place] for place, name in enumerate("xyz")}
    if cloud.colours is not None:
        columns |= {name: cloud.colours[:, place] for place, name in enumerate(("red", "green", "blue"))}
    if cloud.intensity is not None:
        columns["intensity"] = cloud.intensity
    kinds = [(name, "|u1" if values.dtype == np.uint8 else "<f4") for name, values in columns.items()]
    rows = np.empty(len(cloud.points), kinds)
    for name, values in columns.items():
        rows[name] = values
    head = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment frame {_one_line(cloud.frame)}",
        f"comment stamp {cloud.stamp_ns} ns",
        f"comment points {len(rows)} of {cloud.total}",
        f"element vertex {len(rows)}",
        *(f"property {_NAMES[kind]} {name}" for name, kind in kinds),
        "end_header",
    ]
    return "".join(f"{line}\n" for line in head).encode("ascii") + rows.tobytes()


def _one_line(text: str) -> str:
    """Return a name in a form that is safe in a line of the ASCII header."""
    return ascii(text)[1:-1]
