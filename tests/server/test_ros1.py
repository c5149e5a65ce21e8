"""A real ROS 1 system over HTTP: rosmaster, rospy nodes, roscpp's relay."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.adapters.ros1.system import RosSystem, require_ros, running

HERE = Path(__file__).parent
TYPES = "https://w3id.org/rosld/types/"
ROS = "https://w3id.org/rosld#"
TWIST = f"{TYPES}geometry_msgs/msg/Twist"
VECTOR = f"{TYPES}geometry_msgs/msg/Vector3"
XSD = "http://www.w3.org/2001/XMLSchema#"
DOUBLE = f"{XSD}double"
JSON = {"Accept": "application/json"}


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A rosmaster, and whatever a test starts on it."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        yield system


@pytest.fixture(scope="module")
def robot(ros: Any, start_server: Callable[..., Any]) -> Iterator[Any]:
    """rosld on that system."""
    served = start_server(ros.source)
    yield served
    assert served.stop() == 0


def until(true: Callable[[], Any], what: str, timeout: float = 20.0) -> Any:
    """Wait for something about the robot."""
    end = time.monotonic() + timeout
    while not (found := true()):
        assert time.monotonic() < end, f"never came: {what}"
        time.sleep(0.05)
    return found


def ready(robot: Any, path: str) -> httpx.Response:
    """GET, once it is there."""

    def there() -> httpx.Response | None:
        answer = robot.http.get(path)
        return answer if answer.status_code == 200 else None

    return until(there, path)


def writable(robot: Any, path: str) -> None:
    """Wait until the topic is there and PUT is allowed."""
    ready(robot, path)
    until(lambda: "PUT" in robot.http.options(path).headers.get("allow", ""), f"{path} writable")


def test_a_topic_is_what_rostopic_echo_prints(ros: Any, robot: Any) -> None:
    value = "{header: {frame_id: base}, pose: {position: {x: 1.5, y: -2, z: 0}, orientation: {w: 1}}}"
    publisher = ros.publish("/pose", "geometry_msgs/PoseStamped", value)
    ready(robot, "/topics/pose")
    echoed = ros.echo("/pose")
    read = until(lambda: robot.http.get("/topics/pose", headers=JSON).json(), "a message")
    for message in (echoed, read):
        message["header"].pop("stamp")
        message["header"].pop("seq")
    assert read == echoed
    publisher.stop()


LINEAR = (("x", "0.5"), ("y", "0"), ("z", "0"))
ANGULAR = (("x", "0"), ("y", "0"), ("z", "1"))
BODIES = {
    "text/turtle": f"""@prefix t: <{TWIST}#> . @prefix v: <{VECTOR}#> .
        <#message> a <{TWIST}> ; t:linear [ v:x 0.5 ; v:y 0 ; v:z 0.0 ] ; t:angular [ v:x 0 ; v:y 0 ; v:z 1e0 ] .""",
    "application/ld+json": json.dumps(
        {
            "@id": "#message",
            "@type": TWIST,
            f"{TWIST}#linear": {f"{VECTOR}#{axis}": {"@value": text, "@type": DOUBLE} for axis, text in LINEAR},
            f"{TWIST}#angular": {f"{VECTOR}#{axis}": {"@value": text, "@type": DOUBLE} for axis, text in ANGULAR},
        }
    ),
    "application/rdf+xml": f"""<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:t="{TWIST}#"
        xmlns:v="{VECTOR}#"><rdf:Description rdf:about="#message"><rdf:type rdf:resource="{TWIST}"/>
        <t:linear rdf:parseType="Resource"><v:x rdf:datatype="{XSD}double">0.5</v:x>
        <v:y rdf:datatype="{XSD}double">0</v:y><v:z rdf:datatype="{XSD}double">0</v:z></t:linear>
        <t:angular rdf:parseType="Resource"><v:x rdf:datatype="{XSD}double">0</v:x>
        <v:y rdf:datatype="{XSD}double">0</v:y><v:z rdf:datatype="{XSD}double">1</v:z></t:angular>
        </rdf:Description></rdf:RDF>""",
    "application/n-triples": "\n".join(
        [
            f"<BASE#message> <http://www.w3.org/1999/02/22-rdf-syntax-ns#type> <{TWIST}> .",
            f"<BASE#message> <{TWIST}#linear> _:l .",
            f"<BASE#message> <{TWIST}#angular> _:a .",
            *(f'_:l <{VECTOR}#{axis}> "{text}"^^<{XSD}double> .' for axis, text in LINEAR),
            *(f'_:a <{VECTOR}#{axis}> "{text}"^^<{XSD}double> .' for axis, text in ANGULAR),
        ]
    ),
    "application/json": '{"linear": {"x": 0.5, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 1}}',
}  # fmt: skip


