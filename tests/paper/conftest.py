"""The paper's aircraft, embedded, in rospy under a real roscore, and in rclpy, each behind a server of its own.

A test brings it into the state that it needs over HTTP, and asks the robot itself what has become of it: on ROS that is
asked with ROS's own tools.
"""

from __future__ import annotations

import json
import subprocess
import xmlrpc.client
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import httpx
import pytest
from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.vocab import av, ldp, ros
from tests.adapters.ros1 import system as ros1
from tests.ros2 import system as ros2
from tests.server.conftest import serve, start_lasting_server
from tests.waiting import until

__all__ = ["serve", "start_lasting_server"]
"""The fixtures that start servers; they belong to the server's tests."""

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
AIRCRAFT, ENGINE = "/resources/aircraft/", "/resources/aircraft/engine/"
SHIPPED = ROOT / "adapters" / "aircraft"
MAPPED = ("--mapping", str(SHIPPED / "mapping.ttl"), "--shapes", str(SHIPPED / "limits.ttl"))
"""What makes the server of a ROS system one of the paper's aircraft."""
JSON, MERGE_PATCH = "application/json", "application/merge-patch+json"
PATIENCE = 20.0
CRUISE = 20.0
"""The speed that flying is here: a fifth of a second away from rest."""


# The robot as it is without rosld's resources


class Robot(Protocol):
    """The robot's own view of itself.

    `spoken` are the transports of ROS that lead to it, `hashed` is what a type's hash is called there, and `given` are
    the parameters that every node has.
    """

    spoken: frozenset[str]
    hashed: NamedNode
    given: frozenset[str]

    def ask(self, service: str) -> Any:
        """What one of its getters says."""

    def hear(self, topic: str) -> Any:
        """The value that a topic carries now."""

    def names(self) -> dict[str, set[str]]:
        """The names there are of topics, services and nodes."""

    def parameter(self, name: str) -> Any:
        """The value of a parameter; None where there is none."""

    def heard_in_the_cockpit(self, text: str) -> None:
        """Wait until the cockpit has received this text."""

    def publishers(self, topic: str) -> set[str]:
        """The nodes that publish a topic."""

    def protocols(self, topic: str) -> set[str]:
        """Which of ROS's two transports rosld speaks with who subscribes to a topic that it publishes."""


class Embedded:
    """The aircraft that rosld brings along: its level one is as near as one comes to it."""

    spoken: frozenset[str] = frozenset()  # within one process there is no transport
    hashed = ros.md5
    given: frozenset[str] = frozenset()

    def __init__(self, http: httpx.Client) -> None:
        self._http = http

    def ask(self, service: str) -> Any:
        answer = self._http.post(f"/services{service}", headers={"Accept": JSON})
        assert answer.status_code == 201, answer.text
        return answer.json()["data"]

    def hear(self, topic: str) -> Any:
        read = self._http.get(f"/topics{topic}", headers={"Accept": JSON}).json()
        return None if read is None else read["data"]

    def names(self) -> dict[str, set[str]]:
        return {
            "topics": {"/aircraft/engine/speed", "/cockpit/display"},
            "services": {f"/aircraft/{one}" for one in ("start", "stop", "set_power", "get_power")}
            | {f"/aircraft/engine/{one}" for one in ("set_speed", "set_direction", "get_direction")},
            "nodes": {"/aircraft", "/cockpit"},
        }

    def parameter(self, name: str) -> Any:
        answer = self._http.get(f"/parameters{name}", headers={"Accept": JSON}, follow_redirects=True)
        return None if answer.status_code == 404 else answer.json()

    def heard_in_the_cockpit(self, text: str) -> None:
        until(lambda: self.hear("/cockpit/display") == text, f"{text!r} on the display")

    def publishers(self, topic: str) -> set[str]:
        answer = self._http.get(f"/topics{topic}", headers={"Accept": "application/n-triples"})
        if answer.status_code == 404:
            return set()
        found = parse(answer.content, format=RdfFormat.N_TRIPLES)
        urls = {one.object.value for one in found if one.predicate == ros.publishedBy and "#" not in one.subject.value}
        return {"/" + url.partition("/nodes/")[2] for url in urls}

    def protocols(self, topic: str) -> set[str]:
        return set()


