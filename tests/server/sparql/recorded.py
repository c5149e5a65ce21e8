"""A recording of many kinds of messages: nested ones, lists with and without members, arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
_START_NS = 1_700_000_000_000_000_000


def record(folder: Path) -> Path:
    """Write a ROS 2 recording of eight topics, a few messages each."""
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    with writer:
        for topic, message in messages():
            connection = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            for turn in range(3):
                data = STORE.serialize_cdr(message, message.__msgtype__)
                writer.write(connection, _START_NS + turn * 100_000_000, data)
    return folder


def messages() -> list[tuple[str, Any]]:
    """Return a message of each topic."""
    vector = _made("geometry_msgs/msg/Vector3", x=1.0, y=2.0)
    twist = _made("geometry_msgs/msg/Twist", linear=vector)
    stamped = [_made("geometry_msgs/msg/TransformStamped", child_frame_id=f"frame{each}") for each in range(2)]
    pair = _made("diagnostic_msgs/msg/KeyValue", key="charge", value="0.2")
    status = _made("diagnostic_msgs/msg/DiagnosticStatus", name="battery", values=[pair])
    return [
        ("/chatter", _made("std_msgs/msg/String", data="hello")),
        ("/other/chatter", _made("std_msgs/msg/String", data="hello")),
        ("/cmd_vel", twist),
        ("/odom", _made("nav_msgs/msg/Odometry", twist=_made("geometry_msgs/msg/TwistWithCovariance", twist=twist))),
        ("/frames", _made("tf2_msgs/msg/TFMessage", transforms=stamped)),
        ("/no/frames", _made("tf2_msgs/msg/TFMessage")),
        ("/joints", _made("sensor_msgs/msg/JointState", name=["left", "right"], position=numpy.array([1.0, 2.0]))),
        ("/diagnostics", _made("diagnostic_msgs/msg/DiagnosticArray", status=[status])),
    ]


def _made(type: str, /, **values: Any) -> Any:
    """Return a message of a type: zeros, except for these fields."""
    fields = dict(STORE.fielddefs[type][1])
    return STORE.types[type](**{field: values.get(field, _zero(kind)) for field, kind in fields.items()})


def _zero(definition: Any) -> Any:
    kind, told = definition
    if kind == Nodetype.BASE:
        return "" if told[0] == "string" else 0.0 if told[0].startswith("float") else 0
    if kind == Nodetype.NAME:
        return _made(told)
    (inner, name), length = told
    is_numeric = inner == Nodetype.BASE and name[0] != "string"
    return numpy.zeros(length if kind == Nodetype.ARRAY else 0, dtype=name[0]) if is_numeric else []
