"""Resources of a real ROS 1 robot: a rospy node whose getters are counted, hang, raise, vanish and come back."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.adapters.ros1.system import running
from tests.processes import Process
from tests.server.robots import asking

HERE = Path(__file__).parent
DEFINITIONS = HERE / "robots" / "definitions"
FRESHNESS = 1.0
value, objects, detail, mapped = asking.value, asking.objects, asking.detail, asking.mapped
ROS, LDP, EX, JSON, MERGE = asking.ROS, asking.LDP, asking.EX, asking.JSON, asking.MERGE


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A rosmaster."""
    with running(tmp_path_factory.mktemp("ros")) as found:
        yield found


@pytest.fixture(scope="module")
def limb(ros: Any, tmp_path_factory: pytest.TempPathFactory) -> Process:
    """The limb."""
    started: Process = ros.node("limb_node.py", str(tmp_path_factory.mktemp("classes")), str(DEFINITIONS))
    return started


@pytest.fixture(scope="module")
def http(ros: Any, limb: Process, start_server: Callable[..., Any]) -> Iterator[httpx.Client]:
    """rosld on it, which hides the services that tell it what to do."""
    settings = ("--setting", "read_deadline", "0.7", "--setting", "freshness", str(FRESHNESS))
    served = start_server(ros.source, "--types", str(DEFINITIONS), "--exclude-service", "/limb_control/*", *settings)
    until(lambda: value(served.http, "/resources/limb/")["awake"] is not None, "a first value")
    yield served.http
    assert served.stop() == 0


def until(true: Callable[[], Any], what: str, timeout: float = 20.0) -> Any:
    """Wait for what the master tells only when it is asked."""
    end = time.monotonic() + timeout
    while not (found := true()):
        assert time.monotonic() < end, f"never came: {what}"
        time.sleep(0.05)
    return found


def tell(http: httpx.Client, words: str) -> None:
    """Tell the limb what to do."""
    http.post("/services/limb_control/tell", json={"words": words}).raise_for_status()


def counted(http: httpx.Client) -> dict[str, int]:
    """How often each service of the limb was called."""
    answer = http.post("/services/limb_control/count", headers=JSON)
    found: dict[str, int] = json.loads(answer.json()["words"])
    return found


def grip_is(http: httpx.Client, expected: object) -> Any:
    """Wait until the grip is read so, and nothing of before is fresh.

    A node that comes again takes its name from the one before, so that for a moment it has no services.
    """
    return until(lambda: value(http, "/resources/limb/").get("grip", "none yet") == expected, f"a grip of {expected}")


def test_a_rospy_node_comes_to_resources_with_no_configuration(http: httpx.Client) -> None:
    here = f"{http.base_url}resources/"
    assert objects(http.get(here), f"{LDP}contains") >= {f"{here}limb/"}
    found = value(http, "/resources/limb/")
    found.pop("command")
    assert found == {
        "awake": False, "grip": 1, "level": 0.25, "mode": "manual", "name": "Bob", "span": {"low": 0.5, "high": 2.0}
    }  # fmt: skip
    names = {*found, "command", "get_ready", "get_map", "relax", "pid/"}
    assert objects(http.get("/resources/limb/"), f"{LDP}contains") == {f"{here}limb/{name}" for name in names}
    assert value(http, "/resources/limb/pid/") == {"i": 0, "p": 1.5}
    assert counted(http).keys() == {"/limb/get_grip", "/limb/getMode", "/limb/span/get"}
    assert http.get("/resources/limb/get_loggers").status_code == 404
    assert http.get("/resources/limb_control/tell").status_code == 404


