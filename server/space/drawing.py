"""Drawings of messages: points, a line, arrows, or a grid, each in its frame. No I/O; runs in a thread."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from rosld.adapters.model import MessageSchema, Sample
from rosld.server.pictures.picture_cache import CannotDraw
from rosld.server.space.point_cloud import POINT_CLOUD, read_cloud
from rosld.server.space.transforms import (
    Fields,
    Transform,
    frame_name,
    read_pose,
    read_stamp,
    read_vector,
    require_place,
)

Points: TypeAlias = "npt.NDArray[np.float64]"
"""Rows of x, y and z in metres."""
MAX_POINTS = 4000
"""Maximum number of drawn points or arrows; of more, every n-th is drawn, including the last."""
_ONE_SIGMA = 1.0
_DIGITS = 3
"""Number of decimals of coordinates in metres: millimetres."""


class Ellipse(Struct, frozen=True):
    """Uncertainty of a position: the semi-axes, one standard deviation each, and the direction of the first."""

    major: float
    minor: float
    angle: float


class Grid(Struct, frozen=True):
    """Ground area of a grid's picture: its lower left corner, and its sides in metres and in cells."""

    origin: Transform
    resolution: float
    columns: int
    rows: int


class Drawing(Struct, frozen=True, eq=False):
    """Drawing of a message, in `frame` at `stamp_ns`. `has_trace`: its arrow leaves a trace of former positions."""

    frame: str
    stamp_ns: int
    points: Points | None = None
    line: Points | None = None
    is_closed: bool = False
    arrows: tuple[Transform, ...] = ()
    ellipse: Ellipse | None = None
    grid: Grid | None = None
    has_trace: bool = False


class _Kind(Struct, frozen=True):
    label: str
    draw: Callable[[Fields], Drawing]


def can_place(type_name: str) -> bool:
    """Whether messages of a type can be drawn in space."""
    return type_name in _KINDS


def kind_label(type_name: str) -> str:
    """Return the label of a message type."""
    return _KINDS[type_name].label


def place_sample(schema: MessageSchema, sample: Sample) -> Drawing:
    """Return the drawing of a sample. Raises CannotDraw, and ValueError for undecodable bytes."""
    kind = _KINDS.get(schema.ref.name)
    if kind is None:
        raise CannotDraw(f"A {schema.ref.name} cannot be drawn in space")
    message = schema.codec.decode(sample.data, sample.encoding)
    try:
        return kind.draw(message)
    except CannotDraw:
        raise
    except (AttributeError, TypeError) as error:
        raise CannotDraw(f"The message has other fields than a {schema.ref.name}") from error
    except (ValueError, OverflowError) as error:
        raise CannotDraw(f"{error}") from error


def drawing_json(drawing: Drawing) -> dict[str, object]:
    """Return a drawing as JSON: coordinates as columns, poses as from `pose_json`; missing parts are omitted."""
    found: dict[str, object] = {}
    if drawing.points is not None:
        found["points"] = _columns(drawing.points)
    if drawing.line is not None:
        found["line"] = _columns(drawing.line) | {"closed": drawing.is_closed}
    if drawing.arrows:
        found["arrows"] = [pose_json(each) for each in drawing.arrows]
    if drawing.ellipse is not None:
        found["ellipse"] = [drawing.ellipse.major, drawing.ellipse.minor, drawing.ellipse.angle]
    if drawing.grid is not None:
        grid = drawing.grid
        sides = [grid.resolution * grid.columns, grid.resolution * grid.rows]
        found["grid"] = {"origin": pose_json(grid.origin), "size": sides}
    if drawing.has_trace:
        found["trace"] = True
    return found


def pose_json(pose: Transform) -> list[float]:
    """Return a pose as seven numbers: x, y, z, and the quaternion's x, y, z, w."""
    return [
        *(round(each, _DIGITS) for each in pose.translation),
        *(round(each, _DIGITS + 3) for each in pose.rotation),
    ]