class Rospy:
    """The aircraft as nodes of a real ROS 1: asked by a rospy node and with rostopic, the master by its own API."""

    spoken = frozenset(["TCPROS"])  # and not UDPROS
    hashed = ros.md5
    given: frozenset[str] = frozenset()

    def __init__(self, system: Any, cockpit: Any, witness: subprocess.Popen[str]) -> None:
        self.system = system
        self._cockpit = cockpit
        self._witness = witness

    def ask(self, service: str) -> Any:
        assert self._witness.stdin is not None
        assert self._witness.stdout is not None
        print(service, file=self._witness.stdin, flush=True)
        return json.loads(self._witness.stdout.readline())

    def hear(self, topic: str) -> Any:
        return self.system.echo(topic)["data"]

    def names(self) -> dict[str, set[str]]:
        publishers, subscribers, services = self.system.master.getSystemState("/test")[2]
        everything = [*publishers, *subscribers, *services]
        return {
            "topics": {name for name, _ in (*publishers, *subscribers)},
            "services": {name for name, _ in services},
            "nodes": {node for _, nodes in everything for node in nodes},
        }

    def parameter(self, name: str) -> Any:
        code, _, value = self.system.master.getParam("/test", name)
        return value if code == 1 else None

    def heard_in_the_cockpit(self, text: str) -> None:
        self._cockpit.line(f"display {text}")

    def publishers(self, topic: str) -> set[str]:
        return set(self.system.publishers(topic))

    def protocols(self, topic: str) -> set[str]:
        (node,) = self.publishers(topic)
        slave = xmlrpc.client.ServerProxy(self.system.master.lookupNode("/test", node)[2])
        asked = {"TCPROS": ["TCPROS"], "UDPROS": ["UDPROS", "", "127.0.0.1", self.system.port, 1500]}
        return {name for name, how in asked.items() if slave.requestTopic("/test", topic, [how])[0] == 1}


class Rclpy:
    """The aircraft as nodes of a real ROS 2, which a node of another process looks at."""

    spoken: frozenset[str] = frozenset()  # DDS has one transport for all
    hashed = ros.typeHash
    given = frozenset(["use_sim_time", "start_type_description_service"])

    def __init__(self, aircraft: Any, witness: subprocess.Popen[str]) -> None:
        self._aircraft = aircraft
        self._witness = witness

    def ask(self, service: str) -> Any:
        return self._told("ask", service)

    def hear(self, topic: str) -> Any:
        return self._told("hear", topic)

    def names(self) -> dict[str, set[str]]:
        return {kind: set(names) for kind, names in self._told("names").items()}

    def parameter(self, name: str) -> Any:
        return self._told("parameter", name)

    def heard_in_the_cockpit(self, text: str) -> None:
        self._aircraft.line(f"display {text}")

    def publishers(self, topic: str) -> set[str]:
        return set(self._told("publishers", topic))

    def protocols(self, topic: str) -> set[str]:
        return set()

    def _told(self, *asked: str) -> Any:
        assert self._witness.stdin is not None
        assert self._witness.stdout is not None
        print(*asked, file=self._witness.stdin, flush=True)
        answer = json.loads(self._witness.stdout.readline())
        assert not (isinstance(answer, dict) and "failed" in answer), answer["failed"]
        return answer


# The robot as rosld serves it