@pytest.mark.parametrize("media_type", BODIES)
def test_what_is_put_in_any_syntax_is_received_by_a_rospy_subscriber(ros: Any, robot: Any, media_type: str) -> None:
    topic = f"/cmd_{media_type.partition('/')[2].replace('+', '_').replace('-', '_')}"
    listener = ros.node("listener.py", topic, "geometry_msgs/Twist")
    path = f"/topics{topic}"
    writable(robot, path)
    body = BODIES[media_type].replace("BASE", robot.topic(topic))
    answer = robot.http.put(path, content=body, headers={"Content-Type": media_type})
    assert answer.status_code == 204, answer.text
    heard = json.loads(listener.line("heard").removeprefix("heard "))
    assert heard == {"linear": {"x": 0.5, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 1.0}}
    listener.stop()


def test_a_service_answers_raises_and_refuses(ros: Any, robot: Any) -> None:
    node = ros.node("services_node.py")
    for name in ("works", "echoes", "raises", "refuses"):
        until(lambda name=name: "POST" in robot.http.options(f"/services/{name}").headers["allow"], name)
    answer = robot.http.post("/services/works", headers=JSON)
    assert (answer.status_code, answer.json()) == (201, {"success": True, "message": "done"})
    echo = robot.http.post("/services/echoes", json={"data": True}, headers=JSON)
    assert echo.json() == {"success": True, "message": "you said True"}
    raised = robot.http.post("/services/raises")
    assert raised.status_code == 422
    assert raised.json()["detail"] == "/raises failed"
    assert "the gripper is jammed" in raised.json()["robotSaid"]
    assert f"<title>{socket.gethostname()}" in robot.http.get("/", headers={"Accept": "text/html"}).text
    kept = robot.http.get(raised.json()["call"])
    assert kept.status_code == 200
    assert "Refused" in kept.text
    refused = robot.http.post("/services/refuses")
    assert refused.status_code == 422
    assert "not today" in refused.json()["robotSaid"]
    node.stop()


def test_a_service_that_hangs_is_504_and_others_answer_meanwhile(ros: Any, start_server: Callable[..., Any]) -> None:
    node = ros.node("services_node.py", "__name:=hanging_node")
    served = start_server(ros.source, "--setting", "call_deadline", "2")
    until(lambda: "POST" in served.http.options("/services/hangs").headers["allow"], "hangs")
    with httpx.Client(base_url=served.url, timeout=15) as other, ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(served.http.post, "/services/hangs")
        node.line("hanging")
        assert other.post("/services/works", headers=JSON).json()["success"] is True
        assert not waiting.done()
        hanging = waiting.result()
    assert hanging.status_code == 504
    assert "OutcomeUnknown" in served.http.get(hanging.json()["call"]).text
    assert served.stop() == 0
    node.kill()


def test_parameters_set_here_are_read_by_rosparam_and_the_other_way_round(ros: Any, robot: Any) -> None:
    assert robot.http.put("/parameters/from/rosld", json=[1, 2.5, "three"]).status_code == 201
    assert ros.yaml(ros.run("/usr/bin/rosparam", "get", "/from/rosld")) == [1, 2.5, "three"]
    ros.run("/usr/bin/rosparam", "set", "/from/rosparam", "4.5")
    assert robot.http.get("/parameters/from/rosparam", headers=JSON).json() == 4.5
    assert robot.http.get("/parameters/from/", headers=JSON).json() == {"rosld": [1, 2.5, "three"], "rosparam": 4.5}
    assert robot.http.delete("/parameters/from/").status_code == 204
    assert "from" not in ros.run("/usr/bin/rosparam", "list")


