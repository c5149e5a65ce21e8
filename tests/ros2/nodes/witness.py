"""A node that looks at the robot for the tests: a line in names what is asked, a line out is the answer as JSON.

ask SERVICE       the data that a getter answers
hear TOPIC        the data of the next message
names             the topics, services and nodes that are not hidden
publishers TOPIC  the nodes that publish it
parameter NAME    the value of NODE/PARAMETER, or all values of a node as a tree; null where there is none
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

PATIENCE = 15.0


def class_of(name: str) -> Any:
    package, kind, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)


def shown(name: str) -> bool:
    return not any(segment.startswith("_") for segment in name.split("/"))


class Witness(Node):
    """What the tests ask."""

    def __init__(self) -> None:
        super().__init__("witness")

    def until(self, true: Callable[[], Any], what: str) -> Any:
        """Spin until something is so."""
        end = time.monotonic() + PATIENCE
        while not (found := true()):
            if time.monotonic() > end:
                raise TimeoutError(f"never came: {what}")
            rclpy.spin_once(self, timeout_sec=0.05)
        return found

    def call(self, name: str, kind: Any, request: Any) -> Any:
        client = self.create_client(kind, name)
        try:
            if not client.wait_for_service(PATIENCE):
                raise TimeoutError(f"there is no service {name}")
            answered = client.call_async(request)
            self.until(answered.done, f"an answer of {name}")
            return answered.result()
        finally:
            self.destroy_client(client)

    def ask(self, service: str) -> object:
        kind = class_of(self.until(lambda: dict(self.get_service_names_and_types()).get(service), service)[0])
        return self.call(service, kind, kind.Request()).data

    def hear(self, topic: str) -> object:
        kind = class_of(self.until(lambda: dict(self.get_topic_names_and_types()).get(topic), topic)[0])
        heard: list[Any] = []
        subscription = self.create_subscription(kind, topic, heard.append, 1)
        try:
            self.until(lambda: heard, f"a message on {topic}")
            return heard[0].data
        finally:
            self.destroy_subscription(subscription)

    def nodes(self) -> list[str]:
        return [f"{namespace.rstrip('/')}/{name}" for name, namespace in self.get_node_names_and_namespaces()]

    def names(self) -> dict[str, list[str]]:
        found = {
            "topics": [name for name, _ in self.get_topic_names_and_types()],
            "services": [name for name, _ in self.get_service_names_and_types()],
            "nodes": self.nodes(),
        }
        return {kind: sorted(filter(shown, names)) for kind, names in found.items()}

    def publishers(self, topic: str) -> list[str]:
        ends = self.get_publishers_info_by_topic(topic)
        return sorted({f"{end.node_namespace.rstrip('/')}/{end.node_name}" for end in ends})

    def parameter(self, name: str) -> object:
        if name in self.nodes():
            names = self.call(f"{name}/list_parameters", ListParameters, ListParameters.Request()).result.names
            tree: dict[str, Any] = {}
            for each in sorted(names):
                *above, last = each.split("/")
                branch = tree
                for segment in above:
                    branch = branch.setdefault(segment, {})
                branch[last] = self.value(name, each)
            return tree
        owners = [node for node in self.nodes() if name.startswith(f"{node}/")]
        if not owners:
            return None
        owner = max(owners, key=len)
        return self.value(owner, name.removeprefix(f"{owner}/"))

    def value(self, node: str, name: str) -> object:
        request = GetParameters.Request(names=[name])
        values = self.call(f"{node}/get_parameters", GetParameters, request).values
        value = parameter_value_to_python(values[0]) if values else None
        return list(value) if isinstance(value, (list, tuple)) or hasattr(value, "tolist") else value


def main() -> None:
    rclpy.init()
    witness = Witness()
    print("ready", flush=True)
    for line in sys.stdin:
        command, *arguments = line.split()
        try:
            print(json.dumps(getattr(witness, command)(*arguments)), flush=True)
        except Exception as error:
            print(json.dumps({"failed": f"{line.strip()}: {error!r}"}), flush=True)
    witness.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