class Flight:
    """An aircraft behind a server, and its states: off, standing (on, at rest), flying (on, at 20)."""

    until = staticmethod(until)

    def __init__(self, served: Any, robot: Robot, source: str, how: Mapping[str, Any] | None = None) -> None:
        self.source = source
        self.how = how or {}
        self.url: str = served.url
        self.http: httpx.Client = served.http
        self.robot = robot

    # Reading

    def get(self, path: str, accept: str = "text/turtle") -> httpx.Response:
        """What is at a path, in a media type."""
        return self.http.get(path, headers={"Accept": accept})

    def json(self, path: str) -> Any:
        """What is at a path, as plain JSON."""
        answer = self.get(path, JSON)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def triples(self, answer: httpx.Response | str) -> set[Triple]:
        """The triples of an answer in any RDF syntax, or of what is at a path."""
        if isinstance(answer, str):
            answer = self.get(answer)
            assert answer.status_code == 200, answer.text
        syntax = RdfFormat.from_media_type(answer.headers["content-type"].partition(";")[0])
        base = answer.headers.get("content-location", str(answer.url))
        return {quad.triple for quad in parse(answer.content, format=syntax, base_iri=base)}

    def said(self, path: str, predicate: NamedNode, *, of: str | None = None) -> set[str]:
        """What is said of the resource at a path (or of another one, in its document) by a predicate.

        Literals are their text; URLs of this server are paths.
        """
        subject = NamedNode(self.absolute(path if of is None else of))
        found = (one.object for one in self.triples(path) if one.subject == subject and one.predicate == predicate)
        return {one.value if isinstance(one, Literal) else self.path(one.value) for one in found}

    def absolute(self, path: str) -> str:
        """The URL of a path."""
        return self.url.rstrip("/") + path if path.startswith("/") else path

    def path(self, url: str) -> str:
        """A URL of this server as a path, anything else as it is."""
        return url.removeprefix(self.url.rstrip("/")) if url.startswith(self.url) else url

    def relations(self, answer: httpx.Response | str = AIRCRAFT) -> dict[str, str]:
        """What the paper's Listing 3 shows of a resource: its relations, each with a value or the path it leads to."""
        found: dict[str, str] = {}
        for one in self.triples(answer):
            if one.predicate.value.startswith(av.iri) and not isinstance(one.object, Triple):
                name = one.predicate.value.removeprefix(av.iri)
                assert name not in found, f"{name} twice"
                found[name] = self.path(one.object.value)
        return found

    def name_of(self, relation: NamedNode) -> str:
        """The short name of a relation of the aircraft."""
        return relation.value.removeprefix(av.iri)

    # Writing

    def send(
        self, verb: str, path: str, value: object = None, accept: str = JSON, *, type: str = JSON
    ) -> httpx.Response:
        """A request with a value as JSON, or with nothing where it is None."""
        content = None if value is None else json.dumps(value)
        headers = {"Accept": accept} if content is None else {"Accept": accept, "Content-Type": type}
        return self.http.request(verb, path, content=content, headers=headers)

    def put(self, path: str, value: object) -> httpx.Response:
        """PUT a value as plain JSON."""
        return self.send("PUT", path, value)

    def post(self, path: str, value: object = None, accept: str = "text/turtle") -> httpx.Response:
        """POST a request as plain JSON, or nothing."""
        return self.send("POST", path, value, accept)

    def patch(self, path: str, value: object) -> httpx.Response:
        """PATCH with a JSON merge patch."""
        return self.send("PATCH", path, value, type=MERGE_PATCH)

    def publish(self, path: str, value: object) -> None:
        """PUT to a topic until somebody was there to get it (204); 202 is for nobody."""
        until(lambda: self.put(path, value).status_code == 204, f"a subscriber behind {path}")

    def allowed(self, path: str) -> set[str]:
        """The verbs that a resource names as its own, but for those that every resource has."""
        answer = self.http.options(path)
        assert answer.status_code == 204, answer.text
        return set(answer.headers["allow"].split(", ")) - {"HEAD", "OPTIONS"}

    def calls(self) -> set[str]:
        """Every call of a service that was made so far by its own URL or as an action."""
        return self.said("/calls/", ldp.contains)

    # States

    def in_state(self, name: str) -> None:
        """Bring the aircraft into the state of this name."""
        {"off": self.off, "standing": self.standing, "flying": self.flying}[name]()

    def off(self) -> None:
        """Bring the aircraft to rest and switch it off."""

        def ended() -> bool:
            if self.json(AIRCRAFT)["power"] == "off":
                return True
            self.put(f"{ENGINE}speed", 0)
            return self.post(f"{AIRCRAFT}stop").status_code == 200

        until(ended, "the aircraft off")
        until(lambda: self.robot_speed() == 0.0, "rest")

    def standing(self) -> None:
        """Switch the aircraft on, at rest."""
        self.off()
        answer = self.post(f"{AIRCRAFT}start")
        assert answer.status_code == 200, answer.text

    def flying(self) -> None:
        """Switch the aircraft on and let it fly."""
        self.standing()
        answer = self.put(f"{ENGINE}speed", CRUISE)
        assert answer.status_code == 204, answer.text
        until(lambda: self.json(f"{ENGINE}speed") == CRUISE, "the speed")

    def complete(self) -> None:
        """Wait until the server has found the whole aircraft."""
        until(lambda: self.get("/resources/aircraft/power").status_code == 200, "the power")
        for one in ("start", "stop", "set_power", "engine/set_speed", "engine/set_direction"):
            until(lambda url=f"/services/aircraft/{one}": self.get(url).status_code == 200, one)
        until(lambda: self.get("/parameters/cockpit/night").status_code == 200, "the parameters of the cockpit")
        until(lambda: self.robot_speed() is not None, "the speed")

    def robot_speed(self) -> float | None:
        """The speed at level one."""
        read = self.json("/topics/aircraft/engine/speed")
        return None if read is None else read["data"]


