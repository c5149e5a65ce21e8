"""Documents of properties, actions and complex resources with the operations on offer, as RDF and as JSON.

Operations are described by the ontologies of WoT Thing Descriptions and hypermedia controls: an affordance per property
and action, a form per operation (method, target, media types), and the SHACL shape of the input. These do not depend on
values, so they are created once. Within a complex resource, fragments of affordances contain a slash
(`#properties/power`) and those of values do not (`#power`, `#power.x`), so that they never collide.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple
from urllib.parse import quote

import orjson
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import MessageSchema
from rosld.ontology.describe_holds import holdable
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.lift import LiftSettings
from rosld.ontology.triples import (
    BODIES,
    CONTAINER,
    RDF_SOURCE,
    SSE,
    STREAM,
    boolean,
    forms,
    labelled,
    statements,
    text,
    triples_about,
)
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, ldp, mapping, rdf, rdfs, ros, td
from rosld.server.hypermedia.value import MessageValue, Reading, field_json, lift_value, plain_json, value_literal
from rosld.server.hypermedia.views import ActionAffordance, ActionView, ComplexView, PropertyAffordance, PropertyView
from rosld.shapes.affordance import value_shape_triples
from rosld.shapes.value import MessageShape

VALUE = "#value"
"""Fragment of the node of a property's value, if that is a message."""


# Properties


def property_document(
    view: PropertyView, space: Space, lifting: LiftSettings, *, simulated_time: bool = False
) -> Document:
    """Return a property: its value as rdf:value, its sources, and its current affordances."""
    subject = NamedNode(view.affordance.url)
    value = _described(view.reading, view.field, subject.value, VALUE, lifting)
    name = view.reading.name if view.field is None else _name(subject.value, space)
    triples = (
        *_property(view.affordance, name, view.reads_from, view.writes_to, view.part_of),
        *triples_about(subject, (rdf.value, value.term), (ros.unreadable, value.failure), (ros.words, value.words)),
        *_property_affordance(view.affordance, subject, "#property", space),
        *_hold_affordance(view.affordance, space),
    )
    return Document(subject.value, triples, value.messages, simulated_time)


def property_json(view: PropertyView, lifting: LiftSettings) -> bytes:
    """Return the value of a property as plain JSON; null if there is none."""
    return _json(view.reading, view.field, lifting)


def _property(
    affordance: PropertyAffordance,
    name: str | None,
    reads_from: tuple[str, ...],
    writes_to: tuple[str, ...],
    part_of: str,
) -> tuple[Triple, ...]:
    """Return the triples of a property that do not depend on its value."""
    return tuple(
        triples_about(
            NamedNode(affordance.url),
            (rdf.type, ros.Property),
            *RDF_SOURCE,
            (ros.name, text(name)),
            (dcterms.title, text(affordance.title)),
            (rdfs.label, text(affordance.title or name)),
            *statements(ros.readsFrom, map(NamedNode, reads_from)),
            *statements(ros.writesTo, map(NamedNode, writes_to)),
            (dcterms.isPartOf, NamedNode(part_of)),
        )
    )


# Actions


def action_document(view: ActionView, space: Space) -> Document:
    """Return an action: its ROS service or action, how to invoke it, and how to follow its goal."""
    subject, title = NamedNode(view.affordance.url), view.affordance.title
    name = _name(subject.value, space)
    triples = triples_about(
        subject,
        *RDF_SOURCE,
        (ros.name, text(name)),
        (dcterms.title, text(title)),
        (rdfs.label, text(title or name)),
        (ros.invokes, None if view.invokes is None else NamedNode(view.invokes)),
        (dcterms.isPartOf, NamedNode(view.part_of)),
    )
    triples += _action_affordance(view.affordance, subject, "#action", space)
    for one in view.parts:
        triples += _property_affordance(one, subject, fragment_of("properties", one.name), space)
    return Document(subject.value, tuple(triples))


def _name(url: str, space: Space) -> str | None:
    """Return the full name of the resource at a URL below `resources/`."""
    location = space.location(url)
    return None if location is None else location.name


