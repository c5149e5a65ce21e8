"""`/foxglove`: a viewer sees what it may read, and what it writes passes the checks of every other request."""

from __future__ import annotations

import base64
import itertools
import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from rosld.adapters.model import Encoding, MessageSchema, ServiceSchema, TypeRef
from rosld.adapters.model import foxglove_protocol as protocol
from rosld.adapters.model.foxglove_protocol import ServiceMessage
from rosld.adapters.model.library import TypeLibrary
from rosld.server.auth.tokens import token_digest
from tests.server.auth.conftest import rule
from tests.server.robots.made_up import MadeUp, Serving
from tests.stopping import release
from tests.waiting import until

PATIENCE = 20.0
SPEED, DISPLAY = "/aircraft/engine/speed", "/cockpit/display"
LIBRARY = TypeLibrary(ros_version=1)


def encoded(type: str, **values: Any) -> bytes:
    schema = LIBRARY.find(TypeRef(type))
    assert isinstance(schema, MessageSchema)
    return schema.codec.encode(schema.codec.build(type, values), Encoding.ROS1)


class Viewer:
    """A client of the protocol, which collects what it receives."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.received: list[Any] = []
        self._ids = itertools.count(1)

    def op(self, name: str, **members: Any) -> None:
        self.socket.send(protocol.op(name, **members))

    def until(self, fits: Callable[[Any], object]) -> Any:
        """Return the first message that fits: bytes, or an object."""
        for each in self.received:
            if fits(each):
                return each
        while True:
            data = self.socket.recv(PATIENCE)
            self.received.append(data if isinstance(data, bytes) else json.loads(data))
            if fits(self.received[-1]):
                return self.received[-1]

    def until_op(self, name: str, **members: Any) -> Any:
        """Return the first message with an operation and members."""
        wanted = {"op": name, **members}
        return self.until(lambda each: isinstance(each, dict) and wanted.items() <= each.items())

    def channel(self, topic: str) -> Any:
        """Return the channel of a topic, once it is advertised."""

        def found(each: Any) -> Any:
            channels = each.get("channels", ()) if isinstance(each, dict) else ()
            return next((one for one in channels if one["topic"] == topic), None)

        return found(self.until(found))

    def service(self, name: str) -> Any:
        def found(each: Any) -> Any:
            services = each.get("services", ()) if isinstance(each, dict) else ()
            return next((one for one in services if one["name"] == name), None)

        return found(self.until(found))

    def subscribe(self, topic: str) -> int:
        id = next(self._ids)
        self.op("subscribe", subscriptions=[{"id": id, "channelId": self.channel(topic)["id"]}])
        return id

    def message(self, id: int) -> bytes:
        """Return a message of a subscription."""
        data = self.until(
            lambda each: isinstance(each, bytes) and each[0] == 1 and protocol.read_message_data(each)[0] == id
        )
        return protocol.read_message_data(data)[2]

    def publish(self, topic: str, type: str, data: bytes, encoding: str = "ros1") -> None:
        id = next(self._ids)
        self.op("advertise", channels=[{"id": id, "topic": topic, "encoding": encoding, "schemaName": type}])
        self.socket.send(protocol.client_message_data(id, data))

    def call(self, name: str, payload: bytes, encoding: str = "ros1") -> Any:
        """Return the response of a service, or the message of its failure."""
        id = next(self._ids)
        request = ServiceMessage(self.service(name)["id"], id, encoding, payload)
        self.socket.send(protocol.service_message(protocol.SERVICE_REQUEST, request))

        def answers(each: Any) -> bool:
            if isinstance(each, bytes):
                return each[0] == protocol.SERVICE_RESPONSE and protocol.read_service_message(each).call_id == id
            return bool(each["op"] == "serviceCallFailure" and each["callId"] == id)

        answer = self.until(answers)
        return protocol.read_service_message(answer).payload if isinstance(answer, bytes) else answer["message"]


@contextmanager
def viewing(base: str | httpx.URL, **options: Any) -> Iterator[Viewer]:
    """Open a connection to the server at a base."""
    url = f"{base}".replace("http", "ws", 1).rstrip("/") + "/foxglove"
    settings = {"subprotocols": ["foxglove.sdk.v1"], "max_size": None, **options}
    with connect(url, **settings) as socket:
        yield Viewer(socket)


@pytest.fixture
def viewer(plane: httpx.Client) -> Iterator[Viewer]:
    with viewing(plane.base_url) as opened:
        yield opened


def test_the_channels_are_the_topics_with_their_definitions_and_messages_as_they_are(viewer: Viewer) -> None:
    info = viewer.until_op("serverInfo")
    assert viewer.socket.subprotocol == "foxglove.sdk.v1"
    assert set(info["capabilities"]) == {
        "clientPublish", "connectionGraph", "parameters", "parametersSubscribe", "services",
    }  # fmt: skip
    assert (info["supportedEncodings"], info["metadata"]["ROS_DISTRO"]) == (["ros1", "json"], "noetic")
    channel = viewer.channel(SPEED)
    assert (channel["encoding"], channel["schemaName"], channel["schemaEncoding"]) == (
        "ros1", "std_msgs/Float64", "ros1msg",
    )  # fmt: skip
    assert channel["schema"].split() == ["float64", "data"]
    assert viewer.message(viewer.subscribe(SPEED)) == encoded("std_msgs/msg/Float64", data=0.0)


def test_what_is_not_of_the_protocol_is_answered_by_a_status_and_changes_nothing(
    viewer: Viewer, plane: httpx.Client
) -> None:
    for odd in ("{", "[]", '{"op":"dance"}', '{"op":"subscribe"}', b"", b"\xff", b"\x01", b"\x02\0\0\0\0"):
        viewer.socket.send(odd)
        viewer.until_op("status", level=2)
        viewer.received.clear()
    viewer.op("subscribe", subscriptions=[{"id": 1, "channelId": 4711}])
    assert "4711" in viewer.until_op("status")["message"]
    with pytest.raises(InvalidStatus) as refused, viewing(plane.base_url, subprotocols=["mqtt"]):
        pass
    assert refused.value.response.status_code == 400
    with pytest.raises(InvalidStatus) as foreign, viewing(plane.base_url, origin="https://elsewhere.example"):
        pass
    assert foreign.value.response.status_code == 403
    assert "--cors-origin" in foreign.value.response.body.decode()


def test_a_message_of_a_viewer_is_published_with_a_receipt_unless_the_robot_is_stopped(
    viewer: Viewer, plane: httpx.Client
) -> None:
    viewer.publish(DISPLAY, "std_msgs/String", encoded("std_msgs/msg/String", data="from ros1"))
    id = viewer.subscribe(DISPLAY)
    assert viewer.message(id) == encoded("std_msgs/msg/String", data="from ros1")
    receipts = plane.get("/activity/", headers={"Accept": "application/n-triples"}).text
    assert "/topics/cockpit/display" in plane.get(re.findall(r"/activity/[\w-]+", receipts)[-1]).text
    viewer.received.clear()
    viewer.publish(DISPLAY, "std_msgs/String", b'{"data":"from json"}', "json")
    assert viewer.message(id) == encoded("std_msgs/msg/String", data="from json")
    viewer.publish("/brand/new", "std_msgs/Int16", encoded("std_msgs/msg/Int16", data=7))
    assert viewer.message(viewer.subscribe("/brand/new")) == encoded("std_msgs/msg/Int16", data=7)
    viewer.publish(DISPLAY, "std_msgs/Int16", encoded("std_msgs/msg/Int16", data=7))
    assert "std_msgs/msg/String" in viewer.until_op("status", level=2)["message"]
    viewer.received.clear()
    assert plane.post("/stop").status_code == 200
    try:
        viewer.publish(DISPLAY, "std_msgs/String", encoded("std_msgs/msg/String", data="no"))
        assert "stop" in viewer.until_op("status", level=2)["message"]
    finally:
        release(plane)
    assert plane.get("/topics/cockpit/display", headers={"Accept": "application/json"}).json() != {"data": "no"}


def test_services_are_called_and_a_refusal_is_told(viewer: Viewer) -> None:
    response = viewer.call("/aircraft/get_power", b"")
    schema = LIBRARY.learn_service("x/srv/Text", "---\nstring data")
    assert isinstance(schema, ServiceSchema)
    assert getattr(schema.response.codec.decode(response, Encoding.ROS1), "data") == "off"  # noqa: B009
    assert json.loads(viewer.call("/aircraft/get_power", b"{}", "json")) == {"data": "off"}
    assert "at most 1000" in viewer.call("/aircraft/engine/set_speed", b'{"data": 5000}', "json")
    assert "decoded" in viewer.call("/aircraft/engine/set_speed", b"\1\2")


def test_parameters_are_read_set_followed_and_deleted(viewer: Viewer, plane: httpx.Client) -> None:
    viewer.op("getParameters", parameterNames=["/aircraft/seats", "/no/such"], id="a")
    assert viewer.until_op("parameterValues", id="a")["parameters"] == [{"name": "/aircraft/seats", "value": 2}]
    octets = {"name": "/viewer/octets", "type": "byte_array", "value": base64.b64encode(b"\x00\xff").decode()}
    whole = {"name": "/viewer/whole", "type": "float64", "value": 3.0}
    viewer.op("setParameters", parameters=[octets, whole], id="b")
    assert viewer.until_op("parameterValues", id="b")["parameters"] == [octets, whole]
    viewer.op("subscribeParameterUpdates", parameterNames=["/viewer/whole"])
    viewer.op("getParameters", parameterNames=[], id="c")
    assert len(viewer.until_op("parameterValues", id="c")["parameters"]) > 3
    assert plane.put("/parameters/viewer/whole", json=4).status_code == 204
    viewer.until_op("parameterValues", parameters=[{"name": "/viewer/whole", "value": 4}])
    viewer.op("setParameters", parameters=[{"name": "/viewer/octets"}, {"name": "/viewer/whole"}], id="d")
    assert viewer.until_op("parameterValues", id="d")["parameters"] == []
    assert plane.get("/parameters/viewer/whole").status_code == 404


def test_the_connection_graph_is_sent_whole_and_then_what_changes(serving: Serving, robot: MadeUp) -> None:
    robot.topic("/one", "std_msgs/msg/Int16", heard=True)
    with viewing(serving().base_url) as viewer:
        viewer.op("subscribeConnectionGraph")
        first = viewer.until_op("connectionGraphUpdate")
        assert first["publishedTopics"] == [{"name": "/one", "publisherIds": ["/robot"]}]
        assert first["subscribedTopics"] == [{"name": "/one", "subscriberIds": ["/listener"]}]
        viewer.channel("/one")
        robot.topic("/two", "std_msgs/msg/Int16")
        viewer.until_op("connectionGraphUpdate", publishedTopics=[{"name": "/two", "publisherIds": ["/robot"]}])
        id = viewer.channel("/two")["id"]
        robot.forget("/two")
        viewer.until_op("connectionGraphUpdate", removedTopics=["/two"])
        viewer.until_op("unadvertise", channelIds=[id])


@pytest.mark.slow
def test_a_slow_viewer_misses_the_oldest_messages_and_is_told(serving: Serving, robot: MadeUp) -> None:
    robot.topic("/camera", "std_msgs/msg/UInt8MultiArray")
    with viewing(serving().base_url, max_queue=1) as viewer:
        id = viewer.subscribe("/camera")
        until(lambda: robot.subscribed() == {"/camera"}, "the subscription")
        for number in range(100):
            value = {"data": base64.b64encode(np.full(500_000, number, np.uint8).tobytes()).decode()}
            robot.publishes("/camera", value)
        words = viewer.until_op("status", level=1)["message"]
        assert "/camera were dropped" in words
        numbers = [each[-1] for each in viewer.received if isinstance(each, bytes) and each[1] == id]
        assert numbers == sorted(numbers)
        assert len(numbers) + int(words.split()[0]) <= 100


def test_a_recording_plays_with_its_own_clock(serve: Callable[..., Any], tmp_path: Path) -> None:
    from tests.server.test_bags import write

    write(tmp_path / "walk.bag")
    with viewing(serve(str(tmp_path / "walk.bag")).url) as viewer:
        info = viewer.until_op("serverInfo")
        assert "time" in info["capabilities"]
        assert "clientPublish" not in info["capabilities"]
        assert len(viewer.message(viewer.subscribe("/walk/point"))) == 24
        time = viewer.until(lambda each: isinstance(each, bytes) and each[0] == protocol.TIME)
        assert abs(int.from_bytes(time[1:9], "little") - 1_700_000_001_000_000_000) < 3_000_000_000


@pytest.mark.slow
def test_a_viewer_sees_and_writes_what_its_token_permits_until_that_ends(
    serve: Callable[..., Any], tmp_path: Path
) -> None:
    file = tmp_path / "auth.toml"
    rules = rule("reader", "read", "/topics/aircraft/**", "/parameters/aircraft/**", "/nodes/aircraft")
    token = f'[[token]]\nagent = "reader"\nsha256 = "{token_digest("secret")}"\n'
    file.write_text(token + rules)
    url = serve("aircraft", "--auth", str(file)).url
    with pytest.raises(InvalidStatus) as refused, viewing(url):
        pass
    assert refused.value.response.status_code == 401
    with viewing(url, additional_headers={"Authorization": "Bearer secret"}) as viewer:
        assert viewer.until_op("serverInfo")["name"] == "rosld"
        viewer.channel(SPEED)
        viewer.op("subscribeConnectionGraph")
        viewer.op("getParameters", parameterNames=[], id="all")
        viewer.until_op("connectionGraphUpdate")
        viewer.until_op("parameterValues")
        viewer.publish(DISPLAY, "std_msgs/String", encoded("std_msgs/msg/String", data="no"))
        viewer.publish(SPEED, "std_msgs/Float64", encoded("std_msgs/msg/Float64", data=1.0))
        viewer.until(lambda each: isinstance(each, dict) and "engine/speed" in each.get("message", ""))
        assert "/cockpit" not in json.dumps([each for each in viewer.received if each["op"] != "status"])
        file.write_text(token + rule("reader", "read", "/topics/cockpit/**"))
        with pytest.raises(ConnectionClosed) as closed:
            viewer.until(lambda _: False)
        assert closed.value.rcvd is not None
        assert "permissions" in closed.value.rcvd.reason
