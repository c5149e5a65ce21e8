"""A folder of recordings: catalogued, listed in pages and by filters, read, annotated, moved and lost."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import httpx
import pytest

from tests.runs import START_NS, write_run
from tests.server.auth.conftest import clients, rule, tokens
from tests.server.conftest import Served

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

NTRIPLES = {"Accept": "application/n-triples"}
JSON = {"Accept": "application/json"}
PATCH = {"Content-Type": "application/merge-patch+json", **JSON}
ROS = "https://w3id.org/rosld#"
AT = {"name": "slip & slide", "at": "2023-11-15T00:13:21Z"}
SPAN = {"name": "docking", "from": "2023-11-15T00:13:21Z", "to": "2023-11-15T00:13:22Z"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of each format at several depths, and a file that is none."""
    root = tmp_path_factory.mktemp("runs")
    for number, name in enumerate(("old/run.bag", "new/run.mcap", "third.db3", "fourth")):
        (root / name).parent.mkdir(exist_ok=True)
        write_run(root / name, seconds=2 + number, seed=number, start_ns=START_NS + number * 3600 * 10**9)
    (root / "broken.bag").write_bytes(b"#ROSBAG V2.0\nand no more")
    (root / "notes.txt").write_text("not a recording")
    return root


@pytest.fixture(scope="module")
def served(folder: Path, start_server: Callable[..., Served]) -> Served:
    return start_server(str(folder))


@pytest.fixture(scope="module")
def http(served: Served) -> httpx.Client:
    return served.http


def names(http: httpx.Client, query: str = "") -> list[str]:
    """Return the names of the listed recordings, in the order of the listing."""
    found = http.get(f"/bags/{query}", headers=NTRIPLES, follow_redirects=True)
    assert found.status_code == 200, found.text
    members = [line.split(" ")[2] for line in found.text.splitlines() if "ldp#contains>" in line]
    return [each.rstrip(">/").rpartition("/")[2] for each in members]


def test_all_recordings_of_a_folder_are_listed_and_what_cannot_be_read_says_why(http: httpx.Client) -> None:
    assert names(http) == ["broken", "fourth", "new-run", "old-run", "third"]
    broken = http.get("/bags/broken/", headers=NTRIPLES).text
    assert 'recordingStatus> "damaged"' in broken
    assert "cannot be read as a recording" in broken
    assert "cannot be read" in http.get("/bags/broken/messages/0", headers=JSON).json()["detail"]
    page = http.get("/bags/", headers={"Accept": "text/html"}).text
    assert "2023-11-14" in page
    assert "cannot be read as a recording" in page


def test_each_is_read_as_if_it_were_served_alone(http: httpx.Client) -> None:
    for name, seconds, file in (("old-run", 2, 200), ("new-run", 3, 200), ("third", 4, 200), ("fourth", 5, 404)):
        description = http.get(f"/bags/{name}/", headers=NTRIPLES).text
        assert f'<{ROS}count> "{74 * seconds}"' in description, name
        assert http.get(f"/bags/{name}/messages/0", headers=JSON).status_code == 200, name
        last = http.get(f"/bags/{name}/messages/{74 * seconds - 1}", headers=JSON).json()
        assert last, name
        assert http.head(f"/bags/{name}/file").status_code == file, name
    assert http.get("/bags/old-run/file?format=bag").content.startswith(b"#ROSBAG V2.0")
    assert http.get("/bags/new-run/file?format=bag", headers=JSON).status_code == 406


def test_topics_are_known_and_nothing_is_live(http: httpx.Client) -> None:
    assert http.get("/topics/odom", headers=JSON).json() is None
    assert "4 recordings have" in http.get("/topics/odom", headers={"Accept": "text/html"}).text
    assert http.get("/types/nav_msgs/msg/Odometry", headers=NTRIPLES).status_code == 200
    assert http.get("/openapi.json").status_code == 200
    query = f'SELECT ?name {{ ?bag a <{ROS}Bag> ; <{ROS}name> ?name ; <{ROS}hasRecordedTopic>/<{ROS}name> "/imu" }}'
    assert len(http.get("/sparql", params={"query": query}, headers=JSON).json()["results"]["bindings"]) == 4


