"""Bodies of writes to a property, parsed to its new value. Pure.

It is plain JSON (as `parse_json` gives it) or, where RDF says it with a literal, that `Literal`: its datatype tells
what a JSON value could not.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.adapters.model import Field, MessageSchema
from rosld.ontology.body import RdfBody, Term, parse_json
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import lowerer
from rosld.ontology.violations import LoweringError, Violation, brief_value
from rosld.ontology.vocab import rdf
from rosld.server.hypermedia.catalogue import Getter, Property, Setter, TopicSource
from rosld.server.hypermedia.value import WHOLE, MessageValue, plain_json, select_fields


class Layout(NamedTuple):
    """The fields of a type of message as which a value may be sent."""

    schema: MessageSchema
    fields: tuple[Field, ...]


def content_from_rdf(
    body: RdfBody,
    subject: NamedNode,
    predicate: NamedNode,
    property: Property,
    lifting: LiftSettings,
) -> object:
    """The content that `subject` `predicate` states for a property.

    That is a literal, or a node whose type is that of messages which the property is read as or written with. Raises
    LoweringError where there is nothing, more than one value, or a value of another kind.
    """
    term = _single_object(body, subject, predicate)
    if isinstance(term, Literal):
        return term
    if not isinstance(term, NamedNode | BlankNode):
        raise LoweringError(Violation("", "expected a literal or a node", brief_value(term)))
    return _describe(body, term, property, lifting, subject.value)


def _single_object(body: RdfBody, subject: NamedNode, predicate: NamedNode) -> Term:
    terms = body.objects(subject, predicate)
    if len(terms) > 1:
        raise LoweringError(Violation("", f"expected one value, and there are {len(terms)}: {predicate} is said twice"))
    if terms:
        return terms[0]
    raise LoweringError(Violation("", f"missing: expected the value, as {subject} {predicate}"))


def _describe(
    body: RdfBody, node: NamedNode | BlankNode, property: Property, lifting: LiftSettings, document: str
) -> object:
    """The plain JSON of the message that a node is."""
    kinds = body.objects(node, rdf.type)
    known = {NamedNode(lifting.types + each.schema.ref.name): each for each in layouts(property)}
    found = next((known[kind] for kind in kinds if isinstance(kind, NamedNode) and kind in known), None)
    if found is None:
        expected = f"a node of type {' or '.join(map(str, known))}" if known else "a literal"
        stated = ", ".join(map(str, kinds)) or f"{node} without a type"
        raise LoweringError(Violation("", f"expected {expected}", brief_value(stated)))
    part = select_fields(found.schema, found.fields)
    message = lowerer(part, lifting).from_graph(body, node, document)
    return parse_json(plain_json(MessageValue(found.schema, message, found.fields, document), WHOLE))


def layouts(property: Property) -> Iterator[Layout]:
    """The messages that the property is read as and written with."""
    for way in (*property.readers, *property.writers):
        match way:
            case TopicSource(schema=schema) if schema is not None:
                yield Layout(schema, schema.type.fields)
            case Getter(schema=service, fields=fields):
                yield Layout(service.response, fields)
            case Setter(schema=service):
                yield Layout(service.request, service.request.type.fields)
            case _:
                pass
