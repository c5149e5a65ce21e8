"""Recordings over HTTP: created from the past and the present, followed, ended, downloaded, uploaded, deleted."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from rosbags import rosbag1

from tests.adapters.recording.recorder import lines, write_rosbag1, write_rosbag2
from tests.server.auth.conftest import rule, token, tokens
from tests.server.disks.server import free_port
from tests.server.history.mcap_files import decode, read
from tests.waiting import until

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}
NTRIPLES = {"Accept": "application/n-triples"}
MERGE_PATCH = {"Content-Type": "application/merge-patch+json"}
SPEED = "/aircraft/engine/speed"
RESULTS = {"Accept": "application/sparql-results+json"}
ROS = "https://w3id.org/rosld#"
UNKNOWN = "application/octet-stream"


@pytest.fixture(scope="module")
def recorded(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The aircraft with a history of one topic."""
    data = tmp_path_factory.mktemp("data")
    server = start_server("aircraft", "--history", SPEED, "--data", str(data))
    server.data = data
    return server


def value(http: Any, path: str, term: str) -> str | None:
    """Return a value in the description of a recording."""
    subject = f"<{str(http.base_url).rstrip('/')}{path}> <{ROS}{term}> "
    found = http.get(path, headers=NTRIPLES).text.splitlines()
    return next((line.split('"')[1] for line in found if line.startswith(subject) and '"' in line), None)


def count(http: Any, path: str) -> int:
    return int(value(http, path, "count") or 0)


def end(http: Any, path: str) -> None:
    answer = http.patch(path, content='{"status": "ended"}', headers=MERGE_PATCH)
    assert answer.status_code == 200, answer.text


def download(http: Any, path: str, folder: Path) -> Path:
    """Download the file of a recording."""
    answer = http.get(f"{path}file")
    assert answer.status_code == 200
    file = folder / "download.mcap"
    file.write_bytes(answer.content)
    return file


