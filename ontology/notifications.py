"""Notifications (Solid Notifications Protocol 0.3): terms, services, channels and messages.

Everything has two forms: triples for every syntax, and compact JSON-LD for clients without RDF.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple, TypeAlias

from msgspec import Struct
from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.document import Document
from rosld.ontology.literals import date_time
from rosld.ontology.triples import RDF_SOURCE, date_time_literal, statements, text, triples_about
from rosld.ontology.vocab import activity, ldp, notify, rdf, rdfs, xsd

Json: TypeAlias = Mapping[str, object]

CONTEXT = "https://www.w3.org/ns/solid/notifications-context/v1"
ACTIVITY_CONTEXT = "https://www.w3.org/ns/activitystreams"
KNOWN_CONTEXTS = frozenset({CONTEXT, "https://www.w3.org/ns/solid/notification/v1"})
"""The context of the protocol, and its name in the drafts of the channel types."""

DURATION = NamedNode(xsd.iri + "duration")
FEATURES = (notify.accept, notify.endAt, notify.rate, notify.startAt, notify.state)
CHANNEL_TYPES = ("WebSocketChannel2023", "StreamingHTTPChannel2023")
_OLD = "http://www.w3.org/ns/solid/notification#"

DEFINITIONS: Json = {
    "id": "@id",
    "type": "@type",
    "notify": notify.iri,
    **{name: notify.iri + name for name in (*CHANNEL_TYPES, "accept", "state")},
    **{name: {"@id": notify.iri + name, "@type": "@id"} for name in ("subscription", "channel", "topic")},
    **{name: {"@id": notify.iri + name, "@type": "@id"} for name in ("receiveFrom", "sendTo", "sender")},
    **{name: {"@id": notify.iri + name, "@type": "@vocab"} for name in ("channelType", "feature")},
    **{name: {"@id": notify.iri + name, "@type": xsd.dateTime.value} for name in ("startAt", "endAt")},
    "rate": {"@id": notify.iri + "rate", "@type": DURATION.value},
}
"""Definitions of terms in the context of the protocol, included because nothing is fetched."""
_TYPES: Json = {"@type": [ldp.Resource.value, ldp.RDFSource.value]}
"""JSON-LD key for the LDP types; `type` has the one type that clients without RDF read."""
_LABEL, _TITLE = rdfs.label.value, "Notifications"


def channel_type(name: str) -> NamedNode:
    """Return the IRI of a channel type."""
    return NamedNode(notify.iri + name)


def type_named(iri: str) -> str | None:
    """Return the channel type for an IRI, None if it is unknown; drafts spell the namespace in the singular."""
    name = iri.removeprefix(_OLD).removeprefix(notify.iri)
    return name if name in CHANNEL_TYPES and name != iri else None


class ServiceDescription(Struct, frozen=True):
    """A subscription service: its URL, and the name of its channel type."""

    url: str
    type: str

    def document(self) -> Document:
        """Return the description of the service (protocol 3.2)."""
        return Document(self.url, tuple(self.triples()))

    def triples(self) -> list[Triple]:
        """Return the statements made by the channel and by the server description."""
        return triples_about(
            NamedNode(self.url),
            *RDF_SOURCE,
            (rdfs.label, text(self.type)),
            (notify.channelType, channel_type(self.type)),
            *statements(notify.feature, FEATURES),
        )

    def members(self) -> Json:
        """Return the same statements as members of a JSON-LD object."""
        features = [feature.value for feature in FEATURES]
        return {
            "id": self.url,
            **_TYPES,
            _LABEL: self.type,
            "channelType": channel_type(self.type).value,
            "feature": features,
        }


def description_document(url: str, storage: str, services: Iterable[ServiceDescription]) -> Document:
    """Return the description resource of a whole server (protocol 3.1), about itself and its storage."""
    found = tuple(services)
    offers = statements(notify.subscription, [NamedNode(service.url) for service in found])
    more = [triple for service in found for triple in service.triples()]
    return Document(
        url,
        (
            *triples_about(NamedNode(url), *RDF_SOURCE, (rdfs.label, Literal(_TITLE)), *offers),
            *triples_about(NamedNode(storage), *offers),
            *more,
        ),
    )


def description_members(url: str, storage: str, services: Iterable[ServiceDescription]) -> Json:
    """Return the same statements as members of a JSON-LD object."""
    found = tuple(services)
    offers = {"id": storage, "subscription": [service.url for service in found]}
    return {
        "id": url,
        **_TYPES,
        _LABEL: _TITLE,
        "subscription": [service.members() for service in found],
        "@included": [offers],
    }


class ChannelDescription(Struct, frozen=True):
    """Description of a channel (protocol 3.3): `interval` is its rate in seconds, times are ns since 1970."""

    url: str
    type: str
    topic: str
    receive_from: str
    accept: str
    interval: float
    start_at: int | None = None
    end_at: int | None = None
    state: str | None = None

    @property
    def label(self) -> str:
        return f"Channel of {self.topic}"

    def document(self) -> Document:
        """Return the channel as RDF."""
        triples = triples_about(
            NamedNode(self.url),
            (rdf.type, channel_type(self.type)),
            *RDF_SOURCE,
            (rdfs.label, text(self.label)),
            (notify.topic, NamedNode(self.topic)),
            (notify.receiveFrom, NamedNode(self.receive_from)),
            (notify.accept, text(self.accept)),
            (notify.rate, Literal(duration(self.interval), datatype=DURATION)),
            (notify.startAt, date_time_literal(self.start_at)),
            (notify.endAt, date_time_literal(self.end_at)),
            (notify.state, text(self.state)),
        )
        return Document(self.url, tuple(triples))

    def members(self) -> Json:
        """Return the same statements as members of a JSON-LD object."""
        found = {
            "id": self.url,
            "type": channel_type(self.type).value,
            **_TYPES,
            _LABEL: self.label,
            "topic": self.topic,
            "receiveFrom": self.receive_from,
            "accept": self.accept,
            "rate": duration(self.interval),
            "startAt": None if self.start_at is None else date_time(0, self.start_at),
            "endAt": None if self.end_at is None else date_time(0, self.end_at),
            "state": self.state,
        }
        return {name: value for name, value in found.items() if value is not None}


class Activity(NamedTuple):
    """Content of a notification (protocol 3.4): `type` is an activity type, `state` the new state of the topic."""

    type: str
    object: str
    target: str | None = None
    state: str | None = None

    def document(self, id: str, published: int) -> Document:
        """Return the notification as RDF, with an id and its time in nanoseconds after 1970."""
        triples = triples_about(
            NamedNode(id),
            (rdf.type, NamedNode(activity.iri + self.type)),
            (activity.object, NamedNode(self.object)),
            (activity.target, None if self.target is None else NamedNode(self.target)),
            (notify.state, text(self.state)),
            (activity.published, date_time_literal(published)),
        )
        return Document(id, tuple(triples))

    def members(self, id: str, published: int) -> Json:
        """Return the same statements as members of a JSON-LD object."""
        found = {
            "id": id,
            "type": self.type,
            "object": self.object,
            "target": self.target,
            "state": self.state,
            "published": date_time(0, published),
        }
        return {name: value for name, value in found.items() if value is not None}


def duration(seconds: float) -> str:
    """Return the xsd:duration of seconds, to the microsecond."""
    return f"PT{seconds:.6f}".rstrip("0").rstrip(".") + "S"


def with_context(members: Json, *contexts: str) -> dict[str, object]:
    """Return a JSON-LD object with its contexts.

    By default these are the definitions themselves, which any JSON-LD processor can use without fetching anything.
    """
    return {"@context": list(contexts) or DEFINITIONS, **members}
