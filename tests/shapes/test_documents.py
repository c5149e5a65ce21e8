"""What servers say conforms to the shapes that they link to: the aircraft, a recording, a real ROS 1, a real ROS 2."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from tests.adapters.ros1.system import running as running_ros1
from tests.ros2.system import running as running_ros2
from tests.server.conftest import Served, servers
from tests.shapes.crawl import Site, crawl, document
from tests.waiting import until

JSON = {"Accept": "application/json"}
TURTLE = {"Content-Type": "text/turtle"}
PREFIXES = """@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix ros: <https://w3id.org/rosld#> .
"""
MAPPING = """<#panel> a map:ComplexResource ; map:path "/panel/" ; map:property [
  map:predicate ros:value ; map:member "/cockpit/brightness" ] ."""
LIMITS = """<#slow> a sh:NodeShape ; sh:targetNode <../resources/aircraft/engine/speed> ;
  sh:property [ sh:path rdf:value ; sh:maxInclusive 900 ] ."""
RIGHTS = """[[rule]]
agents = ["anybody"]
modes = ["read", "write", "control", "administer"]
paths = ["/**"]
"""
WITHOUT_SHAPE = ("queries/graph",)
"""The query constructs a graph."""


def put(http: httpx.Client, path: str, content: str, media_type: str = "text/turtle", **headers: str) -> None:
    answer = http.put(path, content=content, headers={"Content-Type": media_type, **headers})
    assert answer.is_success, answer.text


@pytest.fixture(scope="module")
def aircraft(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Site:
    """The aircraft after writes, calls, goals, a hold, refusals, and a stop, with everything that a client may keep."""
    rights = tmp_path_factory.mktemp("rights") / "auth.toml"
    rights.write_text(RIGHTS)
    rights.chmod(0o600)
    served: Served = start_server("aircraft", "--auth", str(rights))
    http = served.http
    site = Site(served.url)
    site.read(http, f"{served.url}resources/aircraft/start")
    assert http.post("/resources/aircraft/start").is_success
    assert http.put("/resources/aircraft/engine/speed", json=250).is_success
    assert http.put("/resources/aircraft/engine/speed", json=5000).status_code == 422
    assert http.put("/topics/cockpit/display", json={"data": "on our way"}).is_success
    assert http.put("/parameters/cockpit/layout", json={"left": [1, {"a": "b"}], "right": 0.5}).is_success
    assert http.post("/services/aircraft/get_power").is_success
    assert http.post("/services/aircraft/engine/set_speed", json={"data": "fast"}).status_code == 422
    assert http.post("/actions/aircraft/fly", json={"distance": 250}).status_code == 201
    assert http.post("/actions/aircraft/fly", json={"distance": -1}).status_code in (409, 422)
    put(http, "/mappings/panel", PREFIXES + MAPPING)
    put(http, "/shapes/slow", PREFIXES + LIMITS)
    put(
        http,
        "/queries/mine",
        "# Everything.\n# @param most integer 5 -- what it is\nSELECT * { ?s ?p ?most }",
        "application/sparql-query",
    )
    put(http, "/data/a", f"{PREFIXES} <> a ros:Topic ; ros:name 5 .")
    put(http, "/data/file", "text", "text/plain")
    put(http, "/data/folder/b", "<#x> <http://ex.org/p> [ ] .")
    held = http.post("/topics/cockpit/display?rate=1&lease=5&then=zero", json={"data": "held"})
    assert held.status_code == 201, held.text
    site.read(http, held.headers["location"])
    site.read(http, f"{served.url}find?q=engine")
    site.read(http, f"{served.url}topics/cockpit/display")
    assert http.post("/stop", json={"reason": "a test"}).is_success
    crawl(http, site)
    assert site.documents.keys() >= {f"{served.url}data/a", f"{served.url}mappings/panel", f"{served.url}acl"}
    return site


@pytest.fixture(scope="module")
def recording(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Site:
    """A recording of an image, of points, and of a string that is no UTF-8."""
    path, types = tmp_path_factory.mktemp("bags") / "walk.bag", get_typestore(Stores.ROS1_NOETIC)
    made = types.types
    header = made["std_msgs/msg/Header"](seq=1, stamp=made["builtin_interfaces/msg/Time"](5, 6), frame_id="eye")
    pixels = np.zeros(480 * 1920, np.uint8)
    messages = {
        "/eye": made["sensor_msgs/msg/Image"](header, 480, 640, "rgb8", 0, 1920, pixels),
        "/place": made["geometry_msgs/msg/Point"](1.0, np.nan, -np.inf),
    }
    said = [(topic, one.__msgtype__, types.serialize_ros1(one, one.__msgtype__)) for topic, one in messages.items()]
    said.append(("/name", "std_msgs/msg/String", b"\x02\0\0\0\xff\xfe"))
    with Writer(path) as bag:
        for number, (topic, name, data) in enumerate(said):
            bag.write(bag.add_connection(topic, name, typestore=types, callerid="/walker"), 10**18 + number, data)
    served: Served = start_server(str(path))
    site = crawl(served.http, Site(served.url))
    assert f"{served.url}bags/walk/messages/0" in site.documents
    assert "ros:Elided" in site.documents[f"{served.url}topics/eye"]
    return site


@pytest.fixture(scope="module")
def ros1(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A real ROS 1: the aircraft's twin, transforms, actions, services that fail, a string that is too large."""
    folder = tmp_path_factory.mktemp("ros")
    with running_ros1(folder) as system:
        system.node("aircraft_node.py", str(folder / "classes"))
        for node in ("cockpit_node.py", "services_node.py", "action_node.py", "odd_type_node.py"):
            system.node(node)
        system.node("tf_node.py", "wing")
        system.node("latched_node.py", "talker", "/large", "a" * 70_000)
        served: Served = start_server(system.source)
        http = served.http
        for path in ("/topics/tf", "/topics/large", "/topics/odd", "/services/raises", "/actions/simple"):
            until(lambda path=path: http.get(path).status_code == 200, path)
        until(lambda: http.get("/topics/tf", headers=JSON).json(), "a transform")
        until(lambda: http.get("/topics/large", headers=JSON).json(), "a string")
        assert http.post("/services/raises").status_code == 422
        assert http.post("/services/echoes", json={"data": True}).status_code == 201
        assert http.put("/parameters/arm", json={"length": 1.5, "names": ["a"]}).is_success
        assert http.post("/actions/ways", json={"goal": 1}).status_code == 201
        yield crawl(http, Site(served.url))
        assert served.stop() == 0