def test_a_recording_begins_in_the_past_is_followed_ended_and_downloaded(recorded: Any, tmp_path: Path) -> None:
    http = recorded.http
    until(lambda: count(http, "/bags/history/") >= 40, "a past")
    past = count(http, "/bags/history/")
    answer = http.post("/bags/", json={"name": "flight", "topics": [SPEED], "before": 3600})
    assert answer.status_code == 201, answer.text
    assert answer.headers["location"] == f"{recorded.url}bags/flight/"
    assert f"{recorded.url}bags/flight/" in http.get("/bags/", headers=NTRIPLES).text
    assert value(http, "/bags/flight/", "recordingStatus") == "recording"
    until(lambda: count(http, "/bags/flight/") >= past + 20, "the past and the present")
    assert http.get("/bags/flight/messages/0").status_code == 404
    end(http, "/bags/flight/")
    assert value(http, "/bags/flight/", "recordingStatus") is None
    found = read(download(http, "/bags/flight/", tmp_path))
    assert len(found) == count(http, "/bags/flight/") >= past + 20
    times = [one.time_ns for one in sorted(found, key=lambda one: one.sequence)]
    assert times == sorted(set(times)), "nothing twice, and in order"
    gaps = [after - before for before, after in pairwise(times)]
    assert max(gaps) < 30 * sorted(gaps)[len(gaps) // 2], "nothing is missing where the past ends"
    assert len(decode(download(http, "/bags/flight/", tmp_path))) == len(found)
    assert http.get("/bags/flight/messages/0", headers=JSON).json() == {"data": 0.0}
    assert http.delete("/bags/flight/").status_code == 204
    assert http.get("/bags/flight/").status_code == 404


def test_a_recording_is_ordered_in_rdf_as_in_json_and_named_by_a_slug_where_that_is_free(recorded: Any) -> None:
    body = f'<> <{ROS}recordsTopic> "{SPEED}" ; <{ROS}name> "in-rdf" ; <{ROS}secondsLong> 1000 .'
    made = [recorded.http.post("/bags/", content=body, headers={"Content-Type": "text/turtle"})]
    assert value(recorded.http, "/bags/in-rdf/", "secondsLong") == "1000.0"
    made += [recorded.http.post("/bags/", json={"topics": [SPEED]}, headers={"Slug": "walk"}) for _ in range(2)]
    places = [answer.headers["location"] for answer in made]
    assert places[:2] == [f"{recorded.url}bags/in-rdf/", f"{recorded.url}bags/walk/"]
    assert len(set(places)) == 3
    for place in places:
        assert recorded.http.delete(place).status_code == 204


def test_an_order_that_makes_no_sense_is_refused_and_says_why(recorded: Any) -> None:
    before = recorded.http.get("/bags/", headers=NTRIPLES).text
    orders: list[tuple[Any, int]] = [
        ({"topics": []}, 422),
        ({"topics": "/odom"}, 422),
        ({"topics": ["odom"]}, 422),
        ({"topics": ["/a"], "before": -1}, 422),
        ({"topics": ["/a"], "duration": "long"}, 422),
        ({"topics": ["/a"], "duration": True}, 422),
        ({"topics": ["/a"], "name": "../../etc/passwd"}, 422),
        ({"topics": ["/a"], "name": ".hidden"}, 422),
        ({"topics": ["/a"], "colour": "red"}, 422),
        ({"topics": ["/a"], "name": "history"}, 409),
        ([], 422),
    ]
    for order, status in orders:
        answer = recorded.http.post("/bags/", json=order, headers=JSON)
        assert (answer.status_code, len(answer.json()["detail"]) > 20) == (status, True), order
    assert recorded.http.get("/bags/", headers=NTRIPLES).text == before


def test_a_file_comes_in_ranges_is_not_sent_twice_and_is_no_bag_of_another_ros(recorded: Any, tmp_path: Path) -> None:
    http, path = recorded.http, write_rosbag1(tmp_path / "talk.bag", lines(count=500))
    whole = path.read_bytes()
    assert http.put("/bags/talk", content=whole).status_code == 201
    answer = http.get("/bags/talk/file", headers={"Range": "bytes=4-103"})
    assert answer.status_code == 206
    assert answer.content == whole[4:104]
    again = http.get("/bags/talk/file", headers={"If-None-Match": answer.headers["etag"]})
    assert again.status_code == 304
    rest = http.get("/bags/talk/file", headers={"Range": "bytes=100-", "If-Range": answer.headers["etag"]})
    assert rest.content == whole[100:]
    assert http.head("/bags/talk/file").headers["content-length"] == str(len(whole))
    ended = http.patch("/bags/talk/", content='{"status": "ended"}', headers=MERGE_PATCH | JSON)
    assert ended.status_code == 422
    assert ended.json()["detail"].startswith("A recording takes tags and events: send ")
    assert http.get("/bags/talk/file?format=bag").content == whole
    for accept in ("*/*", "text/html,*/*;q=0.8", "application/x-tar;q=0.1, application/octet-stream"):
        assert http.get("/bags/talk/file", headers={"Accept": accept}).headers["content-type"] == UNKNOWN
    for url, words in (
        ("/bags/talk/file?format=rosbag2", "The messages of talk are of ROS 1, which a ROS 2 bag"),
        ("/bags/talk/file?format=zip", "?format=zip is unknown: there are ?format=bag and ?format=rosbag2"),
    ):
        refused = http.get(url, headers=JSON)
        assert (refused.status_code, words in refused.json()["detail"]) == (406, True), refused.text
    assert http.delete("/bags/talk/").status_code == 204


def test_a_bag_is_made_of_what_was_recorded_and_nothing_of_it_is_left(recorded: Any, tmp_path: Path) -> None:
    http = recorded.http
    http.post("/bags/", json={"name": "flown", "topics": [SPEED]})
    until(lambda: count(http, "/bags/flown/") >= 20, "messages")
    end(http, "/bags/flown/")
    head = http.head("/bags/flown/file?format=bag")
    assert (head.status_code, head.headers["content-type"]) == (200, "application/x-rosbag")
    bag = tmp_path / "flown.bag"
    bag.write_bytes(http.get("/bags/flown/file?format=bag").content)
    with rosbag1.Reader(bag) as reader:
        found = [(time, bytes(data)) for _, time, data in reader.messages()]
    kept = read(download(http, "/bags/flown/", tmp_path))
    assert found == [(one.time_ns, one.data) for one in sorted(kept, key=lambda one: one.sequence)]
    assert not [each for each in Path(recorded.data, "bags").iterdir() if each.name.startswith(".")]
    assert http.delete("/bags/flown/").status_code == 204


def test_a_recording_that_is_sent_is_read_like_any_other_also_after_a_restart(
    serve: Callable[..., Any], tmp_path: Path
) -> None:
    sent = {"bag": write_rosbag1(tmp_path / "talk.bag", lines()).read_bytes()}
    for kind, storage in (("mcap", "mcap"), ("db3", "sqlite3")):
        folder = write_rosbag2(tmp_path / kind, lines(), storage=storage)
        sent[kind] = next(folder.glob(f"*.{kind}")).read_bytes()
    port = str(free_port())
    for run in range(2):
        server = serve("aircraft", "--data", str(tmp_path / "data"), "--port", port)
        for kind, content in sent.items():
            if run == 0:
                answer = server.http.put(f"/bags/{kind}", content=content)
                assert answer.status_code == 201, answer.text
                assert answer.headers["location"].endswith(f"/bags/{kind}/")
            assert server.http.get(f"/bags/{kind}/messages/3", headers=JSON).json() == {"data": "3"}
            assert server.http.get(f"/bags/{kind}/file").content == content
            assert server.http.get(f"/bags/{kind}", follow_redirects=False).status_code == 308
            assert server.http.put(f"/bags/{kind}", content=content).status_code == 409
        assert server.stop() == 0


def test_what_is_no_recording_is_refused_and_leaves_nothing(recorded: Any, tmp_path: Path) -> None:
    torn = write_rosbag1(tmp_path / "talk.bag", lines()).read_bytes()[:60]
    mcap, sqlite = b"\x89MCAP0\r\n" + b"\xff" * 100, b"SQLite format 3\0" + b"y" * 999
    for body in (b"", b"hello", b"x" * 10_000, mcap, torn, sqlite):
        answer = recorded.http.put("/bags/odd", content=body, headers=JSON)
        assert answer.status_code == 422, body[:20]
        assert ".part" not in answer.text, "where it was stored for the time being is nobody's business"
        assert recorded.http.get("/bags/odd/").status_code == 404


def test_who_may_not_read_a_topic_may_not_record_it(serve: Callable[..., Any], tmp_path: Path) -> None:
    auth = tmp_path / "auth.toml"
    auth.write_text(rule("anna", "read write", "/bags/**") + tokens("anna"))
    served = serve("aircraft", "--auth", str(auth))
    http = served.http
    http.headers["Authorization"] = f"Bearer {token('anna')}"
    assert http.post("/bags/", json={"topics": [SPEED]}).status_code == 403
    made = http.post("/bags/", json={"name": "all", "topics": ["*"]})
    assert made.status_code == 201, made.text
    assert served.http.patch("/bags/all/", content='{"status": "ended"}', headers=MERGE_PATCH).status_code == 200
    assert count(http, "/bags/all/") == 0


def test_a_query_finds_recordings_that_are_made_and_that_are_sent(recorded: Any, tmp_path: Path) -> None:
    http = recorded.http
    http.put("/bags/sent", content=write_rosbag1(tmp_path / "talk.bag", lines()).read_bytes())
    http.post("/bags/", json={"name": "made", "topics": [SPEED]})
    query = f"SELECT ?bag ?n {{ ?bag a <{ROS}Bag> ; <{ROS}count> ?n }}"
    found: Any = http.get("/sparql", params={"query": query}, headers=RESULTS).json()
    bags = {row["bag"]["value"].removeprefix(recorded.url) for row in found["results"]["bindings"]}
    assert {"bags/sent/", "bags/made/", "bags/history/"} <= bags
    for name in ("sent", "made"):
        assert http.delete(f"/bags/{name}/").status_code == 204


def test_the_history_is_not_one_file(recorded: Any) -> None:
    http = recorded.http
    answer = http.get("/bags/history/file", headers=JSON)
    assert answer.status_code == 404
    assert "POST to /bags/" in answer.json()["detail"]
    assert http.put("/bags/history", content=b"x").status_code == 409
    taken = http.post("/bags/", json={"name": "history", "topics": [SPEED]}, headers=JSON).json()["detail"]
    assert taken == "The recording history already exists: choose another name."
    for denied in (http.delete("/bags/history/", headers=JSON), http.patch("/bags/history/", headers=JSON)):
        assert denied.status_code == 405
        assert "POST to /bags/" in denied.json()["detail"]
