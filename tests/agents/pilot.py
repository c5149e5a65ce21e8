"""A pilot: finds an aircraft from a server's entry URL, starts it, brings it to a speed, back to rest, and stops it.

    python pilot.py http://127.0.0.1:8080/

It knows vocabularies and no paths: every URL is from a link or a form, every body is validated against its shape before
it is sent, and only operations on offer are requested. Its decisions are pure; only `Web` speaks HTTP.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import httpx
import pyshacl
from rdflib import RDF, Graph, Literal, Namespace, URIRef
from rdflib.term import Node

AV = Namespace("https://w3id.org/rosld/aircraft#")
ROS = Namespace("https://w3id.org/rosld#")
MAP = Namespace("https://w3id.org/rosld/mapping#")
LDP = Namespace("http://www.w3.org/ns/ldp#")
DCTERMS = Namespace("http://purl.org/dc/terms/")
SH = Namespace("http://www.w3.org/ns/shacl#")
TD = Namespace("https://www.w3.org/2019/wot/td#")
HCTL = Namespace("https://www.w3.org/2019/wot/hypermedia#")
HTV = Namespace("http://www.w3.org/2011/http#")

TURTLE = "text/turtle"
CRUISE = 500.0
OTHERS_WERE_FIRST = frozenset({404, 409, 412, 422, 429, 503, 504})
"""Statuses of requests whose precondition no longer holds: read the state again."""

Tell: TypeAlias = Callable[[str], None]


class Lost(Exception):
    """The pilot cannot continue; the message says why."""


class Forbidden(Lost):
    """A value that violates the shape and is not sent."""


# Parts of a representation


@dataclass(frozen=True, slots=True)
class Form:
    """A form of an operation: a request and the media type of its body."""

    method: str
    target: str
    media_type: str


@dataclass(frozen=True, slots=True, eq=False)
class Demand:
    """Constraints of a shape in a graph on a resource with one value of `datatype` at `path`."""

    graph: Graph
    shape: Node
    path: URIRef
    datatype: URIRef

    def body(self, target: str, value: float) -> str:
        """Return the value as Turtle. Raises Forbidden if it violates the shape."""
        subject = URIRef(target)
        body = Graph().add((subject, self.path, Literal(str(value), datatype=self.datatype)))
        permissions = Graph() + self.graph
        permissions.add((self.shape, SH.targetNode, subject))
        conforms, _, words = pyshacl.validate(body, shacl_graph=permissions)
        if not conforms:
            raise Forbidden(f"{value:g} is not sent to {target}: {words}")
        return body.serialize(format=TURTLE)


@dataclass(frozen=True, slots=True)
class Control:
    """A writable property: the form, and the shape of the body."""

    form: Form
    demand: Demand


@dataclass(frozen=True, slots=True)
class Seen:
    """The aircraft as its representations show it; None for a part that is missing or not on offer."""

    power: str | None = None
    speed: float | None = None
    start: Form | None = None
    stop: Form | None = None
    throttle: Control | None = None


def form_of(graph: Graph, affordance: Node | None, operation: URIRef) -> Form | None:
    """Return the form of an affordance for an operation, for bodies of Turtle, or None."""
    for form in graph.objects(affordance, TD.hasForm):
        if (form, HCTL.hasOperationType, operation) in graph and (form, HCTL.forContentType, Literal(TURTLE)) in graph:
            method, target = graph.value(form, HTV.methodName), graph.value(form, HCTL.hasTarget)
            if method is not None and target is not None:
                return Form(str(method), str(target), TURTLE)
    return None


def action(graph: Graph, resource: URIRef, relation: URIRef) -> Form | None:
    """Return how to invoke the target of a relation; None if it is not on offer."""
    if (resource, relation, None) not in graph:
        return None
    return form_of(graph, graph.value(predicate=MAP.relation, object=relation), TD.invokeAction)


def control(graph: Graph, predicate: URIRef) -> Control | None:
    """Return how to set the property of a predicate; None if it cannot be set now, or if its shape is unknown."""
    affordance = graph.value(predicate=MAP.predicate, object=predicate)
    form = form_of(graph, affordance, TD.writeProperty)
    demand = demanded(graph, graph.value(affordance, ROS.shape))
    return None if form is None or demand is None else Control(form, demand)


def demanded(graph: Graph, shape: Node | None) -> Demand | None:
    """Return the constraints of a shape of a single literal."""
    part = graph.value(shape, SH.property)
    path, datatype = graph.value(part, SH.path), graph.value(part, SH.datatype)
    if shape is None or not isinstance(path, URIRef) or not isinstance(datatype, URIRef):
        return None
    return Demand(graph, shape, path, datatype)


def number(term: Node | None) -> float | None:
    """Return a literal as a number."""
    return None if term is None else float(str(term))


# Decisions


@dataclass(frozen=True, slots=True)
class Flight:
    """The pilot's state: the speed to reach, whether it was reached, its last order, the last observed speed."""

    cruise: float = CRUISE
    cruised: bool = False
    ordered: float | None = None
    speed: float | None = None

    @property
    def wanted(self) -> float:
        """The target speed: first the cruise, then rest."""
        return 0.0 if self.cruised else self.cruise


@dataclass(frozen=True, slots=True)
class Look:
    """Wait a moment and read again."""


@dataclass(frozen=True, slots=True)
class Invoke:
    """Carry out an action."""

    form: Form