def test_a_rospy_node_is_written_to(http: httpx.Client) -> None:
    for name, body in (("grip", 5), ("mode", "automatic"), ("span", {"low": 1, "high": 3.5}), ("name", "Eve")):
        assert http.put(f"/resources/limb/{name}", json=body).status_code == 204, name
        assert value(http, f"/resources/limb/{name}") == body
    assert http.put("/resources/limb/awake", json=True).status_code == 204
    until(lambda: value(http, "/resources/limb/awake") is True, "the topic of the switch")
    assert http.put("/resources/limb/command", json=0.75).status_code in (202, 204)
    until(lambda: value(http, "/resources/limb/level") == 0.75, "what was commanded")
    answer = http.patch("/resources/limb/", json={"grip": 1, "mode": "manual", "name": "Bob"}, headers=MERGE)
    assert answer.status_code == 204
    assert http.post("/resources/limb/relax", headers=JSON).json()["grip"] == 1
    for grip, words in ((-1, "not negative"), (101, "it would break")):
        answer = http.put("/resources/limb/grip", json=grip)
        assert (answer.status_code, words in answer.json()["robotSaid"]) == (422, True), answer.text
    assert http.put("/resources/limb/grip", json=128).status_code == 422
    partly = http.patch("/resources/limb/", json={"grip": -1, "mode": "x", "span": {"low": 9}}, headers=MERGE).json()
    assert [(one["name"], one["status"]) for one in partly["members"]] == [("grip", 422), ("mode", 424), ("span", 424)]


def test_a_rospy_getter_is_called_once_in_a_freshness_period(http: httpx.Client) -> None:
    tell(http, "forget")
    until_ = time.monotonic() + 2 * FRESHNESS

    def read(number: int) -> int:
        times = 0
        with httpx.Client(base_url=http.base_url) as client:
            while time.monotonic() < until_:
                assert value(client, ("/resources/limb/", "/resources/limb/grip")[number % 2])
                times += 1
        return times

    began = time.monotonic()
    with ThreadPoolExecutor(16) as pool:
        reads = sum(pool.map(read, range(16)))
    elapsed = time.monotonic() - began
    calls = counted(http)
    assert reads > 50
    for name in ("/limb/get_grip", "/limb/getMode", "/limb/span/get"):
        assert 1 <= calls[name] <= elapsed / FRESHNESS + 1


def test_a_rospy_getter_that_raises_is_told_in_its_words(http: httpx.Client) -> None:
    tell(http, "raise")
    grip_is(http, None)
    (words,) = objects(http.get("/resources/limb/"), f"{ROS}words", f"{http.base_url}resources/limb/grip")
    assert "the limb is <asleep>" in words
    assert value(http, "/resources/limb/mode") == "manual"
    page = http.get("/resources/limb/grip", headers={"Accept": "text/html"})
    assert "the limb is &lt;asleep&gt;" in page.text
    tell(http, "behave")
    grip_is(http, 1)


def test_a_rospy_node_that_hangs_leaves_what_needs_no_call(http: httpx.Client) -> None:
    tell(http, "hang")
    try:
        grip_is(http, None)
        found = value(http, "/resources/limb/")
        assert (found["mode"], found["span"], found["name"], found["level"]) == (None, None, "Bob", 0.75)
        (why,) = objects(http.get("/resources/limb/grip"), f"{ROS}unreadable")
        assert "has not answered within" in why
    finally:
        tell(http, "go on")
    grip_is(http, 1)


def test_a_service_that_vanishes_takes_its_offers_with_it(http: httpx.Client) -> None:
    mapped(
        http,
        """<#limb> a map:ComplexResource ; map:path "/limb/" ;
             map:property [ map:predicate ex:grip ; map:member "grip" ] ;
             map:property [ map:predicate ex:mode ; map:member "mode" ] ;
             map:action [ map:relation ex:relax ; map:service "/limb/relax" ; map:availableWhen <#gripping> ] .
           <#gripping> a sh:NodeShape ; map:about "/limb/" ; sh:property [ sh:path ex:grip ; sh:minInclusive 1 ] .""",
        "vanishing",
    )
    try:
        assert objects(http.get("/resources/limb/"), f"{EX}relax") == {f"{http.base_url}resources/limb/relax"}
        assert http.post("/resources/limb/relax", headers=JSON).json() == {"grip": 1, "mode": "manual"}
        tell(http, "vanish")
        until(lambda: not objects(http.get("/resources/limb/"), f"{EX}relax"), "the end of the offer")
        tell(http, "forget")
        answer = http.post("/resources/limb/relax")
        assert "cannot be read" in detail(answer, 409)
        assert http.get("/resources/limb/relax").status_code == 404
        assert value(http, "/resources/limb/mode") == "manual"
        assert "/limb/relax" not in counted(http)
        tell(http, "come back")
        until(lambda: http.post("/resources/limb/relax").status_code == 200, "the offer again")
    finally:
        assert http.delete("/mappings/vanishing").status_code == 204


