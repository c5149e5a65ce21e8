"""Services and their calls described."""

from __future__ import annotations

from dataclasses import dataclass

from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Graph, Message, MessageSchema, Service
from rosld.ontology.describe_topics import type_url
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.namespaces import is_namespace
from rosld.ontology.triples import RDF_SOURCE, Statement, date_time_literal, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import prov, rdf, ros

_SETTINGS = LiftSettings()


def service_document(service: Service, space: Space, graph: Graph) -> Document:
    """A service: its type, who provides it, the shapes of what to send and what comes back, why it cannot be called."""
    url = space.service(service.name)
    triples = triples_about(
        NamedNode(url),
        (rdf.type, ros.Service),
        *RDF_SOURCE,
        (ros.name, text(service.name)),
        *_type(service, space),
        *statements(ros.provider, [NamedNode(space.node(node)) for node in dict.fromkeys(service.providers)]),
        (ros.uncallable, text(service.uncallable)),
        (ros.namespace, NamedNode(url + "/") if is_namespace(service.name, graph.services) else None),
    )
    if service.type is not None:
        triples += type_url(service.type, space)
    return Document(url, tuple(triples), simulated_time=graph.simulated_time)


def _type(service: Service, space: Space) -> list[Statement]:
    if service.type is None:
        return []
    name = service.type.name
    return [
        (ros.hasServiceType, NamedNode(space.class_of(name))),
        (ros.requestShape, NamedNode(space.shape(f"{name}_Request"))),
        (ros.responseShape, NamedNode(space.shape(f"{name}_Response"))),
    ]


@dataclass(frozen=True, slots=True, eq=False)
class CallView:
    """A call as it is described: `state` is a local name of the vocabulary (`Running`, `Succeeded`, ...).

    A message comes with its schema. Times are wall-clock nanoseconds. `receipt` is the id of that of its request.
    """

    id: str
    service: str
    state: str
    created_ns: int
    request: tuple[MessageSchema, Message]
    response: tuple[MessageSchema, Message] | None = None
    answered_ns: int | None = None
    words: str | None = None
    receipt: str | None = None


def call_document(call: CallView, space: Space, settings: LiftSettings = _SETTINGS) -> Document:
    """The document of a call: its request, its response, its outcome."""
    url = space.call(call.id)
    halves = {"request": call.request, "response": call.response}
    messages = tuple(
        LiftedMessage(f"#{half}", lifter(found[0], settings), found[1]) for half, found in halves.items() if found
    )
    triples = triples_about(
        NamedNode(url),
        *RDF_SOURCE,
        (ros.request, NamedNode(f"{url}#request")),
        (ros.response, NamedNode(f"{url}#response") if call.response else None),
        (prov.wasInformedBy, None if call.receipt is None else NamedNode(space.activity(call.receipt))),
    )
    times = call.created_ns, call.answered_ns
    outline = call_outline(call.id, call.service, call.state, times, call.words, space)
    return Document(url, (*outline, *triples), messages)


def call_outline(
    id: str, service: str, state: str, times_ns: tuple[int, int | None], words: str | None, space: Space
) -> list[Triple]:
    """The triples of a call that lists have, too: its service, its outcome, its times."""
    return triples_about(
        NamedNode(space.call(id)),
        (rdf.type, ros.Call),
        (ros.isCallOf, NamedNode(space.service(service))),
        (ros.state, ros.terms()[state]),
        (prov.startedAtTime, date_time_literal(times_ns[0])),
        (prov.endedAtTime, date_time_literal(times_ns[1])),
        (ros.words, text(words)),
    )