def test_the_listing_is_filtered_and_sorted_and_a_wrong_filter_is_refused(http: httpx.Client) -> None:
    for query, found in (
        ("?topic=/od*&sort=-start", ["fourth", "third", "new-run", "old-run"]),
        ("?type=nav_msgs/msg/Odometry&sort=duration", ["old-run", "new-run", "third", "fourth"]),
        ("?topic=/nothing", []),
        ("?from=2023-11-14T23:00:00Z&to=2023-11-15T00:30:00Z", ["new-run", "third"]),
        ("?min_duration=3.5", ["fourth", "third"]),
        ("?q=run+OLD", ["old-run"]),
    ):
        assert names(http, query) == found, query
    for query, words in (("?sort=colour", "?sort=colour is not one of name"), ("?min_duration=long", "of seconds")):
        refused = http.get(f"/bags/{query}", headers=JSON)
        assert (refused.status_code, words in refused.json()["detail"]) == (400, True)


def test_the_listing_comes_in_pages(http: httpx.Client) -> None:
    prefer = {**NTRIPLES, "Prefer": 'return=representation; max-member-count="2"'}
    answer = http.get("/bags/?sort=-name", headers=prefer)
    assert answer.status_code == 303
    found, url = [], answer.headers["location"]
    while url is not None:
        page = http.get(url, headers=NTRIPLES)
        assert page.status_code == 200
        lines = page.text.splitlines()
        found += [line.split(" ")[2].rstrip(">/").rpartition("/")[2] for line in lines if "ldp#contains>" in line]
        url = page.links.get("next", {}).get("url")
    assert found == ["third", "old-run", "new-run", "fourth", "broken"]


def test_tags_and_events_are_kept_when_a_file_is_moved_and_known_when_it_is_lost(
    folder: Path, tmp_path: Path, serve: Callable[..., Served]
) -> None:
    root = tmp_path / "own"
    root.mkdir()
    for name in ("a.mcap", "b.mcap"):
        write_run(root / name, seconds=1, seed=ord(name[0]))
    first = serve(str(root))
    event = {"name": "fault", "at": "2023-11-14T22:13:20.5Z"}
    answer = first.http.patch("/bags/a/", json={"tags": ["rain"], "events": [event]}, headers=PATCH)
    assert answer.status_code == 200, answer.text
    update = (
        "PREFIX dcat: <http://www.w3.org/ns/dcat#> PREFIX prov: <http://www.w3.org/ns/prov#> "
        "PREFIX xsd: <http://www.w3.org/2001/XMLSchema#> PREFIX rdfs: <http://www.w3.org/2000/01/rdf-schema#> "
        f"PREFIX ros: <{ROS}> INSERT DATA {{ <> dcat:keyword 'night' ; ros:hasEvent [ a ros:RecordedEvent ; rdfs:label "
        "'docking' ; prov:startedAtTime '2023-11-14T22:13:20.6Z'^^xsd:dateTime ; "
        "prov:endedAtTime '2023-11-14T22:13:20.7Z'^^xsd:dateTime ] }"
    )
    sparql = {"Content-Type": "application/sparql-update"}
    assert first.http.patch("/bags/a/", content=update, headers=sparql).status_code == 200
    for body, words in (
        ('{"status": "ended"}', "takes tags and events"),
        ('{"tags": ["/odom"]}', "must not begin with /"),
        ('{"events": [{"name": "x", "at": "noon"}]}', "noon"),
    ):
        refused = first.http.patch("/bags/a/", content=body, headers=PATCH)
        assert refused.status_code in (400, 422)
        assert words in refused.json()["detail"]
    change = f"INSERT DATA {{ <> <{ROS}count> 5 }}"
    assert first.http.patch("/bags/a/", content=change, headers=sparql).status_code == 422
    assert names(first.http, "?tag=night") == names(first.http, "?q=docking") == ["a"]
    first.stop()

    (root / "deeper").mkdir()
    (root / "a.mcap").rename(root / "deeper" / "renamed.mcap")
    (root / "b.mcap").unlink()
    second = serve(str(root)).http
    text = second.get("/bags/a/", headers=NTRIPLES).text
    assert all(word in text for word in ('"rain"', '"night"', '"fault"', '"docking"', "22:13:20.7Z"))
    assert second.get("/bags/a/messages/0", headers=JSON).status_code == 200
    assert 'recordingStatus> "missing"' in second.get("/bags/b/", headers=NTRIPLES).text
    assert second.delete("/bags/b/").status_code == 204
    assert names(second) == ["a"]


