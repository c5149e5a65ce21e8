"""A real ROS 1 system over HTTP: rosmaster, rospy nodes, and their failures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from tests.adapters.ros1.system import RosSystem, running
from tests.server.conftest import Served
from tests.waiting import until

pytestmark = pytest.mark.slow

SHIPPED = Path(__file__).parents[2] / "adapters" / "aircraft"
ROS = "https://w3id.org/rosld#"
JSON, NTRIPLES = {"Accept": "application/json"}, {"Accept": "application/n-triples"}
SPOKEN = {
    "/shared": ("std_msgs/String", "data: one"),
    "/confused": ("std_msgs/String", "data: one"),
    "/tf": ("tf2_msgs/TFMessage", "transforms: [{child_frame_id: wheel}]"),
}
ALSO_SPOKEN = {
    "/shared": ("std_msgs/String", "data: two"),
    "/confused": ("std_msgs/Int32", "data: 2"),
    "/tf": ("tf2_msgs/TFMessage", "transforms: [{child_frame_id: arm}]"),
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