def test_what_a_rospy_node_offers_fits_its_state_while_it_is_flown(http: httpx.Client) -> None:
    mapped(
        http,
        """<#limb> a map:ComplexResource ; map:path "/limb/" ;
             map:property [ map:predicate ex:mode ; map:member "mode" ] ;
             map:action [ map:relation ex:relax ; map:service "/limb/relax" ; map:availableWhen <#manual> ] ;
             map:link [ map:relation ex:pid ; map:target "/limb/pid/" ; map:availableWhen <#automatic> ] .
           <#manual> a sh:NodeShape ; map:about "/limb/" ; sh:property [ sh:path ex:mode ; sh:hasValue "manual" ] .
           <#automatic> a sh:NodeShape ; map:about "/limb/" ;
             sh:property [ sh:path ex:mode ; sh:hasValue "automatic" ] .""",
        "flown",
    )
    over = threading.Event()
    seen: set[tuple[str, bool, bool]] = set()

    def read(_: int) -> None:
        with httpx.Client(base_url=http.base_url, timeout=20) as client:
            while not over.is_set():
                answer = client.get("/resources/limb/")
                (mode,) = objects(answer, f"{EX}mode")
                seen.add((mode, bool(objects(answer, f"{EX}relax")), bool(objects(answer, f"{EX}pid"))))

    with ThreadPoolExecutor(12) as pool:
        reading = [pool.submit(read, number) for number in range(12)]
        try:
            for word in ("automatic", "manual") * 10:
                assert http.put("/resources/limb/mode", json=word).status_code == 204
                assert value(http, "/resources/limb/") == {"mode": word}
                assert http.post("/resources/limb/relax").status_code == (200 if word == "manual" else 409)
        finally:
            over.set()
        for one in reading:
            one.result()
    assert http.delete("/mappings/flown").status_code == 204
    assert seen == {("automatic", False, True), ("manual", True, False)}


def test_a_node_that_comes_later_is_arranged_as_a_mapping_has_it(http: httpx.Client) -> None:
    mapped(
        http,
        """<#arm> a map:ComplexResource ; map:path "/arm/" ;
             map:property [ map:predicate ex:grip ; map:member "grip" ; map:name "force" ] ;
             map:action [ map:relation ex:home ; map:name "fold" ; map:service "/arm/home" ] .""",
        "later",
    )
    assert value(http, "/resources/arm/") == {}
    tell(http, "grow")
    until(lambda: value(http, "/resources/arm/") == {"force": 7}, "the arm")
    answer = until(lambda: objects(http.get("/resources/arm/"), f"{EX}home"), "its action")
    assert answer == {f"{http.base_url}resources/arm/fold"}
    assert http.post("/resources/arm/fold", headers=JSON).json() == {"force": 7}
    assert f"{http.base_url}resources/arm/fold" in detail(http.get("/resources/arm/home"), 404)


def test_a_node_that_dies_is_unreadable_and_one_that_returns_is_read(
    http: httpx.Client, ros: Any, limb: Process, tmp_path: Path
) -> None:
    assert value(http, "/resources/limb/grip") == 1
    limb.kill()  # the master is not told
    grip_is(http, None)
    (why,) = objects(http.get("/resources/limb/"), f"{ROS}unreadable", f"{http.base_url}resources/limb/grip")
    assert "/limb/get_grip" in why
    assert value(http, "/resources/limb/name") == "Bob"  # the master holds parameters
    assert http.put("/resources/limb/grip", json=2).status_code in (502, 503, 504)
    ros.node("limb_node.py", str(tmp_path), str(DEFINITIONS))
    grip_is(http, 1)
    assert http.put("/resources/limb/grip", json=2).status_code == 204
    assert value(http, "/resources/limb/grip") == 2
