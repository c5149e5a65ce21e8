"""The Foxglove SDK as the robot's server, and Foxglove's client for JavaScript as a viewer."""

from __future__ import annotations

import importlib.util
import json
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.foxglove import adapter
from rosld.adapters.model import Encoding, MessageSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from tests.interop.javascript.node import node
from tests.interop.missing import missing
from tests.server.robots.made_up import served
from tests.waiting import until

PATIENCE = 60.0
JSON = {"Accept": "application/json"}
LIBRARY = TypeLibrary(ros_version=2)


def encoded(type: str, **values: Any) -> bytes:
    schema = LIBRARY.find(TypeRef(type))
    assert isinstance(schema, MessageSchema)
    return schema.codec.encode(schema.codec.build(type, values), Encoding.CDR)


class Robot:
    """A program that uses the Foxglove SDK: channels of all kinds, services, parameters."""

    def __init__(self, foxglove: Any) -> None:
        self.received: list[tuple[str, bytes]] = []
        self.parameters: dict[str, Any] = {"/robot/seats": 2, "gain": 0.5, "/robot/key": b"\x00\xff"}
        self._topics: dict[int, str] = {}
        self._module = foxglove
        can = importlib.import_module("foxglove.websocket").Capability
        context = self._context = foxglove.Context()  # channels close without it

        def channel(topic: str, encoding: str, name: str = "", written: str = "", text: bytes = b"") -> Any:
            schema = foxglove.Schema(name=name, encoding=written, data=text) if name else None
            return foxglove.Channel(topic, message_encoding=encoding, schema=schema, context=context)

        shape = {"type": "object", "properties": {
            "height": {"type": "number"}, "names": {"type": "array", "items": {"type": "string"}},
            "at": {"type": "object", "properties": {"x": {"type": "integer"}}},
            "raw": {"type": "string", "contentEncoding": "base64"},
        }}  # fmt: skip
        self.channels = {
            "/point": channel(
                "/point", "cdr", "geometry_msgs/msg/Point", "ros2msg", b"float64 x\nfloat64 y\nfloat64 z"
            ),
            "/shaped": channel("/shaped", "json", "demo.Shaped", "jsonschema", json.dumps(shape).encode()),
            "free": channel("free", "json"),
            "/idl": channel("/idl", "cdr", "std_msgs/msg/Int16", "omgidl", b"module std_msgs {};"),
            "/proto": channel("/proto", "protobuf", "demo.Thing", "protobuf", b"\x0a\x00"),
        }

        def text(name: str, definition: bytes) -> Any:
            return foxglove.MessageSchema(
                encoding="cdr", schema=foxglove.Schema(name=name, encoding="ros2msg", data=definition)
            )

        def answer(request: Any) -> bytes:
            if request.payload[4:5] == b"\x00":
                raise ValueError("the gripper is jammed")
            return encoded("std_srvs/srv/SetBool_Response", success=True, message="done")

        service = foxglove.Service(
            "/grip",
            schema=foxglove.ServiceSchema(
                "std_srvs/srv/SetBool",
                request=text("std_srvs/srv/SetBool_Request", b"bool data"),
                response=text("std_srvs/srv/SetBool_Response", b"bool success\nstring message"),
            ),
            handler=answer,
        )
        self.server = foxglove.start_server(
            name="Demo robot",
            port=0,
            capabilities=[can.ClientPublish, can.Parameters, can.Services, can.ConnectionGraph],
            server_listener=self,
            supported_encodings=["cdr", "json"],
            services=[service],
            context=context,
        )
        graph = foxglove.ConnectionGraph()
        for topic in self.channels:
            graph.set_published_topic(topic, ["/driver"])
        graph.set_subscribed_topic("/command", ["/wheels"])
        graph.set_advertised_service("/grip", ["/gripper"])
        self.server.publish_connection_graph(graph)

    # The interface of a listener

    def on_client_advertise(self, client: Any, channel: Any) -> None:
        self._topics[channel.id] = channel.topic

    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
        self.received.append((self._topics[client_channel_id], data))

    def on_get_parameters(self, client: Any, param_names: list[str], request_id: str | None = None) -> Any:
        names = param_names or list(self.parameters)
        return [self._module.Parameter(each, value=self.parameters[each]) for each in names if each in self.parameters]

    def on_set_parameters(self, client: Any, parameters: Any, request_id: str | None = None) -> Any:
        for each in parameters:
            self.parameters[each.name] = each.get_value()
        self.parameters = {name: value for name, value in self.parameters.items() if value is not None}
        return self.on_get_parameters(client, [each.name for each in parameters])

    def __getattr__(self, name: str) -> Any:
        if name.startswith("on_"):
            return lambda *_: None
        raise AttributeError(name)


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    if importlib.util.find_spec("foxglove") is None:
        missing("there is no Foxglove SDK: pip install '.[interop]'")
    running = Robot(importlib.import_module("foxglove"))
    yield running
    running.server.stop()