# Complex resources


def complex_document(
    view: ComplexView, space: Space, lifting: LiftSettings, *, simulated_time: bool = False
) -> Document:
    """Return a complex resource: the values of its members, its current links and actions, and their forms.

    A member with a relation is a property of the complex resource; other members are resources with an rdf:value.
    """
    subject = NamedNode(view.url)
    triples = [*_complex(view.url, view.path, view.title, view.mapping, view.parent)]
    triples += triples_about(subject, *statements(ros.mappingWarning, map(Literal, view.warnings)))
    values: list[Triple] = []
    messages: list[LiftedMessage] = []
    affordances: list[Triple] = []
    for member in view.members:
        one = member.affordance
        described = _described(member.reading, member.field, view.url, fragment_of(one.name), lifting)
        own = NamedNode(one.url)
        values += (
            triples_about(subject, (one.predicate, described.term))
            if one.predicate
            else triples_about(own, (rdf.value, described.term))
        )
        values += triples_about(own, (ros.unreadable, described.failure), (ros.words, described.words))
        values += triples_about(own, *statements(ros.readsFrom, map(NamedNode, member.reading.about)))
        messages += described.messages
        affordances += _property_affordance(one, subject, fragment_of("properties", one.name), space)
    for action in view.actions:
        values += triples_about(subject, (action.relation, NamedNode(action.url))) if action.relation else ()
        affordances += _action_affordance(action, subject, fragment_of("actions", action.name), space)
    values += [Triple(subject, link.relation, NamedNode(link.target)) for link in view.links]
    values += triples_about(subject, *statements(ldp.contains, map(NamedNode, _contents(view))))
    values += triples_about(subject, *statements(dcterms.hasPart, map(NamedNode, view.children)))
    return Document(view.url, (*triples, *values, *affordances), tuple(messages), simulated_time)


def complex_json(view: ComplexView, lifting: LiftSettings) -> bytes:
    """Return the values of the members as a JSON object by name; null for those that cannot be read."""
    pairs = [
        orjson.dumps(member.affordance.name) + b":" + _json(member.reading, member.field, lifting)
        for member in view.members
    ]
    return b"{" + b",".join(pairs) + b"}"


def _complex(url: str, path: str, title: str | None, arranged_by: str | None, parent: str | None) -> tuple[Triple, ...]:
    """Return the triples of a complex resource that do not depend on its state."""
    name = path.rstrip("/") or "/"
    return tuple(
        triples_about(
            NamedNode(url),
            (rdf.type, ros.ComplexResource),
            *CONTAINER,
            (ros.name, text(name)),
            *labelled(dcterms.title, title or (f"Resources in {name}" if name != "/" else "Resources")),
            (rdfs.isDefinedBy, None if arranged_by is None else NamedNode(arranged_by)),
            (dcterms.isPartOf, None if parent is None else NamedNode(parent)),
        )
    )


def _contents(view: ComplexView) -> Iterable[str]:
    """Return the members, actions and children inside a complex resource, without members mapped from elsewhere."""
    used = (*(member.affordance.url for member in view.members), *(action.url for action in view.actions))
    own = (url for url in used if url.startswith(view.url) and "/" not in url[len(view.url) :])
    return dict.fromkeys((*own, *view.children))


# Values


class _Said(NamedTuple):
    """The statement of a value: its literal, or the node of its message and that message.

    If the value cannot be read: the reason, and the robot's own words.
    """

    term: Literal | NamedNode | None = None
    messages: tuple[LiftedMessage, ...] = ()
    failure: Literal | None = None
    words: Literal | None = None


def _described(reading: Reading, field: str | None, document: str, node: str, lifting: LiftSettings) -> _Said:
    """Return the triples of a reading, or of its `field`; a whole message is the fragment `node`."""
    value = reading.value
    if value is None:
        return _Said(failure=text(reading.failure), words=text(reading.words))
    try:
        term = value_literal(value, field)
    except ValueError as error:
        return _Said(failure=text(str(error)))
    if term is not None or not isinstance(value, MessageValue):
        return _Said(term)
    return _Said(NamedNode(document + node), (lift_value(value, node, lifting),))