def embedded(start: Callable[..., Any], _factory: pytest.TempPathFactory) -> Iterator[Flight]:
    """The embedded aircraft, which has its mapping and its limits with it."""
    served = start("aircraft")
    yield Flight(served, Embedded(served.http), "aircraft")


def rospy(start: Callable[..., Any], factory: pytest.TempPathFactory) -> Iterator[Flight]:
    """The rospy aircraft, with the mapping and the limits that are shipped with the embedded one."""
    with ros1.running(factory.mktemp("ros")) as system:
        classes = factory.mktemp("classes")
        system.environment["PYTHONPATH"] = str(classes)  # where nodes find the types of the aircraft
        system.node("aircraft_node.py", str(classes))
        cockpit = system.node("cockpit_node.py")
        with witness(["/usr/bin/python3", str(HERE / "witness.py")], system.environment) as looking:
            flight = Flight(start(system.source, *MAPPED), Rospy(system, cockpit, looking), system.source)
            flight.complete()
            yield flight


@contextmanager
def witness(command: Sequence[str], environment: Mapping[str, str]) -> Iterator[subprocess.Popen[str]]:
    """A node of the tests' own, ready to look."""
    process = subprocess.Popen(command, env=dict(environment), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)


def rclpy(distro: str) -> Callable[..., Iterator[Flight]]:
    """The rclpy aircraft of a distro, with the same mapping and limits."""

    def flown(start: Callable[..., Any], _factory: pytest.TempPathFactory) -> Iterator[Flight]:
        with ros2.running(distro) as system:
            aircraft = system.node("aircraft.py")
            with witness([system.python, str(ros2.NODES / "witness.py")], system.environment) as looking:
                how = {"python": system.python, "environment": system.environment}
                flight = Flight(start(system.source, *MAPPED, **how), Rclpy(aircraft, looking), system.source, how)
                flight.complete()
                yield flight

    return flown


FLIGHTS = {"embedded": embedded, "rospy": rospy, "jazzy": rclpy("jazzy")}
ON_ROS2 = ("jazzy",)


@pytest.fixture(
    scope="session",
    params=[pytest.param(name, marks=[pytest.mark.ros2] if name in ON_ROS2 else []) for name in FLIGHTS],
)
def flight(
    request: pytest.FixtureRequest, start_lasting_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Flight]:
    """Each aircraft in turn, for all tests: each brings it into the state that it needs."""
    yield from FLIGHTS[request.param](start_lasting_server, tmp_path_factory)


@pytest.fixture
def beside(flight: Flight, serve: Callable[..., Any]) -> Callable[..., Flight]:
    """Starts another server of the aircraft, with other options: of the same one where it is on ROS."""

    def started(*options: str, mapped: bool = True) -> Flight:
        given = MAPPED if mapped and flight.source != "aircraft" else ()
        served = serve(flight.source, *given, *options, **flight.how)
        robot = Embedded(served.http) if flight.source == "aircraft" else flight.robot
        other = Flight(served, robot, flight.source, flight.how)
        other.complete()
        return other

    return started
