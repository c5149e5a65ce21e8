"""Lowering: bodies in RDF or plain JSON to ROS messages, by tables of readers made once a schema.

Whatever does not fit the type exactly is refused with the path of the field and what was expected; nothing is
guessed, rounded (but floats to the nearest) or filled in. What comes out can always be encoded.
"""

from __future__ import annotations

from functools import lru_cache
from typing import cast

from pyoxigraph import NamedNode

from rosld.adapters.model import Message, MessageSchema
from rosld.ontology.body import RdfBody, Term, parse_json
from rosld.ontology.coercion import Misfit
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower_graph import GraphReaders, GraphReading
from rosld.ontology.lower_json import JsonReaders, JsonReading
from rosld.ontology.violations import Findings, LoweringError, Violation
from rosld.ontology.vocab import ros

__all__ = ["Lowerer", "LoweringError", "Violation", "find_message", "lowerer", "parse_json"]


class Lowerer:
    """Reads messages of one schema."""

    def __init__(self, schema: MessageSchema, settings: LiftSettings) -> None:
        self.schema = schema
        self._type = settings.types + schema.ref.name
        self._from_json = JsonReaders(schema).message(schema.ref.name)
        self._from_graph = GraphReaders(schema, settings.types).message(schema.ref.name)

    def from_json(self, value: object, *, defaults: bool = False) -> Message:
        """The message in a JSON value (as `parse_json` gives it); missing fields have ROS's defaults if `defaults`.

        Raises LoweringError with a violation for everything that does not fit (the first twenty of them).
        """
        reading = JsonReading(Findings(), defaults)
        message: object = None
        try:
            message = self._from_json(value, None, reading)
        except Misfit as misfit:
            reading.findings.misfit(None, misfit)
        return _result(reading.findings, message)

    def from_body(self, body: RdfBody, document: str, node: str = "#message") -> Message:
        """The message in what was sent to `document`; of a type without fields nothing needs to be said.

        Raises LoweringError as `find_message` and `from_graph`.
        """
        if not self.schema.type.fields and not body.instances(NamedNode(self._type)):
            return self.from_json({})
        return self.from_graph(body, find_message(body, document, self._type, node), document)

    def from_graph(self, body: RdfBody, root: Term, document: str) -> Message:
        """The message whose node in `body` is `root`; `document` is the URL it was sent to.

        Raises LoweringError with a violation for everything that does not fit (the first twenty of them).
        """
        reading = GraphReading(body)
        message: object = None
        try:
            message = self._from_graph(root, None, reading)
        except Misfit as misfit:
            reading.findings.misfit(None, misfit)
        return _result(reading.findings, message)


def _result(findings: Findings, message: object) -> Message:
    if findings.violations:
        raise LoweringError(*findings.violations)
    return cast(Message, message)


@lru_cache(maxsize=1024)
def lowerer(schema: MessageSchema, settings: LiftSettings = LiftSettings()) -> Lowerer:  # noqa: B008
    """The lowerer of a schema; made once a schema and settings."""
    return Lowerer(schema, settings)


def find_message(body: RdfBody, document: str, type_iri: str, node: str = "#message") -> Term:
    """The node of the message in what was sent to `document`.

    That is a node of the type: `document` + `node`, else what `<document> ros:latest` points to, else the only one, or
    the only one that is no part of another. Raises LoweringError where there is none, or more than one.
    """
    typed = body.instances(NamedNode(type_iri))
    named = NamedNode(document + node)
    if named in typed:
        return named
    latest = body.objects(NamedNode(document), ros.latest)
    if len(latest) == 1 and latest[0] in typed:
        return latest[0]
    if len(typed) > 1:
        roots = set(body.roots())
        typed = [subject for subject in typed if subject in roots]
    if len(typed) == 1:
        return typed[0]
    found = "none" if not typed else f"{len(typed)}"
    raise LoweringError(
        Violation(
            "", f"expected one node of type <{type_iri}>, and there is {found}: give <{document}{node}> that type"
        )
    )
