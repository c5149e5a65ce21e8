"""The cockpit generated for a robot: camera, drive, pose, battery, diagnostics, numbers, actions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TypeAlias

from rosld.adapters.model import Graph, Topic
from rosld.ontology.cockpit import Cockpit, GridArea, Panel, PanelKind
from rosld.ontology.neutral_message import COMMANDS
from rosld.ontology.urls import Space
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.resource_tree import ResourceTree
from rosld.server.resources.base import Services
from rosld.server.resources.namespaces import listed_graph
from rosld.server.robot.diagnostic_states import DIAGNOSTIC_ARRAY
from rosld.server.robot.write_policy import RESERVED
from rosld.server.space.drawing import can_place

TITLE = "Default cockpit"
_Fields: TypeAlias = Mapping[str, tuple[str, ...]]
"""Paths of fields by the type of a topic, the best type first."""
_MAX_RESOURCES = 4
_MAX_ACTIONS = 3
_MAX_SERVICES = 8
_PLAIN = frozenset({"std_srvs/srv/Trigger", "std_srvs/srv/Empty", "std_srvs/srv/SetBool"})
"""Types of services that say by their names alone what they do."""
_MAX_VALUES = 6
_ODOMETRY = "nav_msgs/msg/Odometry"
_POSES: _Fields = {
    _ODOMETRY: ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/PoseStamped": ("pose.position", "pose.orientation"),
    "turtlesim/msg/Pose": ("x", "y", "theta"),
}
"""Fields with the position of the robot."""
_SPEEDS: _Fields = {
    _ODOMETRY: ("twist.twist.linear.x", "twist.twist.angular.z"),
    "geometry_msgs/msg/TwistStamped": ("twist.linear.x", "twist.angular.z"),
    "turtlesim/msg/Pose": ("linear_velocity", "angular_velocity"),
}
_JOINTS: _Fields = {"sensor_msgs/msg/JointState": ("position",)}
_TRANSFORMS = frozenset({"/tf", "/tf_static"})
_IMAGES = frozenset({"sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"})
_BATTERY = "sensor_msgs/msg/BatteryState"
_NUMBERS = frozenset(
    f"std_msgs/msg/{name}"
    for name in ("Float32", "Float64", "Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16", "UInt32", "UInt64")
)
_SIMPLE = _NUMBERS | {"std_msgs/msg/String", "std_msgs/msg/Bool"}


async def default_cockpit(services: Services) -> Cockpit:
    """Return panels for the current robot."""
    session, affordances = services.session, services.affordances
    space, is_read_only = session.space, session.settings.read_only
    graph, can_stop = session.graph, services.software_stop.unusable_reason is None
    listed = listed_graph(graph, session.adapter.capabilities)
    topics = [each for each in listed.topics.values() if each.type is not None and each.name not in RESERVED]
    topics.sort(key=lambda each: (each.name.count("/"), len(each.name), each.name))
    panels = [
        *_of_topics(space, graph, topics, is_read_only=is_read_only, can_stop=can_stop),
        *_of_resources(space, graph, await affordances.tree(), is_read_only=is_read_only),
    ]
    shown = panels or list(_first_topics(space, topics))
    faults = Panel(PanelKind.VALUE, (space.container("faults"),), title="Faults", area=GridArea(3, 3))
    return Cockpit(TITLE, (*shown[:2], faults, *shown[2:]))


def _first_topics(space: Space, topics: Iterable[Topic]) -> Iterator[Panel]:
    """Return panels of the first topics, if no topic is of a kind with a panel of its own."""
    for topic in [each for each in topics if _is_published(each)][:_MAX_VALUES]:
        yield Panel(PanelKind.VALUE, (space.topic(topic.name),), title=topic.name, area=GridArea(4, 5))


def _of_topics(
    space: Space, graph: Graph, topics: Sequence[Topic], *, is_read_only: bool, can_stop: bool
) -> Iterator[Panel]:
    published = [each for each in topics if _is_published(each)]
    for topic in _some(published, lambda name: name in _IMAGES, 1):
        yield Panel(PanelKind.PICTURE, (space.topic(topic.name),), title="Camera", area=GridArea(5, 5))
    driven = [each for each in topics if each.subscribers]
    if not is_read_only:
        for topic in _some(driven, lambda name: name in COMMANDS, 1):
            yield Panel(PanelKind.DRIVE, (space.topic(topic.name),), title="Drive", area=GridArea(4, 5))
    if any(DIAGNOSTIC_ARRAY in _names(each) for each in published):
        url = f"{space.base}diagnostics"
        yield Panel(PanelKind.VALUE, (url,), title="Diagnostics", area=GridArea(3, 5))
    if _TRANSFORMS & graph.topics.keys() or any(can_place(name) for each in published for name in _names(each)):
        yield Panel(PanelKind.SPACE, (f"{space.base}space",), title="Space", area=GridArea(6, 6))
    yield from _of_fields(space, published, _SPEEDS, PanelKind.PLOT, "Speed", GridArea(6, 3))
    yield from _of_fields(space, published, _JOINTS, PanelKind.PLOT, "Joints", GridArea(6, 4))
    yield from _of_fields(space, published, _POSES, PanelKind.VALUE, "Pose", GridArea(3, 3))
    for topic in _some(published, lambda name: name == _BATTERY, 1):
        fields = ("percentage", "voltage")
        yield Panel(PanelKind.VALUE, (space.topic(topic.name),), fields, "Battery", GridArea(3, 3))
    numbers = _some(published, lambda name: name in _NUMBERS, 2)
    for topic in numbers:
        yield Panel(PanelKind.PLOT, (space.topic(topic.name),), ("data",), topic.name, GridArea(6, 4))
    if can_stop:
        yield Panel(PanelKind.BUTTON, (space.stop,), title="Stop", area=GridArea(3, 2))
    for topic in _some(published, lambda name: name in _SIMPLE, _MAX_VALUES):
        if topic not in numbers:
            yield Panel(PanelKind.VALUE, (space.topic(topic.name),), ("data",), topic.name, GridArea(3, 2))


def _of_fields(
    space: Space,
    topics: Iterable[Topic],
    fields: Mapping[str, tuple[str, ...]],
    kind: PanelKind,
    title: str,
    area: GridArea,
) -> Iterator[Panel]:
    """A panel with the fields of the first topic of the best type that is there."""
    for type, paths in fields.items():
        topic = next((each for each in topics if type in _names(each)), None)
        if topic is not None:
            yield Panel(kind, (space.topic(topic.name),), paths, title, area)
            return


def _of_resources(space: Space, graph: Graph, tree: ResourceTree, *, is_read_only: bool) -> Iterator[Panel]:
    """Return panels of mapped resources with values and offers, and of the actions of ROS."""
    mapped = [path for path in tree.paths if (plan := tree.complex(path)) is not None and plan.mapped is not None]
    shown = 0
    for path in sorted(mapped, key=lambda each: (each.count("/"), each)):
        plan = tree.complex(path)
        if plan is None or shown >= _MAX_RESOURCES:
            continue
        shown += 1
        url, name = url_of(path, space), path.strip("/") or "robot"
        if plan.members:
            yield Panel(PanelKind.VALUE, (url,), title=name, area=GridArea(3, 4))
        if plan.actions and not is_read_only:
            yield Panel(PanelKind.BUTTON, (url,), title=f"{name}: actions", area=GridArea(3, 4))
    services = [each for each in graph.services.values() if each.type is not None and each.type.name in _PLAIN]
    if services and not is_read_only:
        urls = tuple(space.service(each.name) for each in services[:_MAX_SERVICES])
        yield Panel(PanelKind.BUTTON, urls, title="Services", area=GridArea(3, 4))
    goals = [each for each in tree.actions if (found := tree.action(each)) is not None and found.sends_goals]
    if not is_read_only:
        for action in sorted(goals)[:_MAX_ACTIONS]:
            yield Panel(PanelKind.BUTTON, (url_of(action, space),), title=action.strip("/"), area=GridArea(3, 4))


def _is_published(topic: Topic) -> bool:
    """Whether a topic has a publisher, or no known user: recordings may lack publishers."""
    return bool(topic.publishers) or not topic.subscribers


def _names(topic: Topic) -> frozenset[str]:
    return frozenset(ref.name for ref in topic.types)


def _some(topics: Iterable[Topic], fits: Callable[[str], bool], most: int) -> list[Topic]:
    """Return the first topics of a type that fits."""
    return [each for each in topics if any(map(fits, _names(each)))][:most]
