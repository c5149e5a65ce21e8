"""Operations that are impossible while the robot is stopped are not on offer; stored documents list them all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest

from rosld.adapters.model import Descriptor
from tests.server.robots.made_up import MadeUp, served
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

STRING, TWIST = "std_msgs/msg/String", "geometry_msgs/msg/Twist"
WRITES = {"PUT", "POST", "PATCH", "DELETE"}
HTML, TURTLE = {"Accept": "text/html"}, {"Accept": "text/turtle"}

OFFERED = {
    "/topics/say": {"PUT", "POST", "PATCH"},
    "/topics/cmd_vel": {"PUT", "POST", "PATCH"},
    "/services/arm/aim": {"POST"},
    "/parameters/gain": {"PUT", "PATCH", "DELETE"},
    "/parameters/": {"POST", "PATCH"},
    "/resources/arm/": {"PATCH"},
    "/resources/arm/label": {"PUT", "PATCH"},
    "/resources/arm/aim": {"POST"},
}
ZERO_PASSES = {"/topics/cmd_vel": {"PUT", "POST"}}


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    made = MadeUp()
    made.topic("/say", STRING, {"data": "x"}, published=False, heard=True)
    made.topic("/cmd_vel", TWIST, published=False, heard=True)
    made.offer("/arm/aim", "made_up/srv/Aim", lambda _: {"hit": True})
    made.variable("/arm/label", "Words", words="x")
    made.parameter("/gain", 1)
    made.declared["/gain"] = Descriptor()
    with served(made) as client:
        yield client


@contextmanager
def stopped(http: httpx.Client) -> Iterator[None]:
    assert http.post("/stop").status_code == 200
    try:
        yield
    finally:
        assert release(http).status_code == 204


def allowed(http: httpx.Client, path: str, method: str = "OPTIONS") -> set[str]:
    answer = http.request(method, path)
    assert answer.status_code < 300, answer.text
    return set(answer.headers["allow"].split(", ")) & WRITES


def forms(http: httpx.Client, path: str) -> list[str]:
    """Return the methods of the forms on a page, except that of the stop."""
    page = http.get(path, headers=HTML).text
    return [part.partition('"')[0] for part in page.split('name="method" value="')[2:]]


def on_offer(http: httpx.Client) -> set[tuple[str, str]]:
    """Return the results of `/queries/what-can-be-done` about topics and resources."""
    rows = http.get("/queries/what-can-be-done", headers={"Accept": "application/json"}).json()["results"]["bindings"]
    base = str(http.base_url)
    found = {(row["resource"]["value"].removeprefix(base), row["method"]["value"]) for row in rows}
    return {each for each in found if not each[0].startswith(("stop", "faults/"))}


def test_allow_and_what_is_accepted_follow_the_stop(http: httpx.Client) -> None:
    for path, methods in OFFERED.items():
        assert allowed(http, path) == methods, path
    with stopped(http):
        for path in OFFERED:
            left = ZERO_PASSES.get(path, set())
            assert allowed(http, path) == left, path
            assert allowed(http, path, "GET") == left, path
        assert "accept-put" not in http.get("/topics/say").headers
        assert "accept-put" in http.get("/topics/cmd_vel").headers
        refused = http.delete("/topics/say")
        assert refused.status_code == 405
        assert not WRITES & set(refused.headers["allow"].split(", "))
        assert http.put("/topics/say", json={"data": "y"}).status_code == 423
        assert http.post("/services/arm/aim", json={"azimuth": 1, "elevation": 1}).status_code == 423
        assert http.put("/data/x", content="<> <p> 1 .", headers={"Content-Type": "text/turtle"}).is_success
        assert "PUT" in allowed(http, "/data/x")
    for path, methods in OFFERED.items():
        assert allowed(http, path) == methods, path


def test_forms_follow_the_stop_and_that_of_a_velocity_topic_publishes_zero(http: httpx.Client) -> None:
    paths = ("/topics/say", "/services/arm/aim", "/parameters/gain", "/resources/arm/", "/resources/arm/label")
    for path in paths:
        assert forms(http, path), path
    token = http.get("/topics/say", headers=HTML).text.split('name="csrf" value="')[2].partition('"')[0]
    with stopped(http):
        for path in (*paths, "/resources/arm/aim"):
            page = http.get(path, headers=HTML).text
            assert not forms(http, path), path
            assert "is not known" not in page, path
        page = http.get("/topics/cmd_vel", headers=HTML).text
        assert "Publish zero" in page
        assert forms(http, "/topics/cmd_vel") == ["PUT"]
        drawn_before = http.post("/topics/say", data={"csrf": token, "method": "PUT", "data": "y"}, headers=HTML)
        assert drawn_before.status_code == 423
        assert "was stopped by anybody" in drawn_before.text


def test_affordances_and_the_query_of_what_can_be_done_follow_the_stop(http: httpx.Client) -> None:
    expected = {
        ("topics/say", "POST"),
        ("topics/cmd_vel", "POST"),
        ("resources/", "PUT"),
        ("resources/arm/", "PUT"),
        ("resources/arm/", "POST"),
    }
    tags = {path: http.get(path, headers=TURTLE).headers["etag"] for path in ("/topics/say", "/resources/arm/")}
    for topic in ("say", "cmd_vel"):
        http.get(f"/topics/{topic}")
    before = until(lambda: (found := on_offer(http)) >= expected and found, "all that is on offer")
    with stopped(http):
        assert on_offer(http) == set()
        for path, tag in tags.items():
            told = http.get(path, headers={**TURTLE, "If-None-Match": tag})
            assert told.status_code == 200, "what is on offer is a part of its state"
            assert "invokeAction" not in told.text
            assert "writeProperty" not in told.text
        assert "readProperty" in http.get("/resources/arm/", headers=TURTLE).text
    until(lambda: on_offer(http) == before, "all that was on offer")


def test_thing_descriptions_and_openapi_keep_all(http: httpx.Client) -> None:
    def kept() -> tuple[Any, Any]:
        thing = http.get("/resources/arm/", params={"format": "td"}).json()
        return thing, http.get("/openapi.json").json()["paths"]

    before = kept()
    assert "writeproperty" in str(before[0])
    with stopped(http):
        assert kept() == before


def test_a_page_that_is_followed_loses_its_forms_with_the_stop(http: httpx.Client) -> None:
    stream = {"Accept": "text/event-stream"}
    with (
        http.stream("GET", "/services/arm/aim", params={"format": "html"}, headers=stream) as page,
        httpx.Client(base_url=http.base_url) as other,
    ):
        lines = page.iter_lines()

        def shown(has_form: bool) -> None:
            """Wait for a page with or without the form of the service."""
            text = ""
            for line in lines:
                if line.startswith("data: "):
                    text += line
                elif not line and text:
                    if ("Call the service" in text) is has_form:
                        return
                    text = ""

        shown(has_form=True)
        other.post("/stop")
        shown(has_form=False)
        release(other)
        shown(has_form=True)