def test_two_publishers_of_one_topic_are_both_seen(ros: Any, robot: Any) -> None:
    first = ros.publish("/shared", "std_msgs/String", "data: one", name="one")
    second = ros.publish("/shared", "std_msgs/String", "data: two", name="two")

    def both() -> bool:
        text = robot.http.get("/topics/shared", headers={"Accept": "application/n-triples"}).text
        return '"one"' in text and '"two"' in text and text.count(f"<{ROS}latestFrom>") == 2

    until(both, "both publishers' messages")
    first.stop()
    second.stop()


def test_two_types_on_one_topic_are_told_and_not_writable(ros: Any, robot: Any) -> None:
    first = ros.publish("/confused", "std_msgs/String", "data: one", name="stringly")
    second = ros.publish("/confused", "std_msgs/Int32", "data: 2", name="intly")
    ready(robot, "/topics/confused")
    until(
        lambda: (
            f"<{ROS}conflictingType>"
            in robot.http.get("/topics/confused", headers={"Accept": "application/n-triples"}).text
        ),
        "the conflict",
    )
    assert robot.http.put("/topics/confused", json={"data": "x"}).status_code == 405
    first.stop()
    second.stop()


def test_tf_of_three_nodes_is_one_message_that_hides_none(ros: Any, robot: Any) -> None:
    nodes = [ros.node("tf_node.py", child) for child in ("wheel", "arm", "camera")]
    ready(robot, "/topics/tf")

    def frames() -> bool:
        message = robot.http.get("/topics/tf", headers=JSON).json()
        return {each["child_frame_id"] for each in (message or {"transforms": []})["transforms"]} == {
            "wheel",
            "arm",
            "camera",
        }

    until(frames, "three frames")
    assert robot.http.put("/topics/tf", json={"transforms": []}).status_code == 405
    for node in nodes:
        node.stop()


def test_an_image_topic_that_is_also_a_namespace_has_both_urls(ros: Any, robot: Any) -> None:
    raw = ros.publish("/camera/image_raw", "sensor_msgs/Image", "{height: 1, width: 2, data: [1, 2]}", name="camera_a")
    packed = ros.publish("/camera/image_raw/compressed", "sensor_msgs/CompressedImage", "format: jpeg", name="camera_b")
    below = ready(robot, "/topics/camera/image_raw/")
    image = ready(robot, "/topics/camera/image_raw")
    assert "/topics/camera/image_raw/>" in image.text
    assert "/topics/camera/image_raw/compressed" in below.text
    assert until(lambda: robot.http.get("/topics/camera/image_raw?field=data").content == b"\x01\x02", "the bytes")
    assert robot.http.get("/topics/camera", follow_redirects=False).status_code == 308
    raw.stop()
    packed.stop()


def test_roscpp_s_relay_carries_what_is_put(ros: Any, robot: Any) -> None:
    relay = ros.start(["/usr/lib/topic_tools/relay", "/relay_in", "/relay_out"])
    until(lambda: robot.http.get("/topics/relay_in").status_code == 200, "the relay")
    string = f'<#message> a <{TYPES}std_msgs/msg/String> ; <{TYPES}std_msgs/msg/String#data> "through C++" .'
    listener = ros.node("listener.py", "/relay_out", "std_msgs/String")

    def arrives() -> bool:
        answer = robot.http.put("/topics/relay_in", content=string, headers={"Content-Type": "text/turtle"})
        assert answer.status_code in (201, 202, 204), answer.text
        read = robot.http.get("/topics/relay_out", headers=JSON)
        heard = any(line.startswith("heard") for line in listener.seen)  # it connects a moment after the relay speaks
        return heard and read.status_code == 200 and read.json() == {"data": "through C++"}

    until(arrives, "the message at the relay's end")
    assert json.loads(listener.line("heard").removeprefix("heard ")) == {"data": "through C++"}
    relay.stop()
    listener.stop()