@dataclass(frozen=True, slots=True)
class Order:
    """Set the speed."""

    control: Control
    speed: float


@dataclass(frozen=True, slots=True)
class Landed:
    """The flight is over and the aircraft stopped."""


Step: TypeAlias = Look | Invoke | Order | Landed


def noted(flight: Flight, seen: Seen) -> Flight:
    """Return the state after an observation. An order overruled by another client is forgotten, and given again."""
    if seen.speed is None:
        return replace(flight, ordered=None, speed=None)
    if not flight.cruised and seen.speed == flight.cruise:
        return replace(flight, cruised=True, ordered=None, speed=seen.speed)
    strays = flight.speed is not None and abs(flight.wanted - seen.speed) > abs(flight.wanted - flight.speed)
    return replace(flight, ordered=None if strays else flight.ordered, speed=seen.speed)


def decide(flight: Flight, seen: Seen) -> Step:
    """Return the next step: a useful one on offer, or else another observation."""
    if flight.cruised and seen.power == "off":
        return Landed()
    if not flight.cruised and seen.start is not None:
        return Invoke(seen.start)
    if seen.speed is None:
        return Look()
    if seen.speed != flight.wanted and flight.ordered != flight.wanted and seen.throttle is not None:
        return Order(seen.throttle, flight.wanted)
    if flight.cruised and seen.stop is not None:
        return Invoke(seen.stop)
    return Look()


# HTTP


class Web:
    """Resources, read and written over HTTP."""

    def __init__(self, http: httpx.Client, tell: Tell) -> None:
        self._http = http
        self._tell = tell

    def read(self, url: str) -> Graph | None:
        """Return a resource's representation; None if it does not exist (404)."""
        answer = self._http.get(url, headers={"Accept": TURTLE})
        if answer.status_code in OTHERS_WERE_FIRST:
            return None
        if answer.status_code != 200:
            raise Lost(f"GET {url} is {answer.status_code}: {answer.text}")
        return Graph().parse(data=answer.text, format="turtle", publicID=url)

    def send(self, form: Form, body: str = "") -> bool:
        """Carry out a form; return False if it was refused because the state has changed."""
        headers = {"Content-Type": form.media_type} if body else {}
        answer = self._http.request(form.method, form.target, content=body, headers={"Accept": TURTLE, **headers})
        self._tell(f"{form.method} {form.target} {answer.status_code}")
        if answer.is_success:
            return True
        if answer.status_code in OTHERS_WERE_FIRST:
            return False
        raise Lost(f"{form.method} {form.target} is {answer.status_code}: {answer.text}")


def found(web: Web, entry: str) -> str:
    """Return the aircraft: the complex resource, linked from the entry, that has power or can be started."""
    waiting, known = list(rooms(web, entry)), set[str]()
    while waiting:
        url = waiting.pop(0)
        graph = None if url in known else web.read(url)
        known.add(url)
        if graph is None:
            continue
        if {AV.power, AV.start} & set(graph.predicates(URIRef(url))):
            return url
        if (URIRef(url), RDF.type, ROS.ComplexResource) in graph:
            waiting += map(str, graph.objects(URIRef(url), DCTERMS.hasPart))
    raise Lost(f"no aircraft is to be found from {entry}")


def rooms(web: Web, entry: str) -> Iterator[str]:
    """Yield the containers in the entry, complex resources first."""
    graph = web.read(entry)
    if graph is not None:
        inside = list(graph.objects(URIRef(entry), LDP.contains))
        complexes = [room for room in inside if (room, RDF.type, ROS.ComplexResource) in graph]
        yield from dict.fromkeys(map(str, (*complexes, *inside)))


def looked(web: Web, aircraft: str) -> Seen:
    """Return the aircraft, and its engine if it links to one."""
    graph = web.read(aircraft)
    if graph is None:
        return Seen()
    subject = URIRef(aircraft)
    power, engine = graph.value(subject, AV.power), graph.value(subject, AV.engine)
    seen = Seen(
        None if power is None else str(power),
        start=action(graph, subject, AV.start),
        stop=action(graph, subject, AV.stop),
    )
    inner = None if engine is None else web.read(str(engine))
    if engine is None or inner is None:
        return seen
    return replace(seen, speed=number(inner.value(engine, AV.speed)), throttle=control(inner, AV.speed))


def fly(
    http: httpx.Client,
    entry: str,
    *,
    cruise: float = CRUISE,
    tell: Tell = print,
    pause: float = 0.2,
    patience: float = 60.0,
) -> None:
    """Fly, reporting each step. Raises Lost if it cannot continue within `patience` seconds."""
    web, flight, until = Web(http, tell), Flight(cruise), time.monotonic() + patience
    aircraft = found(web, entry)
    tell(f"found {aircraft}")
    while time.monotonic() < until:
        seen = looked(web, aircraft)
        flight = noted(flight, seen)
        match decide(flight, seen):
            case Landed():
                tell("landed")
                return
            case Invoke(form) if web.send(form):
                continue
            case Order(by, speed) if web.send(by.form, by.demand.body(by.form.target, speed)):
                flight = replace(flight, ordered=speed)
            case _:
                tell(f"power {seen.power}, speed {seen.speed}")
        time.sleep(pause)
    raise Lost(f"not landed within {patience:g} s; seen last: {looked(web, aircraft)}")


if __name__ == "__main__":
    with httpx.Client(timeout=15) as client:
        fly(client, sys.argv[1])
