"""An agent that knows one URL and one vocabulary: it follows links and forms, and builds no URL by itself."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from rdflib import Graph, Namespace
from rdflib.term import Node

ROS, MAP = Namespace("https://w3id.org/rosld#"), Namespace("https://w3id.org/rosld/mapping#")
TD, HCTL = Namespace("https://www.w3.org/2019/wot/td#"), Namespace("https://www.w3.org/2019/wot/hypermedia#")
HTV = Namespace("http://www.w3.org/2011/http#")
LDP, DCTERMS = Namespace("http://www.w3.org/ns/ldp#"), Namespace("http://purl.org/dc/terms/")
AV = Namespace("https://w3id.org/rosld/aircraft#")


def read(url: object) -> Graph:
    """The graph at a URL."""
    with urlopen(Request(str(url), headers={"Accept": "text/turtle"})) as answer:
        return Graph().parse(answer.read(), format="turtle")


def resources(entry: str) -> Iterator[Graph]:
    """Every resource of the robot, found by links from the entry."""
    waiting, seen = list(read(entry).objects(None, LDP.contains)), set()
    while waiting:
        url = waiting.pop()
        if url not in seen and "/resources/" in url:  # the container that the entry calls Resources
            seen.add(url)
            graph = read(url)
            yield graph
            waiting += [*graph.objects(None, DCTERMS.hasPart), *graph.objects(None, AV.engine)]


def do(relation: Node, operation: Node, value: float | None = None) -> None:
    """Do what a relation leads to, if the robot offers it now, and tell what came of it."""
    for graph in resources(sys.argv[1]):
        for affordance in graph.subjects(MAP.predicate | MAP.relation, relation):
            for form in graph.objects(affordance, TD.hasForm):
                if (form, HCTL.hasOperationType, operation) in graph:
                    send(graph.value(form, HTV.methodName), graph.value(form, HCTL.hasTarget), value)
                    return
    print(relation, "is not on offer")


def send(method: object, target: object, value: float | None) -> None:
    """Send what a form asks for."""
    body = None if value is None else json.dumps(value).encode()
    headers = {} if value is None else {"Content-Type": "application/json"}
    try:
        with urlopen(Request(str(target), body, headers, method=str(method))) as answer:
            print(method, target, "" if value is None else value, answer.status)
    except HTTPError as error:
        print(method, target, json.load(error)["detail"])


do(AV.start, TD.invokeAction)
do(AV.speed, TD.writeProperty, 5000)
do(AV.speed, TD.writeProperty, 100)
do(AV.start, TD.invokeAction)
