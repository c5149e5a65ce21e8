"""Point clouds of topics over HTTP: files of points by content negotiation, and dots in views of space."""

from __future__ import annotations

import io
from collections.abc import Iterator

import httpx
import numpy as np
import pytest

from tests.server.robots.made_up import MadeUp, served
from tests.server.robots.point_clouds import CLOUD, cloud_message

PlyData = pytest.importorskip("plyfile").PlyData
OCTETS = {"Accept": "application/octet-stream"}


@pytest.fixture(scope="module")
def robot() -> Iterator[httpx.Client]:
    made = MadeUp()
    made.topic("/points", CLOUD, cloud_message(np.arange(90_000).reshape(-1, 3)))
    made.topic("/odd", CLOUD, cloud_message(np.zeros((3, 3)), point_step=0))
    made.topic("/silent", CLOUD, published=False)
    made.topic("/words", "std_msgs/msg/String", {"data": "<b>"})
    with served(made) as http:
        yield http


def test_a_cloud_is_a_ply_file_beside_all_that_it_is_besides(robot: httpx.Client) -> None:
    answer = robot.get("/topics/points", headers=OCTETS)
    assert answer.headers["content-type"] == "application/octet-stream"
    assert PlyData.read(io.BytesIO(answer.content))["vertex"].count == 20_000
    known = robot.get("/topics/points", headers={**OCTETS, "If-None-Match": answer.headers["etag"]})
    assert known.status_code == 304
    few = PlyData.read(io.BytesIO(robot.get("/topics/points?format=ply&points=5").content))
    assert few["vertex"]["x"].tolist() == [0, 22497, 44997, 67497, 89997]
    assert "comment frame lidar" in few.header
    assert robot.get("/topics/points").headers["content-type"].startswith("text/turtle")
    assert robot.get("/topics/points?field=width", headers=OCTETS).text == "30000"
    assert "?format=ply" in robot.get("/topics/points", headers={"Accept": "text/html"}).text


@pytest.mark.parametrize(
    ("path", "status", "words"),
    [
        ("odd?format=ply", 422, "0 bytes long"),
        ("silent?format=ply", 404, "no message yet"),
        ("words?format=ply", 406, "only sensor_msgs/msg/PointCloud2"),
        ("words", 406, "application/octet-stream"),
        ("points?format=ply&points=0", 400, "from 1 to 200000"),
        ("points?format=ply&points=1e4", 400, "from 1 to 200000"),
    ],
)
def test_what_is_no_cloud_is_refused_in_words(robot: httpx.Client, path: str, status: int, words: str) -> None:
    answer = robot.get(f"/topics/{path}", headers=OCTETS)
    assert answer.status_code == status, answer.text
    assert words in answer.json()["detail"]


def test_a_view_of_space_draws_a_cloud_as_dots_and_says_what_is_wrong(robot: httpx.Client) -> None:
    told = robot.get("/space", headers={"Accept": "application/json"}).json()["show"]
    found = {each["topic"].rpartition("/")[2]: each for each in told}
    assert (found["points"]["kind"], found["points"]["frame"]) == ("Point cloud", "lidar")
    assert found["points"]["problem"] == ""
    assert "0 bytes long" in found["odd"]["problem"]
