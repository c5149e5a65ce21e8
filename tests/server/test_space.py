"""Views of space and files of point clouds over HTTP: drawings and refusals."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image

from tests.server.robots.made_up import MadeUp, served
from tests.server.robots.point_clouds import CLOUD, cloud_message

JSON = {"Accept": "application/json"}
STREAM = {"Accept": "text/event-stream"}
OCTETS = {"Accept": "application/octet-stream"}
PlyData = pytest.importorskip("plyfile").PlyData
GRID, POSE, TF = "nav_msgs/msg/OccupancyGrid", "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"


def events(http: httpx.Client, query: str, until: Callable[[list[Any]], bool]) -> list[Any]:
    """Return events of a view, until a condition holds."""
    found: list[Any] = []
    with http.stream("GET", f"/space{query}", headers=STREAM, timeout=60) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream"), stream.read()
        for line in stream.iter_lines():
            if line.startswith("data: "):
                found.append(json.loads(line.removeprefix("data: ")))
                if until(found):
                    return found
    raise AssertionError("the stream ended")


def things(found: list[Any], place: int) -> list[Any]:
    return [each for event in found for each in event.get("things", []) if each["place"] == place]


def test_a_view_tells_what_is_drawn_and_where_its_frame_is(rover: httpx.Client) -> None:
    told = rover.get("/space", headers=JSON).json()
    assert told["frame"] == "map"
    found = {each["topic"].rpartition("/")[2]: each for each in told["show"]}
    assert found.keys() == {"map", "scan", "odom"}
    assert {each["problem"] for each in found.values()} == {""}
    pose = rover.get("/topics/odom", headers=JSON).json()["pose"]["pose"]["position"]
    assert found["scan"]["frame"] == "laser"
    assert found["scan"]["pose"][:3] == pytest.approx([pose["x"], pose["y"], 0.25], abs=0.01)


def test_the_stream_tells_scans_as_they_come_and_what_stays_once(rover: httpx.Client) -> None:
    found = events(rover, "", lambda all: len(things(all, 1)) > 3 and any("frames" in each for each in all))
    assert [each["label"] for each in found[0]["show"]] == ["/map", "/scan", "/odom"]
    (grid,) = things(found, 0)
    assert grid["drawing"]["grid"]["size"] == pytest.approx([10, 8])
    assert rover.get(grid["picture"]).headers["content-type"] == "image/png"
    scan = things(found, 1)[-1]
    assert len(scan["drawing"]["points"]["x"]) == len(scan["drawing"]["points"]["y"]) > 100
    frames = next(each["frames"] for each in found if "frames" in each)
    assert {each["name"]: each["parent"] for each in frames} == {
        "map": None, "odom": "map", "base_link": "odom", "laser": "base_link", "camera_optical_frame": "base_link",
    }  # fmt: skip


def test_points_of_a_cloud_are_streamed_only_to_readers_that_do_not_read_its_file() -> None:
    robot = MadeUp()
    robot.topic("/points", CLOUD, cloud_message(np.eye(3)))
    with served(robot) as http:
        for view, drawn in (("3d", set()), ("above", {"points"})):
            found = events(http, f"?show=topics/points&view={view}", lambda all: bool(things(all, 0)))
            (told,) = things(found, 0)
            assert told["drawing"].keys() == drawn
        assert http.get(told["cloud"]).content.startswith(b"ply")


def test_a_missing_frame_is_a_problem(rover: httpx.Client) -> None:
    told = rover.get("/space", params={"frame": "moon", "show": "topics/scan"}, headers=JSON).json()
    assert told["show"][0]["problem"] == "There is no frame called moon"
    page = rover.get("/space?frame=moon", headers={"Accept": "text/html"}).text
    assert "There is no frame called moon: there are base_link, " in page
    (event,) = events(rover, "?frame=moon&show=topics/scan", lambda all: bool(things(all, 0)))
    assert things([event], 0)[0]["problem"] == "There is no frame called moon"


def test_a_view_that_cannot_be_drawn_is_refused_in_words(rover: httpx.Client) -> None:
    for query, status, words in (
        ("show=nodes/rover", 400, "does not name a topic"),
        ("show=topics/scan%23ranges", 400, "does not name a topic"),
        ("show=topics/nothing", 404, "There is no topic /nothing"),
        ("show=topics/imu", 422, "has messages of sensor_msgs/msg/Imu"),
        (f"frame={'x' * 301}", 400, "is too long"),
        ("view=4d", 400, "there are above and 3d"),
    ):
        answer = rover.get(f"/space?{query}", headers=STREAM)
        assert (answer.status_code, words in answer.json()["detail"]) == (status, True), (query, answer.text)


def test_hostile_messages_are_problems_and_delay_nothing() -> None:
    robot = MadeUp()
    turned = {"base": {"rotation": {"w": "NaN"}}, "odom": {"rotation": {"w": 1.0}}}
    transforms = [
        {"header": {"frame_id": "map"}, "child_frame_id": child, "transform": each} for child, each in turned.items()
    ]
    robot.topic("/tf", TF, {"transforms": transforms})
    robot.topic("/goal", POSE, {"header": {"frame_id": "base"}, "pose": {"orientation": {"w": 1.0}}})
    robot.topic("/grid", GRID, {"info": {"width": 3, "height": 2, "resolution": "NaN"}})
    with served(robot) as http:
        told = {each["topic"].rpartition("/")[2]: each for each in http.get("/space", headers=JSON).json()["show"]}
        assert http.get("/topics/grid", headers={"Accept": "image/png"}).status_code == 422
        robot.publishes("/grid", {"info": {"width": 5000, "height": 1, "resolution": 0.1}, "data": [100] + [0] * 4999})
        answer = http.get("/topics/grid?format=png&width=1000")
    assert told["goal"]["problem"].startswith("There is no frame called base: The quaternion (0, 0, 0, nan)")
    assert told["grid"]["problem"] == "The cells of the grid are nan m wide"
    picture = np.asarray(Image.open(io.BytesIO(answer.content)))
    assert picture.shape == (1, 1000)
    assert picture[0, :2].tolist() == [101, 1], "a wall stays, whatever is beside it"


def test_frames_are_a_tree(rover: httpx.Client) -> None:
    frames = rover.get("/frames", headers=JSON).json()["frames"]
    assert [(each["name"], each["parent"], each["static"]) for each in frames] == [
        ("map", None, False),
        ("odom", "map", False),
        ("base_link", "odom", False),
        ("camera_optical_frame", "base_link", True),
        ("laser", "base_link", True),
    ]
    assert frames[4]["publishers"] == [f"{rover.base_url}nodes/rover"]
    assert {each["problem"] for each in frames} == {""}
    assert "<#laser>" in rover.get("/frames", headers={"Accept": "text/turtle"}).text


def test_a_quaternion_of_zeros_is_drawn_without_a_rotation() -> None:
    robot, zeros = MadeUp(), dict.fromkeys("xyzw", 0.0)
    info = {"width": 3, "height": 2, "resolution": 1.0, "origin": {"position": {"x": 2.0}, "orientation": zeros}}
    robot.topic("/grid", GRID, {"header": {"frame_id": "map"}, "info": info, "data": [0] * 6})
    robot.topic("/goal", POSE, {"header": {"frame_id": "map"}, "pose": {"orientation": zeros}})
    with served(robot) as http:
        found = events(http, "?show=topics/grid&show=topics/goal", lambda all: bool(things(all, 0) and things(all, 1)))
    ((grid,), (goal,)) = things(found, 0), things(found, 1)
    assert (grid["problem"], goal["problem"]) == ("", "")
    assert grid["drawing"]["grid"]["origin"] == [2, 0, 0, 0, 0, 0, 1]
    assert goal["drawing"]["arrows"] == [[0, 0, 0, 0, 0, 0, 1]]


def test_frames_of_two_trees_of_a_loop_and_without_a_rotation_have_words() -> None:
    upright, none = {"rotation": {"w": 1.0}}, {"rotation": {"w": "NaN"}}
    zeros = {"rotation": dict.fromkeys("xyzw", 0.0)}
    said = [("map", "base", upright), ("one", "two", upright), ("two", "one", upright), ("map", "arm", none)]
    said.append(("base", "unset", zeros))
    transforms = [
        {"header": {"frame_id": parent}, "child_frame_id": child, "transform": each} for parent, child, each in said
    ]
    robot = MadeUp()
    robot.topic("/tf", TF, {"transforms": transforms})
    with served(robot) as http:
        frames = {each["name"]: each for each in http.get("/frames", headers=JSON).json()["frames"]}
        problems = {name: each["problem"] for name, each in frames.items()}
        page = http.get("/frames", headers={"Accept": "text/html"}).text
    assert problems["base"] == ""
    assert "its own ancestor" in problems["one"] + problems["two"]
    assert "is not a rotation" in problems["arm"]
    assert problems["unset"].startswith("Its quaternion is all zero")
    assert frames["unset"]["pose"] == [0, 0, 0, 0, 0, 0, 1]
    assert "2 unconnected trees" in page


@pytest.fixture(scope="module")
def clouds() -> Iterator[httpx.Client]:
    made = MadeUp()
    made.topic("/points", CLOUD, cloud_message(np.arange(90_000).reshape(-1, 3)))
    made.topic("/odd", CLOUD, cloud_message(np.zeros((3, 3)), point_step=0))
    made.topic("/silent", CLOUD, published=False)
    made.topic("/words", "std_msgs/msg/String", {"data": "<b>"})
    with served(made) as http:
        yield http


def test_a_cloud_is_a_ply_file_beside_all_that_it_is_besides(clouds: httpx.Client) -> None:
    answer = clouds.get("/topics/points", headers=OCTETS)
    assert answer.headers["content-type"] == "application/octet-stream"
    assert PlyData.read(io.BytesIO(answer.content))["vertex"].count == 20_000
    known = clouds.get("/topics/points", headers={**OCTETS, "If-None-Match": answer.headers["etag"]})
    assert known.status_code == 304
    few = PlyData.read(io.BytesIO(clouds.get("/topics/points?format=ply&points=5").content))
    assert few["vertex"]["x"].tolist() == [0, 22497, 44997, 67497, 89997]
    assert "comment frame lidar" in few.header
    assert clouds.get("/topics/points").headers["content-type"].startswith("text/turtle")
    assert clouds.get("/topics/points?field=width", headers=OCTETS).text == "30000"
    assert "?format=ply" in clouds.get("/topics/points", headers={"Accept": "text/html"}).text


@pytest.mark.slow
def test_a_message_that_is_no_cloud_is_refused_in_words(clouds: httpx.Client) -> None:
    for path, status, words in (
        ("odd?format=ply", 422, "0 bytes long"),
        ("silent?format=ply", 404, "no message yet"),
        ("words?format=ply", 406, "only sensor_msgs/msg/PointCloud2"),
        ("words", 406, "application/octet-stream"),
        ("points?format=ply&points=0", 400, "from 1 to 200000"),
        ("points?format=ply&points=1e4", 400, "from 1 to 200000"),
    ):
        answer = clouds.get(f"/topics/{path}", headers=OCTETS)
        assert (answer.status_code, words in answer.json()["detail"]) == (status, True), (path, answer.text)
