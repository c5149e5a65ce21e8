"""Computation graph of the rover: its topics with types and rates, services, actions and parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from types import MappingProxyType
from typing import NamedTuple, cast

from rosld.adapters.model import (
    Choice,
    Descriptor,
    NotFound,
    Operation,
    Parameter,
    ParameterType,
    ParameterValue,
    Range,
    Refused,
    Sent,
    freeze,
)
from rosld.adapters.model.parameter import as_declared
from rosld.adapters.rover.messages import (
    Fields,
    View,
    battery_state,
    camera_info,
    compressed_image,
    diagnostics,
    fixed_transforms,
    imu,
    laser_scan,
    lights,
    occupancy_grid,
    odometry,
    raw_image,
    transforms,
)
from rosld.adapters.rover.settings import NODE, PARAMETERS, Declaration, Settings, Value, problem_of

CMD_VEL = "/cmd_vel"
ROSOUT = "/rosout"
LIGHTS = "/lights"
NAVIGATE_TO = "/navigate_to"
SET_LIGHTS = "/set_lights"
DOCK = "/dock"
_HERTZ = 20.0


_URDF = (files("rosld.adapters.rover") / "rover.urdf").read_text("utf-8")


def robot_description(view: View) -> Fields:
    """Return a std_msgs/String: the links, joints and sensors of the rover in URDF."""
    return {"data": _URDF}


class Periodic(NamedTuple):
    """A topic that is published periodically: its type, a function for its message, and the rate in hertz."""

    type: str
    compose: Callable[[View], Fields]
    rate: float | str
    """The number, or the name of the setting that holds it."""

    def period(self, settings: Settings) -> float:
        """Return the seconds between two messages."""
        return 1 / float(getattr(settings, self.rate) if isinstance(self.rate, str) else self.rate)


class Latched(NamedTuple):
    """A latched topic, which is published once and after each change."""

    type: str
    compose: Callable[[View], Fields]


PERIODIC: Mapping[str, Periodic] = MappingProxyType(
    {
        "/odom": Periodic("nav_msgs/msg/Odometry", odometry, _HERTZ),
        "/tf": Periodic("tf2_msgs/msg/TFMessage", transforms, _HERTZ),
        "/imu": Periodic("sensor_msgs/msg/Imu", imu, _HERTZ),
        "/scan": Periodic("sensor_msgs/msg/LaserScan", laser_scan, "scan_rate"),
        "/camera/image_raw": Periodic("sensor_msgs/msg/Image", raw_image, "camera_rate"),
        "/camera/image_raw/compressed": Periodic("sensor_msgs/msg/CompressedImage", compressed_image, "camera_rate"),
        "/camera/camera_info": Periodic("sensor_msgs/msg/CameraInfo", camera_info, "camera_rate"),
        "/battery_state": Periodic("sensor_msgs/msg/BatteryState", battery_state, 1.0),
        "/diagnostics": Periodic("diagnostic_msgs/msg/DiagnosticArray", diagnostics, 1.0),
    }
)
LATCHED: Mapping[str, Latched] = MappingProxyType(
    {
        "/map": Latched("nav_msgs/msg/OccupancyGrid", occupancy_grid),
        "/tf_static": Latched("tf2_msgs/msg/TFMessage", fixed_transforms),
        LIGHTS: Latched("std_msgs/msg/Bool", lights),
        "/robot_description": Latched("std_msgs/msg/String", robot_description),
    }
)


TOPICS: Mapping[str, str] = {
    CMD_VEL: "geometry_msgs/msg/Twist",
    ROSOUT: "rcl_interfaces/msg/Log",
    **{name: topic.type for name, topic in PERIODIC.items()},
    **{name: topic.type for name, topic in LATCHED.items()},
}
"""Types of the rover's topics."""
SERVICES: Mapping[str, str] = {SET_LIGHTS: "std_srvs/srv/SetBool", DOCK: "std_srvs/srv/Trigger"}
ACTIONS: Mapping[str, str] = {NAVIGATE_TO: "rosld_rover/action/NavigateTo"}
_TYPES: Mapping[type, ParameterType] = {
    bool: ParameterType.BOOLEAN,
    int: ParameterType.INTEGER,
    float: ParameterType.DOUBLE,
    str: ParameterType.STRING,
}


def _descriptor(declared: Declaration) -> Descriptor:
    limits = None
    if declared.least is not None and declared.greatest is not None:
        limits = Range(declared.least, declared.greatest)
    return Descriptor(
        _TYPES[type(declared.default)],
        declared.description,
        declared.is_read_only,
        range=limits,
        choices=tuple(Choice(value, description=words) for value, words in (declared.choices or {}).items()),
    )


GRAPH_PARAMETERS = freeze(
    {f"{NODE}/{name}": Parameter(f"{NODE}/{name}", NODE, _descriptor(each)) for name, each in PARAMETERS.items()}
)


_PREFIX = f"{NODE}/"


def operations_on(name: str) -> frozenset[Operation]:
    """Return the operations on a parameter: declared ones cannot be deleted, and others do not exist."""
    declared = PARAMETERS.get(name.removeprefix(_PREFIX)) if name.startswith(_PREFIX) else None
    if declared is None:
        return frozenset()
    return frozenset({Operation.GET_PARAMETER, *([] if declared.is_read_only else [Operation.SET_PARAMETER])})


def read(values: Mapping[str, Value], name: str) -> ParameterValue | None:
    """Return the value of a name, a dict for the node's name or `/`, or None."""
    if name == "/":
        return {NODE.strip("/"): {**values}}
    if name == NODE:
        return {**values}
    return values.get(name.removeprefix(_PREFIX)) if name.startswith(_PREFIX) else None


def with_values(values: Mapping[str, Value], changes: Mapping[str, ParameterValue]) -> Mapping[str, Value]:
    """Return the values with the given ones set. Raises NotFound, and Refused with the node's reason."""
    changed = dict(values)
    for name, value in changes.items():
        if not name.startswith(_PREFIX):
            raise NotFound(f"the parameter {name} belongs to no node: those of the rover begin with {_PREFIX}")
        short = name.removeprefix(_PREFIX)
        if short not in PARAMETERS:
            raise _refusal(name, f"{short} is not declared")
        fit = as_declared(value, GRAPH_PARAMETERS[name].descriptor)
        if (problem := problem_of(short, fit)) is not None:
            raise _refusal(name, problem)
        changed[short] = cast(Value, fit)
    return changed


def refuse_deletion(names: Sequence[str]) -> None:
    """Raise Refused for a declared parameter, which cannot be deleted, and NotFound for others."""
    for name in names:
        if name not in GRAPH_PARAMETERS:
            raise NotFound(f"there is no parameter {name}")
        raise _refusal(name, "it was declared by its node, which keeps it")


def _refusal(name: str, words: str) -> Refused:
    return Refused(f"{NODE} refuses the parameter {name}", words=words, sent=Sent.YES)