@pytest.mark.slow
def test_several_sources_are_one_collection_and_a_recording_made_here_takes_tags_too(
    folder: Path, tmp_path: Path, serve: Callable[..., Served]
) -> None:
    data = tmp_path / "data"
    first = serve(f"{folder}/*.db3", str(folder / "old"), "--data", str(data))
    assert names(first.http) == ["run", "third"]
    sent = first.http.put("/bags/mine", content=(folder / "new" / "run.mcap").read_bytes())
    assert sent.status_code == 201, sent.text
    assert first.http.patch("/bags/mine/", json={"tags": ["own"]}, headers=PATCH).status_code == 200
    first.stop()
    again: Any = serve("aircraft", "--data", str(data), "--port", first.url.rstrip("/").rpartition(":")[2]).http
    assert names(again, "?tag=own") == names(again) == ["mine"]


def test_the_page_of_a_recording_has_a_time_line_and_that_of_all_a_form(http: httpx.Client) -> None:
    assert http.patch("/bags/third/", json={"events": [AT, SPAN]}, headers=PATCH).status_code == 200
    page = http.get("/bags/third/", headers={"Accept": "text/html"}).text
    assert '<img src="?format=svg"' in page
    assert 'href="messages/?topic=/odom&amp;format=csv"' in page
    drawn = http.get("/bags/third/?format=svg")
    assert drawn.headers["content-type"] == "image/svg+xml"
    words = {each.text for each in ElementTree.fromstring(drawn.text).iter("{http://www.w3.org/2000/svg}text")}
    assert {"/odom", "/imu", "slip & slide", "docking"} <= words
    hidden = dict(re.findall(r'<input type="hidden" name="([^"]+)" value="([^"]*)"', page))
    form = {**hidden, "tags": "wet, left yard", "event": "found", "at": "2023-11-15T00:13:23Z", "until": ""}
    sent = http.post(
        "/bags/third/", data=form, headers={"Accept": "text/html", "Origin": str(http.base_url).rstrip("/")}
    )
    assert sent.status_code == 303, sent.text
    text = http.get("/bags/third/", headers=NTRIPLES).text
    assert all(f'"{each}"' in text for each in ("wet", "left yard", "found", "slip & slide", "docking"))
    assert 'name="min_duration"' in http.get("/bags/", headers={"Accept": "text/html"}).text


def test_what_an_agent_may_not_read_is_not_found_by_filters(
    folder: Path, tmp_path: Path, serve: Callable[..., Served]
) -> None:
    rules = tmp_path / "rules.toml"
    rules.write_text(
        tokens("reader")
        + rule("reader", "read", "/bags/**", "/topics/**")
        + rule("reader", "read control", "/topics/odom", "/bags/third/**", deny=True)
    )
    server = serve(str(folder), "--auth", str(rules))
    http = clients(server.url, "reader")["reader"]
    assert names(http) == ["broken", "fourth", "new-run", "old-run"]
    assert names(http, "?topic=/imu") == ["fourth", "new-run", "old-run"]
    for query in ("?topic=/odom", "?topic=/od*", "?type=nav_msgs/msg/Odometry", "?q=odom"):
        assert names(http, query) == [], query
    drawn = http.get("/bags/fourth/?format=svg").text
    assert "/imu" in drawn
    assert "odom" not in drawn
    assert http.patch("/bags/fourth/", json={"tags": ["x"]}, headers=PATCH).status_code == 403


def test_a_folder_of_numbered_parts_is_one_recording_and_compressed_files_are_read(
    tmp_path: Path, serve: Callable[..., Served]
) -> None:
    parts = tmp_path / "all" / "run"
    parts.mkdir(parents=True)
    for number in range(2):
        write_run(parts / f"run_{number}.mcap", seconds=1, seed=number, start_ns=START_NS + number * 10**9)
    write_run(tmp_path / "x.mcap", seconds=1, seed=5)
    (tmp_path / "all" / "x.mcap.zst").write_bytes(zstd.compress((tmp_path / "x.mcap").read_bytes()))
    http = serve(str(tmp_path / "all")).http
    assert names(http) == ["run", "x"]
    assert f'<{ROS}count> "148"' in http.get("/bags/run/", headers=NTRIPLES).text
    assert http.get("/bags/x/messages/73", headers=JSON).status_code == 200
    assert http.get("/bags/run/messages/147", headers=JSON).status_code == 200
