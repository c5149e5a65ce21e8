"""A robot of hundreds of topics: several arms, cameras and sensors, each with a namespace, and topics with none."""

from __future__ import annotations

from tests.server.robots.made_up import MadeUp

COUNT = 330
_PARTS = {
    "camera": (8, {"image_raw": "sensor_msgs/msg/Image", "image_raw/compressed": "sensor_msgs/msg/CompressedImage",
                   "camera_info": "sensor_msgs/msg/CameraInfo", "points": "sensor_msgs/msg/PointCloud2"}),
    "arm": (4, {"joint_states": "sensor_msgs/msg/JointState", "tool/pose": "geometry_msgs/msg/PoseStamped",
                "tool/wrench": "geometry_msgs/msg/WrenchStamped", "command": "trajectory_msgs/msg/JointTrajectory"}),
    "battery": (4, {"state": "sensor_msgs/msg/BatteryState", "temperature": "sensor_msgs/msg/Temperature"}),
    "wheel": (12, {"velocity": "std_msgs/msg/Float64", "current": "std_msgs/msg/Float64",
                   "odom": "nav_msgs/msg/Odometry"}),
    "planner": (3, {"path": "nav_msgs/msg/Path", "costmap": "nav_msgs/msg/OccupancyGrid",
                    "goal": "geometry_msgs/msg/PoseStamped"}),
}  # fmt: skip
_SINGLE = {
    "/odom": "nav_msgs/msg/Odometry", "/scan": "sensor_msgs/msg/LaserScan", "/imu": "sensor_msgs/msg/Imu",
    "/cmd_vel": "geometry_msgs/msg/Twist", "/map": "nav_msgs/msg/OccupancyGrid", "/rosout": "rosgraph_msgs/msg/Log",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray", "/tf": "tf2_msgs/msg/TFMessage",
}  # fmt: skip


def topics() -> dict[str, str]:
    """Return the names of the topics, `COUNT` of them, with their types."""
    found = dict(_SINGLE)
    for part, (count, own) in _PARTS.items():
        for number in range(1, count + 1):
            found |= {f"/{part}_{number}/{name}": type for name, type in own.items()}
    number = 0
    while len(found) < COUNT:
        number += 1
        found[f"/signal_{number:03}"] = "std_msgs/msg/Float64"
    return found


def furnish(robot: MadeUp) -> None:
    """Add all these topics, without messages, and some parameters to a robot."""
    for name, type in topics().items():
        robot.topic(name, type, published=True, heard=name == "/cmd_vel")
    for number in range(40):
        robot.parameter(f"/planner_{number % 3 + 1}/limits/gain_{number}", number / 10)