@pytest.fixture(scope="module")
def ros2() -> Iterator[Site]:
    """A real ROS 2: the aircraft, managed nodes, a rover that is driven."""
    with running_ros2("jazzy") as system, servers() as start:
        for node in ("aircraft.py", "managed.py", "rover.py"):
            system.node(node)
        served = start(system.source, python=system.python, environment=system.environment)
        http = served.http
        for path in ("/nodes/camera", "/topics/rover/drive", "/actions/aircraft/fly", "/services/rover/brake"):
            until(lambda path=path: http.get(path).status_code == 200, path)
        until(lambda: "unconfigured" in http.get("/nodes/camera").text, "the state of the camera")
        until(lambda: http.get("/actions/aircraft/fly", headers=JSON).status_code == 200, "the action")
        assert http.post("/services/rover/brake").status_code == 201
        drive = {"linear": {"x": 0.5, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
        assert http.put("/topics/rover/drive", json=drive).is_success
        yield crawl(http, Site(served.url))


SITES = {
    "aircraft": {
        "Graph", "Container", "Node", "Topic", "Service", "Action", "Parameter", "Call", "Goal", "Write", "Hold",
        "Stop", "Property", "ComplexResource", "ActionResource", "Type", "Query", "Source", "File", "SparqlEndpoint",
        "Dataset", "ServerStatus", "Subscriptions", "SubscriptionService", "Authorization",
    },
    "recording": {"Graph", "Node", "Topic", "Bag", "Record", "Container", "Type"},
    "ros1": {"Graph", "Node", "Topic", "Service", "Action", "Parameter", "Call", "Goal", "Property", "Type", "Write"},
    "ros2": {"Graph", "Node", "Topic", "Service", "Action", "Parameter", "Call", "Property", "Type", "Write"},
}  # fmt: skip
each_site = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.ros2] if name == "ros2" else []) for name in SITES]
)


@each_site
def test_every_document_conforms_to_the_shapes_that_it_links_to(name: str, request: pytest.FixtureRequest) -> None:
    site: Site = request.getfixturevalue(name)
    kept = f"{site.base}data/"  # what clients say of other things is theirs
    judged = [url for url in site.of_each_kind() if not url.startswith(kept)]
    wrong = {url: words for url in judged if (words := site.violations(url))}
    assert not wrong, "\n".join(f"{url}\n{words}" for url, words in wrong.items())
    unlinked = {url.removeprefix(site.base) for url, shapes in site.conforms_to.items() if not shapes}
    assert unlinked <= {*WITHOUT_SHAPE}


@each_site
def test_every_resource_is_itself_judged_by_the_shape_that_its_document_links_to(
    name: str, request: pytest.FixtureRequest
) -> None:
    site: Site = request.getfixturevalue(name)
    linked = {url: shapes[0] for url, shapes in site.conforms_to.items() if shapes}
    # An ontology is called by its permanent IRI, wherever it is served.
    own = {url: shape for url, shape in linked.items() if not shape.endswith("#Ontology")}
    classes = {url: shape for url, shape in own.items() if document(shape) == f"{site.base}shapes/documents"}
    assert SITES[name] <= {shape.partition("#")[2] for shape in classes.values()}
    assert not [url for url in classes if not site.is_target(url)]


def test_a_document_that_says_something_else_does_not_conform(aircraft: Site) -> None:
    for path, wrong in {
        "nodes/aircraft": "<> ros:publishes <http://elsewhere/> .",
        "topics/aircraft/engine/speed": "<> ros:name 5 .",
        "services/aircraft/start": "<> ros:provider [ ] .",
        "stop": "<> ros:stopped 'no' .",
        "parameters/aircraft/seats": "<> ros:value 1 , 2 .",
        "": "<> ros:state ros:Running .",
    }.items():
        url = aircraft.base + path
        broken = Site(
            aircraft.base, {**aircraft.documents, url: aircraft.documents[url] + PREFIXES + wrong}, aircraft.conforms_to
        )
        assert broken.violations(url), path


def test_the_shape_of_mappings_finds_no_fault_with_what_is_no_mapping(aircraft: Site) -> None:
    documents = [url for url in aircraft.of_each_kind() if "/data/" not in url]
    assert not [url for url in documents if aircraft.violations_of(url, f"{aircraft.base}shapes/mapping")]
