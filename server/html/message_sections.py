"""The messages a document carries, each a section of its page: the newest first, then one a publisher."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pyoxigraph import NamedNode

from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.vocab import ros
from rosld.server.html.labels import capitalize, label
from rosld.server.html.messages import message_view
from rosld.server.html.picture_view import PictureView, picture_view
from rosld.server.html.plot import plot_prefix
from rosld.server.html.site import Anchor, Site
from rosld.server.html.space_view import topic_view
from rosld.server.html.terms import iri_view
from rosld.server.html.timestamps import time_view
from rosld.server.html.view import TableView, View, escape_controls
from rosld.server.space.point_cloud import POINT_CLOUD

_TITLES = {ros.latest: "Latest message", ros.recordedMessage: "Message", ros.heldMessage: "Message"}
_DRAWN = frozenset({ros.latest, ros.recordedMessage})
"""By what a message is linked from a resource that can be had as a picture."""
NEWEST = "#message"


@dataclass(frozen=True, slots=True)
class MessageSection:
    """A message on a page: its fragment, what came with it, and its fields."""

    id: str
    title: str
    type: Anchor | None
    body: TableView
    received: View | None = None
    sequence: int | None = None
    publisher: View | None = None
    aside: bool = False
    picture: PictureView | None = None
    space: str = ""
    """The address of its view in space, empty where it has none."""
    is_cloud: bool = False
    """Whether it is a point cloud."""


def message_sections(document: Document, site: Site, query: str = "") -> tuple[MessageSection, ...]:
    """The sections of a document's messages; those of single publishers stand aside when there are several.

    `query` is what the URL of the page ends in.
    """
    roles = _roles(document)
    return tuple(
        _section(document, site, each, roles.get(each.node, ros.recordedMessage), query) for each in document.messages
    )


def _roles(document: Document) -> Mapping[str, NamedNode]:
    """By which predicate each message is linked from its document."""
    prefix = f"{document.url}#"
    return {
        triple.object.value[len(prefix) - 1 :]: triple.predicate
        for triple in document.triples
        if isinstance(triple.object, NamedNode) and triple.object.value.startswith(prefix)
    }


def _section(document: Document, site: Site, each: LiftedMessage, role: NamedNode, query: str) -> MessageSection:
    schema = each.lifter.schema
    picture = picture_view(schema, each.message, query, moves=role == ros.latest) if role in _DRAWN else None
    body = message_view(
        schema,
        each.message,
        simulated_time=document.simulated_time,
        octets="?field=" if each.node == NEWEST else None,
        has_heads=picture is None or bool(picture.refused),
        plots=plot_prefix(document.url, site) if each.node == NEWEST else None,
    )
    envelope = each.envelope
    publisher = envelope.publisher if envelope else None
    return MessageSection(
        id=escape_controls(each.node.removeprefix("#")),
        title=_title(role, publisher, site),
        type=site.anchor(f"{site.types}{schema.ref.name}"),
        body=body,
        received=time_view(envelope.received_ns) if envelope else None,
        sequence=envelope.sequence if envelope else None,
        publisher=iri_view(publisher, site) if publisher else None,
        aside=role == ros.latestFrom,
        picture=picture,
        space=topic_view(schema.ref.name, document.url, site) if role == ros.latest and not query else "",
        is_cloud=schema.ref.name == POINT_CLOUD,
    )


def _title(role: NamedNode, publisher: str | None, site: Site) -> str:
    if role == ros.latestFrom and publisher:
        return f"Latest from {escape_controls(site.short_name(publisher))}"
    return _TITLES.get(role) or capitalize(label(role.value))