@pytest.fixture(scope="module")
def http(robot: Robot) -> Iterator[httpx.Client]:
    """A client of a rosld that serves this robot."""
    with served(adapter(f"foxglove://127.0.0.1:{robot.server.port}", AdapterOptions())) as client:
        yield client


def log(robot: Robot, topic: str, data: bytes, http: httpx.Client, expected: Any) -> None:
    """Publish a message until it is the topic's value."""
    path = f"/topics/{topic.lstrip('/')}"

    def is_here() -> bool:
        http.get(path)
        robot.channels[topic].log(data)
        return bool(http.get(path, headers=JSON).json() == expected)

    until(is_here, f"the message of {topic}")


def test_channels_in_all_encodings_are_topics(robot: Robot, http: httpx.Client) -> None:
    log(robot, "/point", encoded("geometry_msgs/msg/Point", x=1.0, y=2.0, z=3.0), http, {"x": 1.0, "y": 2.0, "z": 3.0})
    log(robot, "/idl", encoded("std_msgs/msg/Int16", data=7), http, {"data": 7})
    shaped = {"height": 1.5, "names": ["a", "b"], "at": {"x": 4}, "raw": "AP8="}
    log(robot, "/shaped", json.dumps(shaped).encode(), http, shaped)
    log(robot, "free", b'{"any": 1}', http, {"data": '{"any": 1}'})
    assert "protobuf" in http.get("/topics/proto", headers={"Accept": "text/turtle"}).text
    page = http.get("/topics/shaped", headers={"Accept": "text/turtle"}).text
    assert "foxglove_json/msg/demo_Shaped" in page
    assert "/nodes/driver" in page


def test_messages_are_published_and_services_called(robot: Robot, http: httpx.Client) -> None:
    body = "@prefix m: <https://w3id.org/rosld/types/std_msgs/msg/> . <#message> a m:Int16 ; <INT16data> 7 ."
    body = body.replace("INT16", "https://w3id.org/rosld/types/std_msgs/msg/Int16#")
    answer = http.put("/topics/command", content=body, headers={"Content-Type": "text/turtle"})
    assert answer.status_code in (201, 204), answer.text
    until(lambda: robot.received, "the message")
    assert robot.received[-1] == ("/command", encoded("std_msgs/msg/Int16", data=7))
    assert http.post("/services/grip", json={"data": True}, headers=JSON).json() == {"success": True, "message": "done"}
    refused = http.post("/services/grip", json={"data": False})
    assert refused.status_code >= 400
    assert "jammed" in refused.text


def test_parameters_are_read_set_and_deleted(robot: Robot, http: httpx.Client) -> None:
    assert http.get("/parameters/robot/seats", headers=JSON).json() == 2
    assert http.get("/parameters/gain", headers=JSON).json() == 0.5
    assert http.put("/parameters/gain", json=1.0).status_code == 204
    assert robot.parameters["gain"] == 1.0
    assert http.put("/parameters/robot/seats", json=5).status_code == 204
    assert robot.parameters["/robot/seats"] == 5
    assert http.delete("/parameters/robot/seats").status_code == 204
    assert "/robot/seats" not in robot.parameters


def test_the_client_for_javascript_reads_publishes_and_calls(start_server: Callable[..., Any]) -> None:
    url = start_server("aircraft").url
    address = url.replace("http", "ws", 1) + "foxglove"
    command = node("foxglove.mjs", address)
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout) == {
        "name": True,
        "definition": "float64 data",
        "speed": 0,
        "power": "off",
        "failure": True,
        "parameter": 2,
        "publishers": ["/aircraft"],
        "published": "from JavaScript",
    }


def test_rosld_attaches_to_rosld(start_server: Callable[..., Any]) -> None:
    peer = start_server("rover").url
    source = peer.replace("http", "foxglove", 1) + "foxglove"
    server = start_server(source)
    until(lambda: server.http.get("/topics/odom", headers=JSON).status_code == 200, "odometry")
    assert server.http.post("/services/set_lights", json={"data": True}, headers=JSON).json()["success"] is True
    assert server.http.put("/parameters/rover/drive_mode", json="eco").status_code == 204
    assert server.http.put("/parameters/rover/drive_mode", json="warp").status_code >= 400
