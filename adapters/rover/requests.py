"""What the rover is asked for, read from decoded messages. Pure."""

from __future__ import annotations

from typing import Protocol, cast

from rosld.adapters.model import Message
from rosld.adapters.rover.drive import Velocity
from rosld.adapters.rover.navigation import Pose, check_goal, heading_of


class Vector(Protocol):
    """geometry_msgs/Vector3, or Point."""

    x: float
    y: float
    z: float


class Twist(Protocol):
    """geometry_msgs/Twist."""

    linear: Vector
    angular: Vector


class Quaternion(Vector, Protocol):
    """geometry_msgs/Quaternion."""

    w: float


class PoseMessage(Protocol):
    """geometry_msgs/Pose."""

    position: Vector
    orientation: Quaternion


class Header(Protocol):
    """std_msgs/Header."""

    frame_id: str


class PoseStamped(Protocol):
    """geometry_msgs/PoseStamped."""

    header: Header
    pose: PoseMessage


class NavigateToGoal(Protocol):
    """rosld_rover/NavigateTo's goal."""

    pose: PoseStamped


class SetBoolRequest(Protocol):
    """std_srvs/SetBool's request."""

    data: bool


def velocity_of(message: Message | Twist) -> Velocity:
    """What of a geometry_msgs/Twist a differential drive can do."""
    twist = cast(Twist, message)
    return Velocity(twist.linear.x, twist.angular.z)


def goal_of(message: Message | NavigateToGoal) -> Pose:
    """Where a goal leads. Declined for one that is none."""
    stamped = cast(NavigateToGoal, message).pose
    at, turned = stamped.pose.position, stamped.pose.orientation
    return check_goal(stamped.header.frame_id, at.x, at.y, heading_of(turned.x, turned.y, turned.z, turned.w))


def switch_of(message: Message | SetBoolRequest) -> bool:
    """What a std_srvs/SetBool asks for."""
    return cast(SetBoolRequest, message).data
