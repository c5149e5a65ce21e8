"""The topics of the rover: the type of each, how often it is published, and what is said there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from rosld.adapters.rover import messages
from rosld.adapters.rover.messages import Fields, View
from rosld.adapters.rover.settings import Settings

CMD_VEL = "/cmd_vel"
CMD_VEL_TYPE = "geometry_msgs/msg/Twist"
ROSOUT = "/rosout"
ROSOUT_TYPE = "rcl_interfaces/msg/Log"
LIGHTS = "/lights"
NAVIGATE_TO = "/navigate_to"
NAVIGATE_TO_TYPE = "rosld_rover/action/NavigateTo"
SET_LIGHTS = "/set_lights"
SET_LIGHTS_TYPE = "std_srvs/srv/SetBool"
DOCK = "/dock"
DOCK_TYPE = "std_srvs/srv/Trigger"
_HERTZ = 20.0


class Periodic(NamedTuple):
    """A topic that is published again and again: its type, what is said, and the messages a second."""

    type: str
    say: Callable[[View], Fields]
    rate: Callable[[Settings], float]


class Latched(NamedTuple):
    """A topic whose last message is there for all who come: said once, and when it has changed."""

    type: str
    say: Callable[[View], Fields]


def _always(rate: float) -> Callable[[Settings], float]:
    return lambda _: rate


def _scan_rate(settings: Settings) -> float:
    return float(settings.scan_rate)


def _camera_rate(settings: Settings) -> float:
    return float(settings.camera_rate)


PERIODIC: Mapping[str, Periodic] = MappingProxyType(
    {
        "/odom": Periodic("nav_msgs/msg/Odometry", messages.odometry, _always(_HERTZ)),
        "/tf": Periodic("tf2_msgs/msg/TFMessage", messages.transforms, _always(_HERTZ)),
        "/imu": Periodic("sensor_msgs/msg/Imu", messages.imu, _always(_HERTZ)),
        "/scan": Periodic("sensor_msgs/msg/LaserScan", messages.laser_scan, _scan_rate),
        "/camera/image_raw": Periodic("sensor_msgs/msg/Image", messages.raw_image, _camera_rate),
        "/camera/image_raw/compressed": Periodic(
            "sensor_msgs/msg/CompressedImage", messages.compressed_image, _camera_rate
        ),
        "/camera/camera_info": Periodic("sensor_msgs/msg/CameraInfo", messages.camera_info, _camera_rate),
        "/battery_state": Periodic("sensor_msgs/msg/BatteryState", messages.battery_state, _always(1.0)),
        "/diagnostics": Periodic("diagnostic_msgs/msg/DiagnosticArray", messages.diagnostics, _always(1.0)),
    }
)
LATCHED: Mapping[str, Latched] = MappingProxyType(
    {
        "/map": Latched("nav_msgs/msg/OccupancyGrid", messages.occupancy_grid),
        "/tf_static": Latched("tf2_msgs/msg/TFMessage", messages.fixed_transforms),
        LIGHTS: Latched("std_msgs/msg/Bool", messages.lights),
    }
)
