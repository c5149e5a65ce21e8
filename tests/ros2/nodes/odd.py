"""A node that is unusual in one way: `odd.py WAY NAME`. Prints "ready", and "heard TEXT" for received messages.

silent answers no service at all; shouter publishes best effort on /loud, where strict subscribes reliably; twin
publishes on /shared; foreign uses types of visualization_msgs, and so does idl, which describes them as if they were
written in IDL; late has published three messages on the latched /history.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from running import begun, run, say
from std_msgs.msg import String


def silent(_: Node) -> None:
    """A node that never spins."""


def shouter(node: Node) -> None:
    publisher = node.create_publisher(String, "/loud", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    node.create_timer(0.05, lambda: publisher.publish(String(data="hey")))


def strict(node: Node) -> None:
    profile = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
    node.create_subscription(String, "/loud", lambda m: say(f"heard {m.data}"), profile)


def twin(node: Node) -> None:
    publisher = node.create_publisher(String, "/shared", 10)
    node.create_timer(0.05, lambda: publisher.publish(String(data=node.get_name())))


def foreign(node: Node) -> None:
    from visualization_msgs.msg import Marker
    from visualization_msgs.srv import GetInteractiveMarkers

    publisher = node.create_publisher(Marker, "/marker", 10)
    node.create_timer(0.05, lambda: publisher.publish(Marker()))
    node.create_service(GetInteractiveMarkers, "/get_markers", lambda _, response: response)


def idl(node: Node) -> None:
    """Run the same as `foreign`, but report its types as written in IDL."""
    foreign(node)
    from type_description_interfaces import msg as told_as
    from type_description_interfaces.srv import GetTypeDescription

    known = json.loads((Path(sys.prefix) / "share/visualization_msgs/msg/Marker.json").read_text())[
        "type_description_msg"
    ]

    def individual(described: Any) -> Any:
        fields = [
            told_as.Field(name=each["name"], type=told_as.FieldType(**each["type"])) for each in described["fields"]
        ]
        return told_as.IndividualTypeDescription(type_name=described["type_name"], fields=fields)

    def tell(_: Any, told: Any) -> Any:
        told.successful = True
        told.type_description.type_description = individual(known["type_description"])
        told.type_description.referenced_type_descriptions = list(
            map(individual, known["referenced_type_descriptions"])
        )
        told.type_sources = [told_as.TypeSource(type_name="visualization_msgs/msg/Marker", encoding="idl")]
        return told

    node.create_service(GetTypeDescription, "~/get_type_description", tell)


def late(node: Node) -> None:
    publisher = node.create_publisher(
        String, "/history", QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    )
    for text in ("one", "two", "three"):
        publisher.publish(String(data=text))


WAYS: dict[str, Callable[[Node], None]] = {
    each.__name__: each for each in (silent, shouter, strict, twin, foreign, idl, late)
}


def main(way: str, name: str) -> None:
    context = begun()
    own = [Parameter("start_type_description_service", value=False)] if way == "idl" else []
    node = Node(name, context=context, parameter_overrides=own)
    WAYS[way](node)
    run(context, SingleThreadedExecutor(context=context), [] if way == "silent" else [node])


if __name__ == "__main__":
    main(*sys.argv[1:])
