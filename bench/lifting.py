"""Speed of converting messages to RDF and back, each compared to its baseline in the same run.

    python bench/lifting.py

Decoding from the wire is always included. The baseline for lifting is a straightforward program that creates and writes
the same triples with rdflib, term by term; their equality is checked first.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import orjson
import pyoxigraph as ox
import rdflib
from rdflib.collection import Collection

from rosld.adapters.model import Encoding, Message, MessageSchema, Nested, Primitive, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.body import parse_body, parse_json
from rosld.ontology.lift import TYPES, lifter
from rosld.ontology.literals import DATATYPES, date_time
from rosld.ontology.lower import find_message, lowerer
from rosld.ontology.vocab import rdf, ros, xsd

DOCUMENT = "http://127.0.0.1:8080/bags/run/messages/12345"
LIBRARY = TypeLibrary(ros_version=1)
RANDOM = np.random.default_rng(7)
STAMP = {"sec": 1_700_000_000, "nanosec": 123_456_789}
HEADER = {"seq": 4711, "stamp": STAMP, "frame_id": "base_link"}


def numbers(count: int) -> list[float]:
    return [float(number) for number in RANDOM.random(count) * 20 - 10]


def vector(*names: str) -> dict[str, float]:
    return dict(zip(names, numbers(len(names)), strict=True))


def imu() -> dict[str, object]:
    rates = {f"{name}_covariance": numbers(9) for name in ("orientation", "angular_velocity", "linear_acceleration")}
    moves = {"angular_velocity": vector("x", "y", "z"), "linear_acceleration": vector("x", "y", "z")}
    return {"header": HEADER, "orientation": vector("x", "y", "z", "w"), **moves, **rates}


def transforms() -> dict[str, object]:
    one = {"translation": vector("x", "y", "z"), "rotation": vector("x", "y", "z", "w")}
    return {"transforms": [{"header": HEADER, "child_frame_id": f"link_{i}", "transform": one} for i in range(4)]}


def scan() -> dict[str, object]:
    ranges: list[object] = np.float32(RANDOM.random(1080) * 30).tolist()
    for far in RANDOM.choice(1080, 200, replace=False):
        ranges[far] = "INF"
    setup = {"angle_min": -2.35, "angle_max": 2.35, "angle_increment": 0.004, "range_min": 0.02, "range_max": 30}
    rest = {"time_increment": 1e-5, "scan_time": 0.1, "intensities": (RANDOM.random(1080) * 200).tolist()}
    return {"header": HEADER, **setup, "ranges": ranges, **rest}


class Case:
    """A type, one message of it, and its bytes."""

    def __init__(self, name: str, value: object) -> None:
        schema = LIBRARY.find(TypeRef(name))
        assert isinstance(schema, MessageSchema)
        self.name, self.schema = name, schema
        self.data = schema.codec.encode(lowerer(schema).from_json(value), Encoding.ROS1)
        self.lift = lifter(schema)
        self.message = self.decoded()

    def decoded(self) -> Message:
        return self.schema.codec.decode(self.data, Encoding.ROS1)

    def rosld(self) -> bytes:
        """Convert the bytes of the message to N-Quads."""
        return self.lift.ntriples(self.decoded(), DOCUMENT, "#message", end=f" <{DOCUMENT}> .\n").encode()

    def rdflib(self) -> bytes:
        """Convert the bytes of the message with rdflib."""
        dataset = rdflib.Dataset()
        by_hand(self, self.decoded(), dataset.graph(rdflib.URIRef(DOCUMENT)))
        return dataset.serialize(format="nquads").encode()


def by_hand(case: Case, message: Message, graph: rdflib.Graph) -> None:
    for triple in statements(case.schema, case.schema.ref.name, message, DOCUMENT + "#message", graph):
        graph.add(triple)


def statements(schema: MessageSchema, name: str, message: Any, node: str, graph: rdflib.Graph) -> Iterator[Any]:
    subject = rdflib.URIRef(node)
    yield subject, rdflib.RDF.type, rdflib.URIRef(TYPES + name)
    for field in schema.types[name].fields:
        value, path = getattr(message, field.attribute), f"{node}.{field.name}"
        predicate = rdflib.URIRef(f"{TYPES}{name}#{field.name}")
        if isinstance(field.type, Nested):
            yield subject, predicate, rdflib.URIRef(path)
            yield from statements(schema, field.type.name, value, path, graph)
        elif isinstance(field.type, Primitive):
            yield subject, predicate, literal(field.type.name, value)
        elif isinstance(field.type.element, Nested):
            head: rdflib.term.Node = rdflib.BNode()
            nodes: list[rdflib.term.Node] = [rdflib.URIRef(f"{path}.{i}") for i in range(len(value))]
            Collection(graph, head, nodes)
            yield subject, predicate, head
            for i, item in enumerate(value):
                yield from statements(schema, field.type.element.name, item, f"{path}.{i}", graph)
        else:
            yield subject, predicate, rdflib.Literal(plain_json(value), datatype=rdflib.RDF.JSON)
    if name == "builtin_interfaces/msg/Time":
        stamp = rdflib.Literal(date_time(message.sec, message.nanosec), datatype=rdflib.URIRef(xsd.dateTime.value))
        yield subject, rdflib.URIRef(ros.dateTime.value), stamp


def literal(kind: str, value: Any) -> rdflib.Literal:
    if kind == "string":
        return rdflib.Literal(value)
    form = str(np.float32(value)) if kind == "float32" else repr(value)
    return rdflib.Literal(form, datatype=rdflib.URIRef(xsd.iri + DATATYPES[kind]))


def plain_json(values: Any) -> str:
    """Return an array as a straightforward program writes it: float32s with their own digits, INF as a string."""
    numbers = [float(str(value)) for value in values] if values.dtype == np.float32 else values.tolist()
    return json.dumps([value if np.isfinite(value) else "INF" for value in numbers], separators=(",", ":"))


def canonical(text: bytes) -> set[ox.Quad]:
    """Return the quads independent of labels of blank nodes and notations of digits (1e-05, 0.00001)."""
    quads = [
        ox.Quad(q.subject, q.predicate, plain(q.object), q.graph_name) for q in ox.parse(text, ox.RdfFormat.N_QUADS)
    ]
    dataset = ox.Dataset(quads)
    dataset.canonicalize(ox.CanonicalizationAlgorithm.UNSTABLE)
    return set(dataset)


def plain(term: Any) -> Any:
    if isinstance(term, ox.Literal) and term.datatype in (xsd.float, xsd.double):
        return ox.Literal(repr(float(term.value)), datatype=term.datatype)
    if isinstance(term, ox.Literal) and term.datatype == rdf.JSON:
        return ox.Literal(json.dumps(json.loads(term.value)), datatype=term.datatype)
    return term


def seconds(run: Callable[[], object], budget: float = 1.2) -> float:
    """Return the minimum duration of one run."""
    start = time.perf_counter()
    run()
    count = max(1, int(budget / 20 / (time.perf_counter() - start)))
    best = float("inf")
    for _ in range(20):
        start = time.perf_counter()
        for _ in range(count):
            run()
        best = min(best, (time.perf_counter() - start) / count)
    return best


def lifting(case: Case) -> None:
    rdflib.NORMALIZE_LITERALS = False
    text = case.rosld()
    quads = canonical(text)
    assert quads == canonical(case.rdflib()), f"{case.name}: rdflib's triples differ"
    ours, theirs, decoding = seconds(case.rosld), seconds(case.rdflib), seconds(case.decoded)
    print(
        f"{case.name:32} {len(quads):4} triples  {ours * 1e6:8.1f} us ({decoding * 1e6:5.1f} of them decoding)  "
        f"{len(quads) / ours / 1e6:5.2f} M triples/s  {len(text) / ours / 1e6:5.0f} MB/s  {theirs / ours:5.0f} x rdflib"
    )


def syntaxes(case: Case) -> None:
    lift, message = case.lift, case.message
    runs: dict[str, Callable[[], object]] = {
        "Turtle": lambda: lift.turtle(message, DOCUMENT, "#message"),
        "JSON-LD": lambda: lift.jsonld(message, DOCUMENT, "#message"),
        "N-Triples": lambda: lift.ntriples(message, DOCUMENT, "#message"),
        "JSON": lambda: lift.json(message, DOCUMENT),
        "terms": lambda: lift.triples(message, DOCUMENT, "#message"),
    }
    times = "  ".join([f"{name} {seconds(run, 0.4) * 1e6:.1f}" for name, run in runs.items()])
    print(f"{case.name:32} us without decoding: {times}")


def lowering(case: Case) -> None:
    lift, lower = case.lift, lowerer(case.schema)
    prefixes = "".join([f"@prefix {prefix}: <{iri}> .\n" for prefix, iri in lift.prefixes.items()])
    turtle = f"@base <{DOCUMENT}> .\n{prefixes}{lift.turtle(case.message, DOCUMENT, '#message')}".encode()
    context = orjson.dumps(dict(lift.context)).decode()
    jsonld = f'{{"@context":{context},{lift.jsonld(case.message, DOCUMENT, "#message")[1:]}'.encode()
    plain = lift.json(case.message, DOCUMENT)

    def rdf(text: bytes, media_type: str) -> Message:
        body = parse_body(text, media_type, DOCUMENT)
        return lower.from_graph(body, find_message(body, DOCUMENT, TYPES + case.name), DOCUMENT)

    runs: dict[str, Callable[[], Message]] = {
        "Turtle": lambda: rdf(turtle, "text/turtle"),
        "JSON-LD": lambda: rdf(jsonld, "application/ld+json"),
        "JSON": lambda: lower.from_json(parse_json(plain)),
    }
    for name, run in runs.items():
        assert case.schema.codec.encode(run(), Encoding.ROS1) == case.data, f"{case.name}: {name} lowers to another"
    theirs = seconds(lambda: rdflib.Graph().parse(data=turtle, format="turtle", publicID=DOCUMENT))
    times = {name: seconds(run) for name, run in runs.items()}
    told = "  ".join([f"{name} {taken * 1e6:.1f}" for name, taken in times.items()])
    ratio = theirs / times["Turtle"]
    print(f"{case.name:32} us with parsing: {told}  (rdflib only parsing the Turtle: {ratio:.0f} x)")


def main() -> None:
    print("Lifting to N-Quads, decoding included:")
    cases = [
        Case("sensor_msgs/msg/Imu", imu()),
        Case("tf2_msgs/msg/TFMessage", transforms()),
        Case("sensor_msgs/msg/LaserScan", scan()),
    ]
    for case in cases:
        lifting(case)
    twist = Case("geometry_msgs/msg/Twist", {"linear": vector("x", "y", "z"), "angular": vector("x", "y", "z")})
    print("\nRepresentations:")
    syntaxes(twist)
    syntaxes(cases[0])
    print("\nLowering:")
    lowering(twist)
    lowering(cases[0])


if __name__ == "__main__":
    main()
