"""Messages of the rover, as the fields of ROS 2's standard messages (common_interfaces, tf2_msgs). No I/O.

A message is a dict of all its fields, including nested ones; a time is `{"sec": ..., "nanosec": ...}`, an array of
numbers is a numpy array. The nodes of `tests/rover` convert them to the messages of their ROS version.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.rover.drive import CAPACITY, CELLS, Motion, wheel_speeds
from rosld.adapters.rover.navigation import Journey, JourneyEnd, Pose, remaining_length
from rosld.adapters.rover.planner import RESOLUTION, grid_of
from rosld.adapters.rover.settings import NODE, Settings
from rosld.adapters.rover.simulation import LogLine, State
from rosld.adapters.rover.world import WALL_HEIGHT, World

WIDTH = 160
HEIGHT = 120
FOCAL_LENGTH = 140.0
"""Focal length of both axes in pixels: a horizontal view of 60 degrees."""
CENTRE = (WIDTH / 2, HEIGHT / 2)
MOUNTED_AT = 0.3
"""Height of the camera above the floor, in metres."""
_NEAREST = 0.05
_DARK, _LIT = 0.55, 1.0
_FADING = 0.12
"""Decrease of brightness per metre."""
_CEILING = (214, 224, 232)
_FLOOR = (116, 112, 106)
_BEARINGS = np.arctan2(CENTRE[0] - 0.5 - np.arange(WIDTH), FOCAL_LENGTH)
_BELOW = np.arange(HEIGHT)[:, None] + 0.5 - CENTRE[1]
"""Distance in pixels of the centre of each row below the horizon."""


def image(world: World, motion: Motion, lights: bool) -> NDArray[np.uint8]:
    """Return an image of `HEIGHT` rows, `WIDTH` columns, and red, green and blue."""
    hits = world.cast(motion.x, motion.y, motion.heading + _BEARINGS)
    depths = np.maximum(hits.distances * np.cos(_BEARINGS), _NEAREST)
    top, bottom = FOCAL_LENGTH * (MOUNTED_AT - WALL_HEIGHT) / depths, FOCAL_LENGTH * MOUNTED_AT / depths
    is_wall = (top <= _BELOW) & (bottom >= _BELOW)
    floor = FOCAL_LENGTH * MOUNTED_AT / np.maximum(_BELOW, 1.0)
    pixels = np.where((_BELOW > 0)[:, :, None], _FLOOR * _light(floor, lights)[:, :, None], _CEILING)
    walls = hits.colours * _light(depths, lights)[:, None]
    frame: NDArray[np.uint8] = np.where(is_wall[:, :, None], walls[None, :, :], pixels).astype(np.uint8)
    return frame


def _light(distances: NDArray[np.float64], lights: bool) -> NDArray[np.float64]:
    """Return the brightness at these distances, from 0 to 1."""
    brightness: NDArray[np.float64] = (_LIT if lights else _DARK) / (1 + _FADING * distances)
    return brightness


BEAMS = 360
FIRST = -math.pi
"""Direction of the first beam: straight back."""
INCREMENT = math.tau / BEAMS
NEAREST = 0.05
FARTHEST = 8.0
_ANGLES: NDArray[np.float64] = FIRST + INCREMENT * np.arange(BEAMS, dtype=np.float64)


def scan(world: World, motion: Motion) -> NDArray[np.float32]:
    """Return the distance that each beam measures; inf if it is out of range (REP 117)."""
    distances = world.cast(motion.x, motion.y, motion.heading + _ANGLES).distances
    return np.where(distances <= FARTHEST, distances, np.inf).astype(np.float32)


_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_TRUECOLOUR = 2
_QUICK = 1
"""Compression level: the fastest is enough for large areas of one colour."""


def png_file(image: NDArray[np.uint8]) -> bytes:
    """Return the PNG file of an image with the axes row, column, and colour (red, green, blue)."""
    rows, columns, _ = image.shape
    lines = np.zeros((rows, 1 + 3 * columns), dtype=np.uint8)  # each starts with its filter type: 0 is none
    lines[:, 1:] = image.reshape(rows, -1)
    header = struct.pack(">IIBBBBB", columns, rows, 8, _TRUECOLOUR, 0, 0, 0)
    data = zlib.compress(lines.tobytes(), _QUICK)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


Fields: TypeAlias = "Mapping[str, object]"

MAP, ODOM, BASE, LASER, CAMERA = "map", "odom", "base_link", "laser", "camera_optical_frame"
_LASER_AT = (0.0, 0.0, 0.25)
_CAMERA_AT = (0.15, 0.0, MOUNTED_AT)
_OPTICAL = {"x": -0.5, "y": 0.5, "z": -0.5, "w": 0.5}
"""A camera looks along z, with x to the right (REP 103)."""
_GRAVITY = 9.81
_POSITION_VARIANCE, _HEADING_VARIANCE = 1e-4, 1e-4
_UNKNOWN = 1e6
"""Variance of values that a robot on the floor does not measure."""
_ROOM_TEMPERATURE = 25.0
_CHARGING, _DISCHARGING, _FULL = 1, 2, 4
_HEALTH_GOOD, _HEALTH_DEAD = 1, 3
_LITHIUM_ION = 2
_OK, _WARN, _ERROR = 0, 1, 2


class View(NamedTuple):
    """Inputs of a message: the rover at a time in nanoseconds (wall clock)."""

    state: State
    settings: Settings
    world: World
    time_ns: int


def time_fields(time_ns: int) -> Fields:
    """Return a builtin_interfaces/Time."""
    sec, nanosec = divmod(time_ns, 1_000_000_000)
    return {"sec": sec, "nanosec": nanosec}


def pose_stamped(pose: Pose, time_ns: int) -> Fields:
    """Return a geometry_msgs/PoseStamped on the map."""
    return {"header": _header(time_ns, MAP), "pose": _pose(pose.x, pose.y, pose.heading)}


def odometry(view: View) -> Fields:
    """Return a nav_msgs/Odometry."""
    motion = view.state.motion
    return {
        "header": _header(view.time_ns, ODOM),
        "child_frame_id": BASE,
        "pose": {
            "pose": _pose(motion.x, motion.y, motion.heading),
            "covariance": _covariance(_POSITION_VARIANCE, _HEADING_VARIANCE),
        },
        "twist": {
            "twist": {
                "linear": _vector(motion.velocity.speed, 0.0, 0.0),
                "angular": _vector(0.0, 0.0, motion.velocity.turn_rate),
            },
            "covariance": _covariance(_POSITION_VARIANCE, _HEADING_VARIANCE),
        },
    }


def transforms(view: View) -> Fields:
    """Return a tf2_msgs/TFMessage of moving frames. Localisation is perfect: the map and odometry frames coincide."""
    motion = view.state.motion
    return {
        "transforms": [
            _transform(view.time_ns, MAP, ODOM, (0.0, 0.0, 0.0), _rotation(0.0)),
            _transform(view.time_ns, ODOM, BASE, (motion.x, motion.y, 0.0), _rotation(motion.heading)),
        ]
    }


def fixed_transforms(view: View) -> Fields:
    """Return a tf2_msgs/TFMessage of the frames mounted on the rover."""
    return {
        "transforms": [
            _transform(view.time_ns, BASE, LASER, _LASER_AT, _rotation(0.0)),
            _transform(view.time_ns, BASE, CAMERA, _CAMERA_AT, _OPTICAL),
        ]
    }


def laser_scan(view: View) -> Fields:
    """Return a sensor_msgs/LaserScan."""
    return {
        "header": _header(view.time_ns, LASER),
        "angle_min": FIRST,
        "angle_max": FIRST + (BEAMS - 1) * INCREMENT,
        "angle_increment": INCREMENT,
        "time_increment": 0.0,
        "scan_time": 1 / view.settings.scan_rate,
        "range_min": NEAREST,
        "range_max": FARTHEST,
        "ranges": scan(view.world, view.state.motion),
        "intensities": np.empty(0, np.float32),
    }


def raw_image(view: View) -> Fields:
    """Return a sensor_msgs/Image."""
    return {
        "header": _header(view.time_ns, CAMERA),
        "height": HEIGHT,
        "width": WIDTH,
        "encoding": "rgb8",
        "is_bigendian": 0,
        "step": 3 * WIDTH,
        "data": image(view.world, view.state.motion, view.state.has_lights).ravel(),
    }


def compressed_image(view: View) -> Fields:
    """Return a sensor_msgs/CompressedImage."""
    file = png_file(image(view.world, view.state.motion, view.state.has_lights))
    return {"header": _header(view.time_ns, CAMERA), "format": "png", "data": np.frombuffer(file, np.uint8)}


def camera_info(view: View) -> Fields:
    """Return a sensor_msgs/CameraInfo of a camera without distortion."""
    focal, (centre_x, centre_y) = FOCAL_LENGTH, CENTRE
    return {
        "header": _header(view.time_ns, CAMERA),
        "height": HEIGHT,
        "width": WIDTH,
        "distortion_model": "plumb_bob",
        "d": np.zeros(5),
        "k": np.array([focal, 0.0, centre_x, 0.0, focal, centre_y, 0.0, 0.0, 1.0]),
        "r": np.eye(3).ravel(),
        "p": np.array([focal, 0.0, centre_x, 0.0, 0.0, focal, centre_y, 0.0, 0.0, 0.0, 1.0, 0.0]),
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def occupancy_grid(view: View) -> Fields:
    """Return a nav_msgs/OccupancyGrid."""
    grid = grid_of(view.world.as_mapped())
    return {
        "header": _header(view.time_ns, MAP),
        "info": {
            "map_load_time": time_fields(view.time_ns),
            "resolution": RESOLUTION,
            "width": grid.columns,
            "height": grid.rows,
            "origin": _pose(grid.left, grid.bottom, 0.0),
        },
        "data": grid.occupancy(),
    }


def battery_state(view: View) -> Fields:
    """Return a sensor_msgs/BatteryState."""
    battery, is_docked = view.state.battery, view.state.is_docked
    status = _DISCHARGING if not is_docked else _FULL if battery.level >= 1.0 else _CHARGING
    return {
        "header": _header(view.time_ns, BASE),
        "voltage": CELLS * battery.cell_voltage,
        "temperature": _ROOM_TEMPERATURE,
        "current": battery.current,
        "charge": battery.level * CAPACITY,
        "capacity": CAPACITY,
        "design_capacity": CAPACITY,
        "percentage": battery.level,
        "power_supply_status": status,
        "power_supply_health": _HEALTH_DEAD if battery.is_empty else _HEALTH_GOOD,
        "power_supply_technology": _LITHIUM_ION,
        "present": True,
        "cell_voltage": np.full(CELLS, battery.cell_voltage, np.float32),
        "cell_temperature": np.full(CELLS, _ROOM_TEMPERATURE, np.float32),
        "location": "base",
        "serial_number": "R0V3R-1",
    }


def imu(view: View) -> Fields:
    """Return a sensor_msgs/Imu."""
    motion = view.state.motion
    return {
        "header": _header(view.time_ns, BASE),
        "orientation": _rotation(motion.heading),
        "orientation_covariance": _diagonal(_HEADING_VARIANCE, 3),
        "angular_velocity": _vector(0.0, 0.0, motion.velocity.turn_rate),
        "angular_velocity_covariance": _diagonal(_HEADING_VARIANCE, 3),
        "linear_acceleration": _vector(0.0, motion.velocity.speed * motion.velocity.turn_rate, _GRAVITY),
        "linear_acceleration_covariance": _diagonal(_HEADING_VARIANCE, 3),
    }


def lights(view: View) -> Fields:
    """Return a std_msgs/Bool: whether the lights are on."""
    return {"data": view.state.has_lights}


def diagnostics(view: View) -> Fields:
    """Return a diagnostic_msgs/DiagnosticArray of battery, drive, laser and camera."""
    status = [
        _battery_status(view),
        _drive_status(view),
        _status("laser", _OK, "scanning", {"scans a second": f"{view.settings.scan_rate}"}),
        _status("camera", _OK, "seeing", {"images a second": f"{view.settings.camera_rate}"}),
    ]
    return {"header": _header(view.time_ns, ""), "status": status}


def log(line: LogLine, time_ns: int) -> Fields:
    """Return a rcl_interfaces/Log."""
    return {
        "stamp": time_fields(time_ns),
        "level": line.severity.value,
        "name": NODE.strip("/"),
        "msg": line.text,
        "file": "",
        "function": "",
        "line": 0,
    }


def navigation_feedback(journey: Journey, motion: Motion, time_ns: int) -> Fields:
    """Return the feedback of rosld_rover/NavigateTo."""
    return {
        "current_pose": pose_stamped(_pose_of(motion), time_ns),
        "distance_remaining": remaining_length(journey, motion),
    }


def navigation_result(ended: JourneyEnd, motion: Motion, time_ns: int) -> Fields:
    """Return the result of rosld_rover/NavigateTo."""
    return {"message": ended.message, "pose": pose_stamped(_pose_of(motion), time_ns)}


def _battery_status(view: View) -> Fields:
    battery, is_low = view.state.battery, view.state.battery.level < view.settings.low_battery
    level = _ERROR if battery.is_empty else _WARN if is_low and not view.state.is_docked else _OK
    words = "empty" if battery.is_empty else "charging" if view.state.is_docked else "low" if is_low else "good"
    values = {"level (%)": f"{100 * battery.level:.1f}", "voltage (V)": f"{CELLS * battery.cell_voltage:.2f}"}
    return _status("battery", level, words, values)


def _drive_status(view: View) -> Fields:
    motion, command = view.state.motion, view.state.command
    left, right = wheel_speeds(motion.velocity)
    level, words = _OK, "driving" if left or right else "standing"
    if view.state.battery.is_empty:
        level, words = _ERROR, "no power"
    elif motion.is_bumped:
        level, words = _WARN, "held up by an obstacle"
    values = {
        "commanded speed (m/s)": f"{command.speed:.2f}",
        "commanded turn rate (rad/s)": f"{command.turn_rate:.2f}",
        "left wheel (m/s)": f"{left:.2f}",
        "right wheel (m/s)": f"{right:.2f}",
        "driven (m)": f"{motion.driven:.1f}",
    }
    return _status("drive", level, words, values)


def _status(name: str, level: int, message: str, values: Mapping[str, str]) -> Fields:
    pairs = [{"key": key, "value": value} for key, value in values.items()]
    return {"level": level, "name": f"rover: {name}", "message": message, "hardware_id": "R0V3R-1", "values": pairs}


def _header(time_ns: int, frame: str) -> Fields:
    return {"stamp": time_fields(time_ns), "frame_id": frame}


def _vector(x: float, y: float, z: float) -> Fields:
    return {"x": x, "y": y, "z": z}


def _rotation(heading: float) -> Fields:
    return {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}


def _pose(x: float, y: float, heading: float) -> Fields:
    return {"position": _vector(x, y, 0.0), "orientation": _rotation(heading)}


def _pose_of(motion: Motion) -> Pose:
    return Pose(motion.x, motion.y, motion.heading)


def _transform(time_ns: int, parent: str, child: str, at: Sequence[float], rotation: Fields) -> Fields:
    return {
        "header": _header(time_ns, parent),
        "child_frame_id": child,
        "transform": {"translation": _vector(*at), "rotation": rotation},
    }


def _covariance(position: float, heading: float) -> object:
    """Return the rows of the covariance matrix of x, y, z and the rotations about these axes."""
    return np.diag([position, position, _UNKNOWN, _UNKNOWN, _UNKNOWN, heading]).ravel()


def _diagonal(variance: float, size: int) -> object:
    return (variance * np.eye(size)).ravel()
