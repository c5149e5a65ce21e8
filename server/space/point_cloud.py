"""Point clouds (sensor_msgs/PointCloud2): positions and colours of their points, thinned, or as PLY. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from rosld.adapters.model import MessageSchema, Sample
from rosld.server.pictures.form import CannotDraw
from rosld.server.runtime.process_memory import PROCESS_MEMORY
from rosld.server.space.transform import MAX_COORDINATE, Fields, frame_name, read_stamp

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
DEFAULT_POINTS = 20_000
MAX_POINTS = 200_000
_FORMATS = MappingProxyType({1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"})
"""numpy's codes of the datatypes of sensor_msgs/PointField."""
_INTENSITIES = ("intensity", "intensities", "reflectivity")
"""Fields that say how much came back from a point, the best known first."""
_MAX_FIELDS = 1000
_PER_POINT = 64
"""Bytes that a point takes while it is read: three coordinates as float64, masks, places."""

_Column: TypeAlias = "npt.NDArray[np.generic]"


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points of a message, in `frame` at `stamp_ns`.

    `points` are rows of x, y and z in metres; `colours` rows of red, green and blue, `intensity` one number each, None
    where there are none. `total` is how many points the message has that are places.
    """

    frame: str
    stamp_ns: int
    points: npt.NDArray[np.float32]
    total: int
    colours: npt.NDArray[np.uint8] | None = None
    intensity: npt.NDArray[np.float32] | None = None


@dataclass(frozen=True, slots=True)
class _Field:
    """Offset and type of a number in a point."""

    offset: int
    format: str


@dataclass(frozen=True, slots=True)
class _Layout:
    """Layout of points in the data of a message."""

    data: npt.NDArray[np.uint8]
    height: int
    width: int
    point_step: int
    row_step: int
    order: str
    fields: Mapping[str, _Field]

    def column(self, name: str, format: str = "") -> _Column:
        """Return the numbers of a field, of all points in their order; `format` reads its bytes as something else."""
        field = self.fields[name]
        kind = np.dtype(self.order + (format or field.format))
        if field.offset + kind.itemsize > self.point_step:
            last = field.offset + kind.itemsize - 1
            raise CannotDraw(f"The field {name!r} reaches to byte {last} of points of {self.point_step} bytes")
        shape, steps = (self.height, self.width), (self.row_step, self.point_step)
        found: _Column = np.ndarray(shape, kind, self.data, field.offset, steps)
        return found.reshape(-1)


def read_cloud(message: Fields, most: int = DEFAULT_POINTS) -> Cloud:
    """At most so many points of a sensor_msgs/PointCloud2. Raises CannotDraw, and ValueError.

    Points that are NaN, infinite or beyond all places are left out. Evenly spaced ones of the others, in the order of
    the message, remain, which costs the same for each point: a voxel grid spreads them more evenly in space, but
    sorts all points of each message, several times until they are few enough. The spacing is no whole number, so that
    no ring of a scanner and no column of a camera is left out as a whole.
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
    with np.errstate(all="ignore"):  # signalling NaN, and float64 beyond float32
        coordinates = np.stack([layout.column(axis).astype(np.float64) for axis in "xyz"], axis=1)
        valid = np.flatnonzero((np.abs(coordinates) <= MAX_COORDINATE).all(axis=1))  # false of NaN
        picks = valid[_spread(len(valid), most)]
        points = coordinates[picks].astype(np.float32)
        return Cloud(frame, stamp, points, len(valid), _colours(layout, picks), _intensity(layout, picks))


def _spread(count: int, most: int) -> npt.NDArray[np.intp]:
    """At most `most` of `count` places, evenly, with the first and the last."""
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
        raise CannotDraw(f"The points are {point_step} bytes long, so there is nothing to be seen")
    if height == 1:
        row_step = width * point_step  # the only row ends where its points end, whatever is said of it
    if row_step < width * point_step:
        raise CannotDraw(f"Rows of {row_step:,} bytes cannot hold {width:,} points of {point_step:,} bytes")
    size = (height - 1) * row_step + width * point_step
    if len(data) < size:
        raise CannotDraw(f"The cloud has {len(data):,} bytes, and {width:,} by {height:,} points need {size:,}")
    fields: dict[str, _Field] = {}
    for each in message.fields[:_MAX_FIELDS]:
        format = _FORMATS.get(int(each.datatype))
        if format is not None:
            fields.setdefault(str(each.name).encode("utf-8", "replace").decode(), _Field(int(each.offset), format))
    return _Layout(data, height, width, point_step, row_step, ">" if message.is_bigendian else "<", fields)


def _colours(layout: _Layout, picks: npt.NDArray[np.intp]) -> npt.NDArray[np.uint8] | None:
    """Red, green and blue: packed into one field of four bytes, as PCL has it, or a field of a byte each."""
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
    """The PLY file of at most so many points of a sample. Raises CannotDraw, and ValueError for what is no message."""
    if schema.ref.name != POINT_CLOUD:
        raise CannotDraw(f"A {schema.ref.name} is no point cloud")
    message = schema.codec.decode(sample.data, sample.encoding)
    try:
        return cloud_ply(read_cloud(message, most))
    except (AttributeError, TypeError) as error:
        raise CannotDraw(f"The message has other fields than a {schema.ref.name}") from error
    except OverflowError as error:
        raise CannotDraw(f"{error}") from error


def cloud_ply(cloud: Cloud) -> bytes:
    """A cloud as binary PLY, little endian: x, y, z; red, green, blue as uchar; intensity. Of these what there is."""
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
    """Return a name as the header, which is ASCII by lines, can hold it."""
    return ascii(text)[1:-1]
