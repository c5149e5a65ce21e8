"""Velocity topics: topics whose zero message stops the robot."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase

from rosld.adapters.model import Graph, Message, MessageSchema, Topic
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import lowerer
from rosld.ontology.neutral_message import COMMANDS, is_zero, with_zeros
from rosld.server.robot.session import Session
from rosld.server.robot.write_policy import is_reserved

LEFT_OUT = "!"
"""Prefix of a glob of --stop-zero that excludes its topics from stops."""

OCCASIONAL_TYPES = COMMANDS | {
    "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Path",
    "rcl_interfaces/msg/Log", "rosgraph_msgs/msg/Log", "sensor_msgs/msg/Joy", "trajectory_msgs/msg/JointTrajectory",
}  # fmt: skip
"""Types of messages that are published only during some activity: silence on their topics is normal."""


def is_velocity_topic(topic: Topic, graph: Graph, globs: Sequence[str]) -> bool:
    """Whether zero on a topic stops the robot, by the topic's type or the globs of --stop-zero.

    Topics that belong to ROS itself never do, even if a glob matches.
    """
    if any(fnmatchcase(topic.name, glob[1:]) for glob in globs if glob.startswith(LEFT_OUT)):
        return False
    if any(ref.name in COMMANDS for ref in topic.types):
        return True
    return any(fnmatchcase(topic.name, glob) for glob in globs) and not is_reserved(topic.name, graph)


def commanded_topics(graph: Graph, globs: Sequence[str]) -> Sequence[Topic]:
    """Return the velocity topics with a subscriber, regardless of publishers: a stop must reach it in any case."""
    return [
        topic
        for topic in graph.topics.values()
        if subscribers_of(topic, graph) and is_velocity_topic(topic, graph, globs)
    ]


def subscribers_of(topic: Topic, graph: Graph) -> int:
    """Return the number of a topic's subscribers except rosld's own."""
    return sum(endpoint.node != graph.own_node for endpoint in topic.subscribers)


def zero_message(schema: MessageSchema, lifting: LiftSettings) -> Message:
    """Return the zero message of a type."""
    return with_zeros(schema, lowerer(schema, lifting).from_json({}, defaults=True))


def goes_on(session: Session, name: str, schema: MessageSchema, message: Message) -> bool:
    """Whether a message is a non-zero velocity, which keeps the robot moving until something else is published."""
    if not session.settings.stop_zero and schema.ref.name not in COMMANDS:
        return False
    return _commands_velocity(session, name, schema) and not is_zero(schema, message)


def passes_stop(session: Session, name: str, schema: MessageSchema, message: Message) -> bool:
    """Whether a message may be published although the robot is stopped: zero on a velocity topic."""
    if session.interlock.stop_state is None:
        return False
    return _commands_velocity(session, name, schema) and is_zero(schema, message)


def _commands_velocity(session: Session, name: str, schema: MessageSchema) -> bool:
    topic = session.graph.topics.get(name) or Topic(name, (schema.ref,))
    return is_velocity_topic(topic, session.graph, session.settings.stop_zero)
