"""The stop of a robot without a mapping: zero on topics for velocity commands, whichever nodes publish there."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from rosld.adapters.base import Published
from rosld.adapters.model import NotFound, Topic, TypeRef, Unreachable
from tests.server.robots.made_up import MadeUp, served
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}
HTML = {"Accept": "text/html"}
ROS = "https://w3id.org/rosld#"
TWIST, STRING = "geometry_msgs/msg/Twist", "std_msgs/msg/String"
TYPES = "https://w3id.org/rosld/types/"
STILL = {"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
AHEAD = {**STILL, "linear": {"x": 1.0, "y": 0.0, "z": 0.0}}


class Base(MadeUp):
    """A mobile base. On `/lost` nothing ever connects; `withdrawn` are the topics no longer advertised."""

    def __init__(self) -> None:
        super().__init__()
        self.advertised: list[str] = []
        self.withdrawn: list[str] = []
        self.deaf: set[str] = set()
        self.topic("/cmd_vel", TWIST, published=False, heard=True)
        self.topic("/joy_vel", TWIST, published=True, heard=True)
        self.topic("/stamped", "geometry_msgs/msg/TwistStamped", published=False, heard=True)
        self.topic("/steer", "ackermann_msgs/msg/AckermannDrive", published=False, heard=True)
        self.topic("/steer_stamped", "ackermann_msgs/msg/AckermannDriveStamped", published=False, heard=True)
        self.topic("/measured", "geometry_msgs/msg/TwistWithCovarianceStamped", published=True, heard=True)
        self.topic("/unheard", TWIST, published=False, heard=False)
        self.topic("/thrust", "std_msgs/msg/Float64", published=False, heard=True)
        self.topic("/say", STRING, published=False, heard=True)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        while topic in self.deaf:
            if asyncio.get_running_loop().time() >= deadline:
                return Published(0)
            await asyncio.sleep(0.01)
        return await super().publish(topic, type, data, latch=latch, deadline=deadline)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        if topic == "/stamped" and topic not in self.advertised:
            self.advertised.append(topic)
            raise Unreachable("its subscribers are gone")
        self.advertised.append(topic)

    async def unadvertise(self, topic: str) -> None:
        self.withdrawn.append(topic)


@pytest.fixture
def base() -> Base:
    return Base()


@pytest.fixture
def http(base: Base) -> Iterator[httpx.Client]:
    with served(base) as client:
        yield client


def stop(http: httpx.Client) -> dict[str, Any]:
    answer = http.post("/stop", headers=JSON)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def steps(told: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {step["does"]: step for step in told["steps"]}


def on(topic: str) -> str:
    return f"publish zero on {topic}"


COMMANDS = ["/cmd_vel", "/joy_vel", "/stamped", "/steer", "/steer_stamped"]


def test_zero_is_published_again_and_again_on_each_topic_of_a_velocity_type_that_is_heard(
    base: Base, http: httpx.Client
) -> None:
    planned = http.get("/stop", headers=JSON).json()
    assert {does: step["state"] for does, step in steps(planned).items()} == {on(each): "NotSent" for each in COMMANDS}
    assert planned["warning"] is None
    told = stop(http)
    assert steps(told) == {
        on(each): {"does": on(each), "state": "Succeeded", "subscribers": 1, "words": None} for each in COMMANDS
    }
    assert told["warning"] is None
    until(lambda: all(len(base.sent[each]) >= 15 for each in COMMANDS), "zero for a second")
    assert set(base.sent) == set(COMMANDS)
    assert all(message == STILL for message in base.sent["/cmd_vel"] + base.sent["/joy_vel"])
    assert all(message["speed"] == 0.0 for message in base.sent["/steer"])
    stamps = [message["header"]["stamp"] for message in base.sent["/stamped"]]
    assert all(stamp["sec"] > 0 for stamp in stamps)
    assert stamps[0] != stamps[-1]
    assert all(message["twist"] == STILL for message in base.sent["/stamped"])


def test_globs_name_further_topics_and_take_topics_out(base: Base) -> None:
    globs = ("/thrust", "!/joy*", "!/st*")
    base.topic("/rosout", "rosgraph_msgs/msg/Log", published=True, heard=True)
    with served(base, stop_zero=globs) as http:
        assert set(steps(stop(http))) == {on("/cmd_vel"), on("/thrust")}
        assert base.sent["/thrust"][0] == {"data": 0.0}
        assert http.put("/topics/thrust", json={"data": 0}).status_code == 204
        assert http.put("/topics/thrust", json={"data": 1}).status_code == 423
        assert http.put("/topics/stamped", params={"defaults": "true"}, json={}).status_code == 423
    with served(Base(), stop_zero=("*",)) as http:
        assert "/rosout" not in str(stop(http))


def test_while_stopped_zero_passes_and_nothing_else(base: Base, http: httpx.Client) -> None:
    stop(http)
    url = f"{http.base_url}topics/cmd_vel"
    zero = "".join(
        f"<#message.{part}> <{TYPES}geometry_msgs/msg/Vector3#{axis}> 0 . "
        for part in ("linear", "angular")
        for axis in "xyz"
    )
    zero += f"<#message> a <{TYPES}{TWIST}> . "
    zero += "".join(f"<#message> <{TYPES}{TWIST}#{part}> <#message.{part}> . " for part in ("linear", "angular"))
    turtle = {"Content-Type": "text/turtle"}
    assert http.put("/topics/cmd_vel", json=STILL).status_code == 204
    assert http.put("/topics/cmd_vel", content=zero, headers=turtle).status_code == 204
    assert http.put("/topics/cmd_vel", content=zero.replace("0 .", "1 .", 1), headers=turtle).status_code == 423
    assert http.put("/topics/cmd_vel", json=AHEAD).status_code == 423
    assert http.put("/topics/joy_vel", json=STILL).status_code == 405, "another node publishes on it"
    assert http.put("/topics/say", json={"data": ""}).status_code == 423
    assert http.post("/topics/cmd_vel", params={"rate": 20}, json=AHEAD).status_code == 423
    held = http.post("/topics/cmd_vel", params={"rate": 20, "lease": 5}, json=STILL)
    assert held.status_code == 201
    hold = held.headers["location"]
    assert http.patch(hold).status_code == 204
    assert http.patch(hold, json=AHEAD).status_code == 423
    assert all(message == STILL for message in base.sent["/cmd_vel"])
    assert http.get(hold, headers=JSON).json()["message"] == STILL
    assert release(http).status_code == 204
    assert http.patch(hold, json=AHEAD).status_code == 204
    until(lambda: AHEAD in base.sent["/cmd_vel"], "the command")
    stop(http)
    assert http.get(hold).status_code == 410
    assert "zero" not in http.get(url, headers=JSON).text


def test_a_topic_that_cannot_be_reached_fails_delays_no_other_and_is_told_zero_later(
    base: Base, http: httpx.Client
) -> None:
    base.deaf.add("/cmd_vel")
    told = stop(http)
    failed = steps(told)[on("/cmd_vel")]
    assert (failed["state"], failed["words"]) == ("Failed", "no subscriber of /cmd_vel could be reached")
    assert steps(told)[on("/stamped")]["subscribers"] == 1
    assert "1 of 5 steps to stop it failed" in told["warning"]
    page = http.get("/stop", headers=HTML).text
    assert '<td class="outcome error">failed: <bdi>no subscriber of /cmd_vel could be reached</bdi></td>' in page
    assert '<td data-label="Subscribers">1</td><td class="outcome good">succeeded</td>' in page
    assert "1 of 5 steps to stop it failed" in http.get("/topics/say", headers=HTML).text
    query = f"SELECT ?n ?w {{ ?stop <{ROS}warning> ?w ; <{ROS}stopStep> ?s . ?s <{ROS}subscriberCount> ?n }}"
    rows = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"}).text.splitlines()
    assert len(rows) == 1 + 4
    assert rows[1].startswith("1,The robot may still be moving")
    assert "/cmd_vel" not in base.sent
    base.deaf.clear()
    until(lambda: len(base.sent.get("/cmd_vel", ())) >= 15, "zero for a second")
    told = http.get("/stop", headers=JSON).json()
    late = steps(told)[on("/cmd_vel")]
    assert (late["state"], late["subscribers"], told["warning"]) == ("Succeeded", 1, None)
    assert re.fullmatch(r"sent late, \d+\.\d s after the stop", late["words"])
    assert "sent late" in http.get("/stop", headers=HTML).text
    assert f'"{late["words"]}"' in http.get("/stop", headers={"Accept": "text/turtle"}).text


def test_a_topic_whose_types_differ_cannot_be_told_zero(base: Base, http: httpx.Client) -> None:
    told = next(iter(base.graph.topics.values()))
    base.strange(Topic("/odd", (TypeRef(TWIST), TypeRef(STRING)), (), told.subscribers))
    until(lambda: http.get("/topics/odd").status_code == 200, "the topic")
    failed = steps(stop(http))[on("/odd")]
    assert failed["state"] == "Failed"
    assert "disagree on its type" in failed["words"]


def test_a_stop_that_can_publish_and_call_nothing_warns_that_the_robot_may_go_on() -> None:
    robot = MadeUp()
    robot.topic("/say", STRING, published=False, heard=True)
    with served(robot) as http:
        assert "A stop would have no effect" in http.get("/stop", headers=JSON).json()["warning"]
        assert '<div class="notice error" role="alert">\n  <p><bdi>A stop would' in http.get("/stop", headers=HTML).text
        told = stop(http)
        assert told["steps"] == []
        assert "The robot may still be moving, because no command to stop was sent" in told["warning"]
        for page in ("/stop", "/topics/say", "/"):
            assert "<strong>The robot may still be moving" in http.get(page, headers=HTML).text, page
        assert "may still be moving" in http.get("/stop", headers={"Accept": "text/turtle"}).text
        assert http.put("/topics/say", json={"data": "x"}).status_code == 423, "it is stopped all the same"


def test_topics_of_a_stop_are_advertised_beforehand_if_that_is_set() -> None:
    base = Base()
    with served(base, stop_ready=True) as http:
        until(lambda: set(base.advertised) == set(COMMANDS), "the topics")
        assert base.sent == {}
        base.strange(Topic("/cmd_vel_2", (TypeRef(TWIST),), (), base.graph.topics["/cmd_vel"].subscribers))
        until(lambda: "/cmd_vel_2" in base.advertised, "the topic that came later")
        assert base.advertised.count("/stamped") > 1, "what could not be advertised is tried again"
        stop(http)
        assert release(http).status_code == 204
        assert base.withdrawn == []


def test_nothing_is_advertised_beforehand_otherwise() -> None:
    for settings in ({}, {"stop_ready": True, "read_only": True}):
        base = Base()
        with served(base, **settings) as http:
            base.strange(Topic("/later", (TypeRef(STRING),), (), base.graph.topics["/cmd_vel"].subscribers))
            until(lambda http=http: http.get("/topics/later").status_code == 200, "the topic that came later")
            assert base.advertised == []


def test_a_release_waits_for_the_second_of_zeros_and_withdraws_what_the_stop_advertised(
    base: Base, http: httpx.Client
) -> None:
    assert http.put("/topics/cmd_vel", json=AHEAD).status_code == 204
    stop(http)
    assert base.withdrawn == []
    assert release(http).status_code == 204
    assert sorted(base.withdrawn) == sorted(set(COMMANDS) - {"/cmd_vel"})
    assert all(len(base.sent[each]) >= 15 for each in COMMANDS)
    base.sent["/cmd_vel"].clear()
    held = http.post("/topics/cmd_vel", params={"rate": 50, "lease": 5}, json=AHEAD)
    assert held.status_code == 201
    until(lambda: base.sent["/cmd_vel"].count(AHEAD) >= 10, "commands, with no zero between them")
    assert STILL not in base.sent["/cmd_vel"]


def test_a_server_that_ends_publishes_zero_to_the_end(base: Base) -> None:
    with served(base) as http:
        stop(http)
    assert all(len(base.sent[each]) >= 15 for each in COMMANDS)


def test_a_topic_that_is_unreachable_fails_with_its_reason(base: Base) -> None:
    class Gone(Base):
        async def publish(self, topic: str, *arguments: Any, **more: Any) -> Published:
            raise Unreachable(f"the node of {topic} is gone")

        async def unadvertise(self, topic: str) -> None:
            raise NotFound(topic)

    with served(Gone()) as http:
        told = stop(http)
        assert {step["words"] for step in told["steps"]} == {f"the node of {each} is gone" for each in COMMANDS}
        assert "steps to stop it failed" in told["warning"]
        assert release(http).status_code == 204
