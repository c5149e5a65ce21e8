"""Recordings of made-up runs of a mobile robot, written by rosbags: odometry, imu, battery, commands, diagnostics."""

from __future__ import annotations

import math
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

START_NS = 1_700_000_000_000_000_000
_STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_JAZZY)}
RATES = {"/odom": 20, "/imu": 50, "/cmd_vel": 2, "/battery_state": 1, "/diagnostics": 1}
"""Messages of each topic per second."""


class Spoken(NamedTuple):
    """A message, and the time of its recording in ns."""

    time_ns: int
    topic: str
    message: Any


def write_run(path: Path, *, seconds: float = 60, seed: int = 0, start_ns: int = START_NS) -> Path:
    """Write a run: `x.bag` of ROS 1, `x.mcap` or `x.db3` of ROS 2, or without a suffix a rosbag2 folder.

    The speed is at most 1 m/s, the charge begins at 0.9 or below and falls; diagnostics warn below 0.25. Every seed
    gives another run.
    """
    if path.suffix == ".bag":
        _write(Writer1(path), 1, seconds, seed, start_ns)
        return path
    folder = path.with_name(f".{path.name}.folder") if path.suffix else path
    writer = Writer2(
        folder, version=9, storage_plugin=StoragePlugin.SQLITE3 if path.suffix == ".db3" else StoragePlugin.MCAP
    )
    if path.suffix != ".db3":
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    _write(writer, 2, seconds, seed, start_ns)
    if path.suffix:
        next(each for each in folder.iterdir() if each.suffix == path.suffix).rename(path)
        shutil.rmtree(folder)
    return path


def _write(writer: Any, version: int, seconds: float, seed: int, start_ns: int) -> None:
    store, connections = _STORES[version], {}
    with writer:
        for time_ns, topic, message in spoken(version, seconds, seed, start_ns):
            kind = message.__msgtype__
            if topic not in connections:
                more = {"callerid": "/base"} if version == 1 else {}
                connections[topic] = writer.add_connection(topic, kind, typestore=store, **more)
            serialize = store.serialize_ros1 if version == 1 else store.serialize_cdr
            writer.write(connections[topic], time_ns, serialize(message, kind))


def spoken(version: int, seconds: float, seed: int, start_ns: int = START_NS) -> Iterator[Spoken]:
    """Yield the messages of a run in the order of their times, as objects of rosbags for this version of ROS."""
    types, luck = _STORES[version].types, random.Random(seed)
    time, head = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    vector = types["geometry_msgs/msg/Vector3"]
    turn, lowest = luck.uniform(0.05, 0.5), luck.uniform(0.05, 0.8)
    x = y = yaw = 0.0

    def header(at: int, frame: str) -> Any:
        stamp = time(at // 10**9, at % 10**9)
        return head(0, stamp, frame) if version == 1 else head(stamp, frame)

    numbers = {topic: np.arange(int(seconds * rate)) / rate for topic, rate in RATES.items()}
    order = sorted((float(at), topic) for topic, times in numbers.items() for at in times)
    for number, (at, topic) in enumerate(order):
        time_ns = start_ns + round(at * 1e9) + number % 7 * 1000
        stamp_ns = time_ns - 1_500_000
        speed = abs(math.sin(at * turn)) * (0.5 + 0.5 * luck.random())
        charge = max(lowest, 0.9 - at * 0.01)
        if topic == "/odom":
            yaw += turn / RATES[topic]
            x, y = x + speed / RATES[topic] * math.cos(yaw), y + speed / RATES[topic] * math.sin(yaw)
            pose = types["geometry_msgs/msg/Pose"](
                types["geometry_msgs/msg/Point"](x, y, 0.0),
                types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
            )
            twist = types["geometry_msgs/msg/Twist"](vector(speed, 0.0, 0.0), vector(0.0, 0.0, turn))
            message = types["nav_msgs/msg/Odometry"](
                header(stamp_ns, "odom"),
                "base_link",
                types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
                types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
            )
        elif topic == "/imu":
            message = types["sensor_msgs/msg/Imu"](
                header(stamp_ns, "imu_link"),
                types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
                np.zeros(9),
                vector(0.0, 0.0, turn + luck.gauss(0, 0.01)),
                np.zeros(9),
                vector(luck.gauss(0, 0.1), 0.0, 9.81),
                np.zeros(9),
            )
        elif topic == "/cmd_vel":
            message = types["geometry_msgs/msg/Twist"](vector(speed, 0.0, 0.0), vector(0.0, 0.0, turn))
        elif topic == "/battery_state":
            measured = (11.0 + charge, 20.0, -1.5, 5.0, 10.0, 10.0, charge)
            empty = np.zeros(0, np.float32)
            rest = (1, 1, 3, True, empty, empty, "", "B1")
            message = types["sensor_msgs/msg/BatteryState"](header(stamp_ns, ""), *measured, *rest)
        else:
            level = 1 if charge < 0.25 else 0
            status = types["diagnostic_msgs/msg/DiagnosticStatus"](
                level, "battery", "low" if level else "full enough", "B1", []
            )
            message = types["diagnostic_msgs/msg/DiagnosticArray"](header(stamp_ns, ""), [status])
        yield Spoken(time_ns, topic, message)
