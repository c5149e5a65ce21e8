"""The paper's aircraft, embedded, behind a server: each test sets its initial state over HTTP."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.vocab import av, ldp
from tests.server.conftest import serve, start_server
from tests.waiting import until

__all__ = ["serve", "start_server"]
"""Fixtures that start servers, from the tests of the server."""

AIRCRAFT, ENGINE = "/resources/aircraft/", "/resources/aircraft/engine/"
JSON, MERGE_PATCH = "application/json", "application/merge-patch+json"
CRUISE = 20.0
"""Speed in flight: a fifth of a second away from rest."""
SERVICES = {
    "/aircraft/start": "std_srvs/srv/Trigger",
    "/aircraft/stop": "std_srvs/srv/Trigger",
    "/aircraft/set_power": "rosld_aircraft/srv/SetText",
    "/aircraft/get_power": "rosld_aircraft/srv/GetText",
    "/aircraft/engine/set_speed": "rosld_aircraft/srv/SetNumber",
    "/aircraft/engine/set_direction": "rosld_aircraft/srv/SetNumber",
    "/aircraft/engine/get_direction": "rosld_aircraft/srv/GetNumber",
}


class Flight:
    """An aircraft behind a server, and its states: off, standing (on, at rest), flying (on, at 20)."""

    def __init__(self, served: Any) -> None:
        self.url: str = served.url
        self.http: httpx.Client = served.http

    # Reading

    def get(self, path: str, accept: str = "text/turtle") -> httpx.Response:
        return self.http.get(path, headers={"Accept": accept})

    def json(self, path: str) -> Any:
        """Return the representation of a resource as plain JSON."""
        answer = self.get(path, JSON)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def triples(self, answer: httpx.Response | str) -> set[Triple]:
        """Return the triples of a response in any RDF syntax, or of the resource at a path."""
        if isinstance(answer, str):
            answer = self.get(answer)
            assert answer.status_code == 200, answer.text
        syntax = RdfFormat.from_media_type(answer.headers["content-type"].partition(";")[0])
        base = answer.headers.get("content-location", str(answer.url))
        return {quad.triple for quad in parse(answer.content, format=syntax, base_iri=base)}

    def said(self, path: str, predicate: NamedNode, *, of: str | None = None) -> set[str]:
        """Return the objects of a predicate of the resource at a path, or of another subject in its document.

        Literals are their text; URLs of this server are paths.
        """
        subject = NamedNode(self.absolute(path if of is None else of))
        found = (one.object for one in self.triples(path) if one.subject == subject and one.predicate == predicate)
        return {one.value if isinstance(one, Literal) else self.path(one.value) for one in found}

    def absolute(self, path: str) -> str:
        return self.url.rstrip("/") + path if path.startswith("/") else path

    def path(self, url: str) -> str:
        """Return a URL of this server as a path, other values unchanged."""
        return url.removeprefix(self.url.rstrip("/")) if url.startswith(self.url) else url

    def relations(self, answer: httpx.Response | str = AIRCRAFT) -> dict[str, str]:
        """Return the relations of the aircraft's vocabulary in a representation, each with a value or a target path."""
        found: dict[str, str] = {}
        for one in self.triples(answer):
            if one.predicate.value.startswith(av.iri) and not isinstance(one.object, Triple):
                name = one.predicate.value.removeprefix(av.iri)
                assert name not in found, f"{name} twice"
                found[name] = self.path(one.object.value)
        return found

    def ask(self, service: str) -> Any:
        """Return the value that a getter of the robot returns."""
        return self.post(f"/services{service}", accept=JSON).json()["data"]

    def robot_speed(self) -> float | None:
        """Return the speed that the robot publishes."""
        read = self.json("/topics/aircraft/engine/speed")
        return None if read is None else read["data"]

    # Writing

    def send(
        self, method: str, path: str, value: object = None, accept: str = JSON, *, type: str = JSON
    ) -> httpx.Response:
        """Send a request with a value as JSON, or without content."""
        content = None if value is None else json.dumps(value)
        headers = {"Accept": accept} if content is None else {"Accept": accept, "Content-Type": type}
        return self.http.request(method, path, content=content, headers=headers)

    def put(self, path: str, value: object) -> httpx.Response:
        return self.send("PUT", path, value)

    def post(self, path: str, value: object = None, accept: str = "text/turtle") -> httpx.Response:
        return self.send("POST", path, value, accept)

    def patch(self, path: str, value: object) -> httpx.Response:
        """Send a PATCH with a JSON merge patch."""
        return self.send("PATCH", path, value, type=MERGE_PATCH)

    def allowed(self, path: str) -> set[str]:
        """Return the methods of a resource, without those of every resource."""
        answer = self.http.options(path)
        assert answer.status_code == 204, answer.text
        return set(answer.headers["allow"].split(", ")) - {"HEAD", "OPTIONS"}

    def calls(self) -> set[str]:
        """Return the calls of services so far."""
        return self.said("/calls/", ldp.contains)

    # States

    def in_state(self, name: str) -> None:
        """Bring the aircraft into the state with this name."""
        {"off": self.off, "standing": self.standing, "flying": self.flying}[name]()

    def off(self) -> None:
        """Bring the aircraft to rest and switch it off."""

        def is_off() -> bool:
            if self.json(AIRCRAFT)["power"] == "off":
                return True
            self.put(f"{ENGINE}speed", 0)
            return self.post(f"{AIRCRAFT}stop").status_code == 200

        until(is_off, "the aircraft off")
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


@pytest.fixture(scope="module")
def flight(start_server: Callable[..., Any]) -> Flight:
    """The aircraft, shared by the tests of a file."""
    return Flight(start_server("aircraft"))
