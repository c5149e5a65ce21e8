"""Unknown query parameters: a request with one is refused, and a write has no effect."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.server.robots.made_up import MadeUp, Serving

UPDATE = "application/sparql-update"


WRITES = (
    ("POST", "/topics/cockpit/display?rate=2&duration=3", "duration", "rate"),
    ("POST", "/topics/cockpit/display?rate=2&leas=3", "leas", "lease"),
    ("PUT", "/topics/cockpit/display?dryrun=true", "dryrun", "dry-run"),
    ("PUT", "/topics/cockpit/display?Strict=true", "Strict", "strict"),
    ("POST", "/actions/aircraft/fly?lease=2", "lease", "defaults"),
    ("POST", "/services/aircraft/start?strikt=true", "strikt", "strict"),
    ("PUT", "/parameters/aircraft/seats?rate=1", "rate", "format"),
    ("PUT", "/resources/aircraft/power?at=-5", "at", "format"),
    ("DELETE", "/data/kept?version=true", "version", "versions"),
    ("PUT", "/graphs?graf=/data/x", "graf", "graph"),
    ("POST", "/sparql?dryrun=true", "dryrun", "dry-run"),
    ("DELETE", "/stop?reason=x", "reason", "dry-run"),
)
READS = (
    ("/topics/cockpit/display?feild=data", "field"),
    ("/topics/cockpit/display?untill=data+%3D+1", "until"),
    ("/topics/?formt=json", "format"),
    ("/resources/aircraft/power?fromat=json", "format"),
    ("/parameters/aircraft/seats?rates=1", "rate"),
    ("/find?qq=battery", "q"),
    ("/graph?bellow=/camera", "below"),
    ("/openapi.json?bellow=/topics/", "below"),
)


@pytest.mark.slow
def test_an_unknown_parameter_is_refused_with_the_nearest_one(http: httpx.Client) -> None:
    http.put("/data/kept", content="<> <urn:p> 1 .", headers={"Content-Type": "text/turtle"})
    for method, path, named, nearest in WRITES:
        kind = UPDATE if "sparql" in path else "text/turtle" if "graphs" in path else "application/json"
        answer = http.request(method, path, content="{}", headers={"Content-Type": kind})
        assert answer.status_code == 400, (path, answer.text)
        if "graf" not in named:  # no graph is named then, either
            assert f"?{named} here; the nearest is ?{nearest}." in answer.json()["detail"]
    for path, nearest in READS:
        assert http.head(path).status_code == 400
        answer = http.get(path, headers={"Accept": "application/json"})
        assert answer.status_code == 400, (path, answer.text)
        assert f"the nearest is ?{nearest}." in answer.json()["detail"]
    for path in ("/data/?_=1", "/data/kept?v=3&v=4", "/sparql?query=ASK+%7B%7D&infer=no", "/style.css?v=1"):
        assert http.get(path).status_code == 200, "browsers, caches and SPARQL clients add such"
    for name, status in (("topics/aircraft/engine/speed", 200), ("nodes/aircraft", 400)):
        graph = http.get("/graphs", params={"graph": f"{http.base_url}{name}", "field": "data"})
        assert graph.status_code == status, "what one graph takes is not what another takes"


def test_a_repeated_parameter_is_refused_unless_it_is_a_list(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/drive", "geometry_msgs/msg/Twist", published=False, heard=True)
    http = serving()
    answer = http.post("/topics/drive?lease=1&lease=5", json={})
    assert (answer.status_code, "?lease is given more than once" in answer.text) == (400, True)
    several = "using-graph-uri=urn:a&using-graph-uri=urn:b"
    update = {
        "content": "DELETE { GRAPH </data/x> { ?s <urn:p> 1 } } WHERE { ?s <urn:p> 1 }",
        "headers": {"Content-Type": UPDATE},
    }
    assert http.post(f"/sparql?{several}", **update).status_code == 204, "a list may have several"


def test_a_stop_stops_whatever_its_parameters_are(own_aircraft: httpx.Client) -> None:
    assert own_aircraft.post("/stop?now=please&now=please").status_code == 200
    told: Any = own_aircraft.get("/stop", headers={"Accept": "application/json"}).json()
    assert told["stopped"] is True