def test_reading_leaves_no_trace_and_leaving_unregisters(ros: Any, start_server: Callable[..., Any]) -> None:
    publisher = ros.publish("/watched", "std_msgs/String", "data: x", name="watched_one")
    served = start_server(ros.source)
    ready(served, "/topics/watched")
    subscribers = dict(ros.master.getSystemState("/test")[2][1]).get("/watched", [])
    assert not [name for name in subscribers if "rosld" in name]
    listener = ros.node("listener.py", "/said", "std_msgs/String")
    writable(served, "/topics/said")
    assert served.http.put("/topics/said", json={"data": "x"}).status_code == 204
    assert ros.publishers("/said")
    assert served.stop() == 0
    assert not ros.publishers("/said")
    publisher.stop()
    listener.stop()


def test_the_paper_s_aircraft_as_a_rospy_node_flies_the_same_way(ros: Any, robot: Any, tmp_path: Path) -> None:
    node = ros.node("aircraft_node.py", str(tmp_path))
    for name in ("start", "stop", "get_power", "engine/set_speed"):
        until(lambda name=name: "POST" in robot.http.options(f"/services/aircraft/{name}").headers["allow"], name)

    def call(name: str, **request: object) -> Any:
        return robot.http.post(f"/services/aircraft/{name}", json=request, headers=JSON).json()

    assert call("get_power") == {"data": "off"}
    assert call("engine/set_speed", data=10)["success"] is False
    assert call("start")["success"] is True
    assert call("engine/set_speed", data=20)["success"] is True
    until(lambda: robot.http.get("/topics/aircraft/engine/speed", headers=JSON).json() == {"data": 20.0}, "speed 20")
    assert call("stop")["success"] is False
    node.stop()


def test_a_killed_node_and_a_killed_master_are_survived(tmp_path: Path, start_server: Callable[..., Any]) -> None:
    with running(tmp_path) as system:
        publisher = system.publish("/beat", "std_msgs/String", "data: first", name="heart")
        served = start_server(system.source)
        ready(served, "/topics/beat")
        publisher.kill()
        again = system.publish("/beat", "std_msgs/String", "data: second", name="heart_again")
        until(
            lambda: served.http.get("/topics/beat", headers=JSON).json() == {"data": "second"}, "the new node's message"
        )
        system.kill_master()
        until(lambda: "Stale" in served.http.get("/").text, "the graph stale")
        assert served.http.get("/topics/beat").status_code == 200
        assert served.http.get("/parameters/").status_code == 503
        system.start_master()
        again.stop()
        system.publish("/beat", "std_msgs/String", "data: third", name="heart2")
        until(
            lambda: served.http.get("/topics/beat", headers=JSON).json() == {"data": "third"}, "life after the master"
        )
        assert "Stale" not in served.http.get("/").text
        assert served.stop() == 0


def test_a_robot_that_is_off_when_rosld_starts_is_served_when_it_comes(
    tmp_path: Path, serve: Callable[..., Any]
) -> None:
    require_ros()
    system = RosSystem(tmp_path)
    served = serve(system.source)
    assert "Stale" in served.http.get("/").text
    assert served.http.put("/topics/cmd_vel", json={"linear": {"x": 0.1}}).status_code == 404
    try:
        system.start_master()
        publisher = system.publish("/beat", "std_msgs/String", "data: first", name="heart")
        system.node("listener.py", "/said", "std_msgs/String")
        ready(served, "/topics/beat")
        until(lambda: served.http.get("/topics/beat", headers=JSON).json() == {"data": "first"}, "the robot's message")
        writable(served, "/topics/said")
        assert served.http.put("/topics/said", json={"data": "x"}).status_code == 204
        assert "Stale" not in served.http.get("/").text
        assert served.http.get("/status", headers=JSON).json()["robot"]["state"] == "Live"
        publisher.stop()
        assert served.stop() == 0
    finally:
        system.close()


def test_a_type_that_is_nested_in_a_nodes_own_type_has_its_page_and_its_shape(ros: Any, robot: Any) -> None:
    node = ros.node("gripper_node.py")
    ready(robot, "/topics/grip")
    until(lambda: robot.http.get("/topics/grip", headers=JSON).json(), "a message")
    for name in ("Grip", "Tip"):
        for room in ("types", "shapes"):
            assert robot.http.get(f"/{room}/gripper_own/msg/{name}").status_code == 200, (room, name)
    assert "in newtons" in robot.http.get("/types/gripper_own/msg/Tip", headers={"Accept": "text/turtle"}).text
    node.stop()