def _json(reading: Reading, field: str | None, lifting: LiftSettings) -> bytes:
    """Return a reading, or one `field` of it, as plain JSON; null if it cannot be read."""
    value = reading.value
    if value is None:
        return b"null"
    try:
        return plain_json(value, lifting) if field is None else field_json(value, field)
    except ValueError:
        return b"null"


def fragment_of(*parts: str) -> str:
    """Return a fragment of encoded parts joined by slashes. Dots are escaped, as they lead to nested messages."""
    return "#" + "/".join(quote(part, safe="").replace(".", "%2E") for part in parts)


# Affordances


@lru_cache(maxsize=4096)
def _property_affordance(one: PropertyAffordance, document: NamedNode, node: str, space: Space) -> tuple[Triple, ...]:
    """Return a property affordance of the subject of `document`, with a form for each operation available now."""
    subject, shape = NamedNode(document.value + node), NamedNode(f"{document.value}{node}/shape")
    observable = one.read and one.observe
    triples = triples_about(
        subject,
        (rdf.type, td.PropertyAffordance),
        (td.name, text(one.name)),
        (dcterms.title, text(one.title)),
        (dcterms.description, text(one.description)),
        (mapping.predicate, one.predicate),
        (td.isObservable, boolean(observable)),
        *one.shape.quantity.statements,
        (ros.shape, shape),
    )
    if one.read:
        triples += forms(subject, "read", "GET", td.readProperty, one.url, BODIES[:1])
    if one.write:
        triples += forms(subject, "write", "PUT", td.writeProperty, one.url, BODIES)
    if observable:
        triples += forms(subject, "observe", "GET", td.observeProperty, one.url, STREAM, SSE)
    triples += value_shape_triples(one.shape, shape, rdf.value, space)
    return (Triple(document, td.hasPropertyAffordance, subject), *triples)


def _hold_affordance(one: PropertyAffordance, space: Space) -> tuple[Triple, ...]:
    """Return the affordance of holding the topic of a property: publishing while the client renews the hold."""
    if one.hold is None:
        return ()
    shape = space.shape(one.shape.schema.ref.name) if isinstance(one.shape, MessageShape) else None
    return tuple(holdable(one.hold, shape, commands_velocity=True, document=one.url))


@lru_cache(maxsize=4096)
def _action_affordance(one: ActionAffordance, document: NamedNode, node: str, space: Space) -> tuple[Triple, ...]:
    """Return an action affordance of the subject of `document`; without a shape, there is no input.

    An action whose request type is unknown cannot be invoked. It then has no form except that for canceling a goal.
    """
    goals, can_invoke = one.goals, one.request is not None and one.is_open
    if not can_invoke and not (goals is not None and goals.can_cancel):
        return ()
    subject = NamedNode(document.value + node)
    request = one.request if one.request is not None and one.request.type.fields else None
    triples = triples_about(
        subject,
        (rdf.type, td.ActionAffordance),
        (td.name, text(one.name)),
        (dcterms.title, text(one.title)),
        (mapping.relation, one.relation),
        (ros.requestShape, _shape(request, space)),
        (ros.feedbackShape, None if goals is None else _shape(goals.feedback, space)),
        (ros.resultShape, None if goals is None else _shape(goals.result, space)),
    )
    if can_invoke:
        triples += forms(subject, "invoke", "POST", td.invokeAction, one.url, BODIES)
    if goals is not None and goals.status is not None:
        triples += forms(subject, "query", "GET", td.queryAction, goals.status, BODIES[:1])
    if goals is not None and goals.can_cancel:
        triples += forms(subject, "cancel", "DELETE", td.cancelAction, one.url)
    return (Triple(document, td.hasActionAffordance, subject), *triples)


def _shape(schema: MessageSchema | None, space: Space) -> NamedNode | None:
    """Return the shape of a message; None if its type is unknown."""
    return None if schema is None else NamedNode(space.shape(schema.ref.name))
