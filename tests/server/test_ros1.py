"""A real ROS 1 system over HTTP: rosmaster, rospy nodes, and their failures."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.adapters.ros1.system import RosSystem, running
from tests.server.conftest import Served
from tests.waiting import until

pytestmark = pytest.mark.slow

SHIPPED = Path(__file__).parents[2] / "adapters" / "aircraft"
TYPES = "https://w3id.org/rosld/types/"
ROS = "https://w3id.org/rosld#"
TWIST, VECTOR = f"{TYPES}geometry_msgs/msg/Twist", f"{TYPES}geometry_msgs/msg/Vector3"
JSON, NTRIPLES = {"Accept": "application/json"}, {"Accept": "application/n-triples"}
POSE = "{header: {frame_id: base}, pose: {position: {x: 1.5, y: -2, z: 0}, orientation: {w: 1}}}"
SPOKEN = {
    "/pose": ("geometry_msgs/PoseStamped", POSE),
    "/shared": ("std_msgs/String", "data: one"),
    "/confused": ("std_msgs/String", "data: one"),
    "/tf": ("tf2_msgs/TFMessage", "transforms: [{child_frame_id: wheel}]"),
    "/camera/image_raw": ("sensor_msgs/Image", "{height: 1, width: 2, data: [1, 2]}"),
}
ALSO_SPOKEN = {
    "/shared": ("std_msgs/String", "data: two"),
    "/confused": ("std_msgs/Int32", "data: 2"),
    "/tf": ("tf2_msgs/TFMessage", "transforms: [{child_frame_id: arm}]"),
    "/camera/image_raw/compressed": ("sensor_msgs/CompressedImage", "format: jpeg"),
}


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A rosmaster with two nodes that publish."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        for name, spoken in (("speaker", SPOKEN), ("other", ALSO_SPOKEN)):
            words = [word for topic, (type, value) in spoken.items() for word in (topic, type, value)]
            system.node("speaking_node.py", name, *words)
        yield system


@pytest.fixture(scope="module")
def robot(ros: RosSystem, start_server: Callable[..., Served]) -> Served:
    """rosld on that system."""
    return start_server(ros.source, "--setting", "call_deadline", "2")


def ready(robot: Served, path: str) -> httpx.Response:
    """Return the response to GET, once the resource exists."""
    found: httpx.Response = until(lambda: (got := robot.http.get(path)).status_code == 200 and got, path)
    return found


def writable(robot: Served, path: str, method: str = "PUT") -> None:
    """Wait until a resource exists and accepts a method."""
    ready(robot, path)
    until(lambda: method in robot.http.options(path).headers.get("allow", ""), f"{method} {path}")


def heard(listener: Any) -> Any:
    return json.loads(listener.line("heard").removeprefix("heard "))


def test_the_first_query_sees_the_value_of_a_topic_that_nobody_was_subscribed_to(
    ros: RosSystem, start_server: Callable[..., Served]
) -> None:
    robot = start_server(ros.source, "--setting", "first_value_wait", "20")
    query = "SELECT ?age { <topics/pose> ros:latest ?message BIND(ros:age(<topics/pose>) AS ?age) }"
    answer = robot.http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    assert 0 <= float(answer.text.split()[1]) < 60
    assert robot.stop() == 0


def test_several_publishers_of_one_topic_are_all_seen(robot: Served) -> None:
    def all_are_seen() -> bool:
        text = robot.http.get("/topics/shared", headers=NTRIPLES).text
        confused = robot.http.get("/topics/confused", headers=NTRIPLES).text
        frames = (robot.http.get("/topics/tf", headers=JSON).json() or {"transforms": []})["transforms"]
        return (
            '"one"' in text
            and '"two"' in text
            and text.count(f"<{ROS}latestFrom>") == 2
            and f"<{ROS}conflictingType>" in confused
            and {each["child_frame_id"] for each in frames} == {"wheel", "arm"}
        )

    until(all_are_seen, "the messages of both")
    assert robot.http.put("/topics/confused", json={"data": "x"}).status_code == 405
    assert robot.http.put("/topics/tf", json={"transforms": []}).status_code == 405


def test_an_image_topic_that_is_also_a_namespace_has_both_urls(robot: Served) -> None:
    below = ready(robot, "/topics/camera/image_raw/")
    image = ready(robot, "/topics/camera/image_raw")
    assert "/topics/camera/image_raw/>" in image.text
    assert "/topics/camera/image_raw/compressed" in below.text
    until(lambda: robot.http.get("/topics/camera/image_raw?field=data").content == b"\x01\x02", "the bytes")
    assert robot.http.get("/topics/camera", follow_redirects=False).status_code == 308


def test_what_is_put_is_received_by_a_rospy_subscriber(ros: RosSystem, robot: Served) -> None:
    listener = ros.node("listener.py", "/cmd", "geometry_msgs/Twist")
    writable(robot, "/topics/cmd")
    bodies = {
        "text/turtle": f"""@prefix t: <{TWIST}#> . @prefix v: <{VECTOR}#> .
            <#message> a <{TWIST}> ; t:linear [ v:x 0.5 ; v:y 0 ; v:z 0.0 ] ;
            t:angular [ v:x 0 ; v:y 0 ; v:z 1e0 ] .""",
        "application/json": '{"linear": {"x": 0.5, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 1}}',
    }
    for media_type, body in bodies.items():
        answer = robot.http.put("/topics/cmd", content=body, headers={"Content-Type": media_type})
        assert answer.status_code == 204, answer.text
        assert heard(listener) == {"linear": {"x": 0.5, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 1.0}}
    listener.stop()


def test_a_service_answers_raises_refuses_and_hangs_while_others_answer(ros: RosSystem, robot: Served) -> None:
    node = ros.node("services_node.py")
    for name in ("works", "echoes", "raises", "refuses", "hangs"):
        writable(robot, f"/services/{name}", "POST")
    answer = robot.http.post("/services/works", headers=JSON)
    assert (answer.status_code, answer.json()) == (201, {"success": True, "message": "done"})
    echo = robot.http.post("/services/echoes", json={"data": True}, headers=JSON)
    assert echo.json() == {"success": True, "message": "you said True"}
    raised = robot.http.post("/services/raises")
    assert raised.status_code == 422
    assert raised.json()["detail"] == "/raises failed"
    assert "the gripper is jammed" in raised.json()["robotSaid"]
    assert "Refused" in robot.http.get(raised.json()["call"]).text
    assert "not today" in robot.http.post("/services/refuses").json()["robotSaid"]
    with httpx.Client(base_url=robot.url, timeout=15) as other, ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(robot.http.post, "/services/hangs")
        node.line("hanging")
        assert other.post("/services/works", headers=JSON).json()["success"] is True
        assert not waiting.done()
        hanging = waiting.result()
    assert hanging.status_code == 504
    assert "OutcomeUnknown" in robot.http.get(hanging.json()["call"]).text
    assert f"<title>{socket.gethostname()}" in robot.http.get("/", headers={"Accept": "text/html"}).text
    node.kill()


def test_a_type_that_is_nested_in_a_nodes_own_type_has_its_page_and_its_shape(ros: RosSystem, robot: Served) -> None:
    node = ros.node("gripper_node.py")
    ready(robot, "/topics/grip")
    until(lambda: robot.http.get("/topics/grip", headers=JSON).json(), "a message")
    for name in ("Grip", "Tip"):
        for room in ("types", "shapes"):
            assert robot.http.get(f"/{room}/gripper_own/msg/{name}").status_code == 200, (room, name)
    assert "in newtons" in robot.http.get("/types/gripper_own/msg/Tip", headers={"Accept": "text/turtle"}).text
    node.stop()


def test_the_paper_s_aircraft_as_a_rospy_node_is_flown_by_its_resources(
    ros: RosSystem, start_server: Callable[..., Served], tmp_path: Path
) -> None:
    node = ros.node("aircraft_node.py", str(tmp_path))
    mapping = ("--mapping", str(SHIPPED / "mapping.ttl"), "--shapes", str(SHIPPED / "limits.ttl"))
    robot = start_server(ros.source, *mapping)
    aircraft = "/resources/aircraft"
    until(lambda: robot.http.get(f"{aircraft}/", headers=JSON).json() == {"power": "off"}, "the aircraft, off")
    for service in ("start", "stop", "engine/set_speed"):
        writable(robot, f"/services/aircraft/{service}", "POST")
    assert robot.http.put(f"{aircraft}/engine/speed", json=20).status_code == 404, "there is no engine yet"
    assert robot.http.post(f"{aircraft}/start").status_code == 200
    assert robot.http.put(f"{aircraft}/engine/speed", json=5000).status_code == 422
    assert robot.http.put(f"{aircraft}/engine/speed", json=20).status_code == 204
    until(lambda: robot.http.get(f"{aircraft}/engine/speed", headers=JSON).json() == 20.0, "the speed")
    assert robot.http.post(f"{aircraft}/stop").status_code == 409
    assert robot.http.put(f"{aircraft}/engine/speed", json=0).status_code == 204
    until(lambda: robot.http.post(f"{aircraft}/stop").status_code == 200, "the stop")
    assert robot.http.get(f"{aircraft}/", headers=JSON).json() == {"power": "off"}
    assert robot.stop() == 0
    node.stop()


def test_a_killed_node_and_a_killed_master_are_survived(tmp_path: Path, start_server: Callable[..., Served]) -> None:
    with running(tmp_path) as system:
        publisher = system.publish("/beat", "std_msgs/String", "data: first", name="heart")
        served = start_server(system.source)

        def beats(word: str) -> None:
            until(lambda: served.http.get("/topics/beat", headers=JSON).json() == {"data": word}, word)

        ready(served, "/topics/beat")
        publisher.kill()
        again = system.publish("/beat", "std_msgs/String", "data: second", name="heart_again")
        beats("second")
        system.kill_master()
        until(lambda: "Stale" in served.http.get("/").text, "the graph stale")
        assert served.http.get("/topics/beat").status_code == 200
        assert served.http.get("/parameters/").status_code == 503
        system.start_master()
        again.stop()
        system.publish("/beat", "std_msgs/String", "data: third", name="heart2")
        beats("third")
        assert "Stale" not in served.http.get("/").text
        assert served.stop() == 0


def test_a_robot_that_is_off_when_rosld_starts_is_served_when_it_comes(
    tmp_path: Path, serve: Callable[..., Served]
) -> None:
    with running(tmp_path) as system:
        system.kill_master()
        served = serve(system.source)
        assert "Stale" in served.http.get("/").text
        assert served.http.put("/topics/cmd_vel", json={"linear": {"x": 0.1}}).status_code == 404
        system.start_master()
        system.publish("/beat", "std_msgs/String", "data: first", name="heart")
        system.node("listener.py", "/said", "std_msgs/String")
        ready(served, "/topics/beat")
        until(lambda: served.http.get("/topics/beat", headers=JSON).json() == {"data": "first"}, "the robot's message")
        writable(served, "/topics/said")
        assert served.http.put("/topics/said", json={"data": "x"}).status_code == 204
        assert served.http.get("/status", headers=JSON).json()["robot"]["state"] == "Live"
        assert served.stop() == 0
        assert not system.publishers("/said"), "to leave unregisters"
