"""Navigation to a goal: the planned path, the velocity that follows it, the outcome, and requests. No I/O."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from rosld.adapters.model import GoalStatus
from rosld.adapters.rover.drive import RADIUS, Limits, Motion, Velocity, is_blocked_ahead, wrap_angle
from rosld.adapters.rover.planner import Point, find_path, grid_of, path_length
from rosld.adapters.rover.world import World

FRAMES = ("map", "odom", "")
"""Frames of a goal: the first two coincide because there is no drift, and the empty frame means the map."""
_ARRIVED_WITHIN = 0.05
_PASSED_WITHIN = 0.15
_ALIGNED_WITHIN = 0.03
_AHEAD = 0.3
"""Maximum radians between heading and path for driving; for larger angles the rover turns first."""
_LOOK_AHEAD = 0.25
_QUATERNION_TOLERANCE = 0.1


@dataclass(frozen=True, slots=True)
class Pose:
    """A position and a heading on the map."""

    x: float
    y: float
    heading: float


@dataclass(frozen=True, slots=True)
class Journey:
    """A goal that is being pursued: `corners` are the remaining corners of the path.

    `problem` is why no path leads to the goal, or None.
    """

    id: str
    goal: Pose
    corners: tuple[Point, ...]
    problem: str | None = None
    is_canceling: bool = False


@dataclass(frozen=True, slots=True)
class JourneyEnd:
    """A goal that has ended, with its outcome and a message."""

    id: str
    outcome: GoalStatus
    message: str


class Declined(Exception):
    """A goal that is rejected; the message is the reason."""


def heading_of(x: float, y: float, z: float, w: float) -> float:
    """Return the heading of an orientation. Raises Declined for a quaternion that is not a rotation."""
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1) <= _QUATERNION_TOLERANCE:  # NaN fails this comparison
        raise Declined(
            f"the orientation ({x:g}, {y:g}, {z:g}, {w:g}) is not a unit quaternion; (0, 0, 0, 1) faces east"
        )
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def check_goal(frame: str, x: float, y: float, heading: float) -> Pose:
    """Return the goal with these numbers. Raises Declined for an unknown frame, and for numbers that are not finite."""
    if frame not in FRAMES:
        raise Declined(f"unknown frame {frame!r}: goals must be in 'map'")
    if not (math.isfinite(x) and math.isfinite(y)):
        raise Declined(f"the position ({x:g}, {y:g}) is not a valid position")
    return Pose(x, y, heading)


def depart(id: str, goal: Pose, motion: Motion, world: World) -> Journey:
    """Return the journey to an accepted goal, with its path on the map."""
    mapped = world.as_mapped()
    place = f"({goal.x:g}, {goal.y:g})"
    if not mapped.contains(goal.x, goal.y):
        ends = f"x from {world.left:g} to {world.left + world.width:g}, y from {world.bottom:g} to "
        problem = f"{place} lies outside the map: {ends}{world.bottom + world.height:g}"
        return Journey(id, goal, (), problem)
    if mapped.clearance(goal.x, goal.y) < RADIUS:
        return Journey(id, goal, (), f"an obstacle stands at {place}")
    corners = find_path(grid_of(mapped), (motion.x, motion.y), (goal.x, goal.y))
    return Journey(id, goal, corners, None if corners else f"no free path leads to {place}")


def remaining_length(journey: Journey, motion: Motion) -> float:
    """Return the metres left on the path."""
    return path_length((motion.x, motion.y), journey.corners)


def drop_passed_corners(journey: Journey, motion: Motion) -> Journey:
    """Return the journey without the corners that have been reached."""
    corners = journey.corners
    while len(corners) > 1 and math.dist((motion.x, motion.y), corners[0]) < _PASSED_WITHIN:
        corners = corners[1:]
    if corners and math.dist((motion.x, motion.y), corners[-1]) < _ARRIVED_WITHIN:
        corners = ()
    return journey if corners is journey.corners else replace(journey, corners=corners)


def velocity_towards(journey: Journey, motion: Motion, limits: Limits) -> Velocity:
    """Return the velocity to command now: to the next corner, and at the end into the goal's heading."""
    if not journey.corners:
        return Velocity(0.0, _turn(wrap_angle(journey.goal.heading - motion.heading), limits))
    (x, y), rest = journey.corners[0], remaining_length(journey, motion)
    aside = wrap_angle(math.atan2(y - motion.y, x - motion.x) - motion.heading)
    if abs(aside) > _AHEAD:
        return Velocity(0.0, _turn(aside, limits))
    return Velocity(min(limits.speed, 0.05 + 1.2 * rest) * math.cos(aside), _turn(aside, limits))


def end_of(journey: Journey, motion: Motion, world: World, is_empty: bool) -> JourneyEnd | None:
    """Return the end of the goal, or None while it is pursued. The map may lack obstacles."""
    if journey.is_canceling:
        return JourneyEnd(journey.id, GoalStatus.CANCELED, "canceled")
    if is_empty:
        return JourneyEnd(journey.id, GoalStatus.ABORTED, "the battery is empty")
    if journey.problem is not None:
        return JourneyEnd(journey.id, GoalStatus.ABORTED, journey.problem)
    if not journey.corners:
        is_aligned = abs(wrap_angle(journey.goal.heading - motion.heading)) < _ALIGNED_WITHIN
        return JourneyEnd(journey.id, GoalStatus.SUCCEEDED, "arrived") if is_aligned else None
    distance = min(_LOOK_AHEAD, math.dist((motion.x, motion.y), journey.corners[0]))
    if motion.velocity.speed > 0 and (motion.is_bumped or is_blocked_ahead(world, motion, distance)):
        place = f"({motion.x:.2f}, {motion.y:.2f})"
        return JourneyEnd(
            journey.id, GoalStatus.ABORTED, f"an obstacle that is not on the map blocks the path at {place}"
        )
    return None


def _turn(angle: float, limits: Limits) -> float:
    return max(-limits.turn_rate, min(limits.turn_rate, 3.0 * angle))


def velocity_of(twist: Any) -> Velocity:
    """Return the part of a geometry_msgs/Twist that a differential drive can follow."""
    return Velocity(twist.linear.x, twist.angular.z)


def goal_of(message: Any) -> Pose:
    """Return the pose in a goal of rosld_rover/NavigateTo. Raises Declined for an invalid one."""
    stamped = message.pose
    at, facing = stamped.pose.position, stamped.pose.orientation
    return check_goal(stamped.header.frame_id, at.x, at.y, heading_of(facing.x, facing.y, facing.z, facing.w))