def thin(places: npt.NDArray[np.intp], most: int = MAX_POINTS) -> npt.NDArray[np.intp]:
    """Return at most `most` items, evenly spaced, including the last."""
    if len(places) <= most:
        return places
    return places[::-1][:: -(-len(places) // most)][::-1]


def _columns(points: Points) -> dict[str, object]:
    """Return coordinates as columns, without z if all points are on the frame's ground."""
    rounded = np.round(points, _DIGITS)
    x, y, z = (np.ascontiguousarray(rounded[:, column]) for column in range(3))
    return {"x": x, "y": y, "z": z} if z.any() else {"x": x, "y": y}


def _header(message: Fields) -> tuple[str, int]:
    return frame_name(message.header.frame_id), read_stamp(message.header)


def _scan(message: Fields) -> Drawing:
    """Draw a sensor_msgs/LaserScan. Ranges beyond the limits, infinite ones and NaN are not points (REP 117)."""
    ranges = np.asarray(message.ranges, np.float64)
    first, step = float(message.angle_min), float(message.angle_increment)
    nearest, farthest = float(message.range_min), float(message.range_max)
    if not (math.isfinite(first) and math.isfinite(step)):
        raise CannotDraw("The angles of the scan are not numbers")
    places = thin(np.flatnonzero(np.isfinite(ranges) & (ranges >= nearest) & (ranges <= farthest)))
    angles, distances = first + step * places, ranges[places]
    points = np.column_stack((distances * np.cos(angles), distances * np.sin(angles), np.zeros(len(places))))
    return Drawing(*_header(message), points=points)


def _cloud(message: Fields) -> Drawing:
    """Draw a sensor_msgs/PointCloud2, without colours."""
    cloud = read_cloud(message, MAX_POINTS)
    return Drawing(cloud.frame, cloud.stamp_ns, points=cloud.points.astype(np.float64))


def _grid(message: Fields) -> Drawing:
    """Draw a nav_msgs/OccupancyGrid, whose cells are a separate picture."""
    info = message.info
    columns, rows, resolution = int(info.width), int(info.height), float(info.resolution)
    if not (math.isfinite(resolution) and resolution > 0):
        raise CannotDraw(f"The cells of the grid are {resolution:g} m wide")
    require_place(columns * resolution, rows * resolution)
    return Drawing(*_header(message), grid=Grid(read_pose(info.origin), resolution, columns, rows))


def _path(message: Fields) -> Drawing:
    """Draw a nav_msgs/Path. Poses are in the frame of the path, because their own frames are often empty."""
    poses = message.poses
    points = [poses[place].pose.position for place in _places(len(poses))]
    return Drawing(*_header(message), line=_points(points))


def _polygon(message: Fields) -> Drawing:
    """Draw a geometry_msgs/PolygonStamped."""
    corners = message.polygon.points
    return Drawing(*_header(message), line=_points([corners[place] for place in _places(len(corners))]), is_closed=True)


def _point(message: Fields) -> Drawing:
    """Draw a geometry_msgs/PointStamped."""
    return Drawing(*_header(message), points=_points([message.point]))


def _pose(message: Fields) -> Drawing:
    """Draw a geometry_msgs/PoseStamped."""
    return Drawing(*_header(message), arrows=(read_pose(message.pose),))


def _poses(message: Fields) -> Drawing:
    """Draw a geometry_msgs/PoseArray."""
    poses = message.poses
    return Drawing(*_header(message), arrows=tuple(read_pose(poses[place]) for place in _places(len(poses))))


def _likely_pose(message: Fields) -> Drawing:
    """Draw a geometry_msgs/PoseWithCovarianceStamped."""
    return Drawing(*_header(message), arrows=(read_pose(message.pose.pose),), ellipse=_ellipse(message.pose.covariance))


def _odometry(message: Fields) -> Drawing:
    """Draw a nav_msgs/Odometry."""
    return Drawing(
        *_header(message),
        arrows=(read_pose(message.pose.pose),),
        ellipse=_ellipse(message.pose.covariance),
        has_trace=True,
    )


def _places(count: int) -> list[int]:
    return [int(each) for each in thin(np.arange(count))]


def _points(found: list[Fields]) -> Points:
    return np.array([read_vector(each) for each in found], np.float64).reshape(-1, 3)


def _ellipse(covariance: Fields) -> Ellipse | None:
    """Return the ellipse of x and y of a covariance matrix (six by six), or None if it is unset or invalid."""
    values = np.asarray(covariance, np.float64)
    if values.size != 36:
        return None
    flat = values.reshape(6, 6)[:2, :2]
    if not np.isfinite(flat).all() or not flat.any() or abs(flat).max() > 1e4:
        return None
    lengths, directions = np.linalg.eigh((flat + flat.T) / 2)
    if lengths[0] < -1e-9:
        return None
    minor, major = (round(_ONE_SIGMA * math.sqrt(max(each, 0.0)), 4) for each in lengths)
    return Ellipse(major, minor, round(math.atan2(directions[1, 1], directions[0, 1]), 4))


_KINDS: Mapping[str, _Kind] = MappingProxyType(
    {
        "nav_msgs/msg/OccupancyGrid": _Kind("Occupancy grid", _grid),
        POINT_CLOUD: _Kind("Point cloud", _cloud),
        "nav_msgs/msg/Path": _Kind("Path", _path),
        "geometry_msgs/msg/PolygonStamped": _Kind("Polygon", _polygon),
        "sensor_msgs/msg/LaserScan": _Kind("Laser scan", _scan),
        "geometry_msgs/msg/PointStamped": _Kind("Point", _point),
        "geometry_msgs/msg/PoseArray": _Kind("Poses", _poses),
        "geometry_msgs/msg/PoseStamped": _Kind("Pose", _pose),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _Kind("Pose with covariance", _likely_pose),
        "nav_msgs/msg/Odometry": _Kind("Odometry", _odometry),
    }
)
"""Drawing functions by message type, from the lowest layer to the highest."""
PLACED_TYPES = tuple(_KINDS)
