"""Brief members of namespaces: RDF for listings, and cells of tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from pyoxigraph import NamedNode

from rosld.adapters.model import Action, Node, Service, Topic, names
from rosld.ontology.describe_search import MemberOutline
from rosld.ontology.names import Members
from rosld.ontology.urls import Space
from rosld.ontology.vocab import ros
from rosld.server.html.page import Cell, Thumbnail
from rosld.server.html.values import brief_text
from rosld.server.hypermedia.brief_value import LatestValue
from rosld.server.pictures.form import OCCUPANCY_GRID

_THUMBNAIL_WIDTH = 192
"""Pixels: it is drawn half as wide, for screens that have two of them where others have one."""


def member_outlines(
    space: Space,
    latest_of: Callable[[str], LatestValue | None],
    things: Mapping[str, object],
    route: str,
    namespace: tuple[str, ...],
    members: Members,
) -> tuple[MemberOutline, ...]:
    """Return in brief these members of a namespace, which are among `things`: names, types, latest values of topics."""
    leaves = ((*namespace, leaf) for leaf in members.leaves)
    below = ((*namespace, inner) for inner in members.namespaces)
    return (
        *(_outline(latest_of, things, names.join(path), space.url(route, path)) for path in leaves),
        *(MemberOutline(space.container(route, path), None, names.join(path)) for path in below),
    )


def _outline(
    latest_of: Callable[[str], LatestValue | None], things: Mapping[str, object], name: str, url: str
) -> MemberOutline:
    match things.get(name):
        case Topic() as thing:
            latest = latest_of(name)
            rate, value = (None, None) if latest is None else (latest.rate, latest.json)
            return MemberOutline(url, ros.Topic, name, tuple(thing.types), rate, value)
        case Service() as thing:
            return MemberOutline(url, ros.Service, name, () if thing.type is None else (thing.type.name,))
        case Action() as thing:
            return MemberOutline(url, ros.Action, name, () if thing.type is None else (thing.type.name,))
        case Node():
            return MemberOutline(url, ros.Node, name)
    return MemberOutline(url, None, name)


def topic_cells(topic: Topic, latest: LatestValue | None, space: Space) -> tuple[Cell, ...]:
    """Return the cells of a topic: its type, its latest value and rate as far as they are at hand, its endpoints."""
    kind = NamedNode(space.class_of(topic.type.name)) if topic.type else ", ".join(ref.name for ref in topic.types)
    value = "" if latest is None or latest.json is None else brief_text(latest.json)
    picture = None if latest is None else thumbnail(latest, space.topic(topic.name))
    rate = "" if latest is None or latest.rate is None else f"{latest.rate:.3g} Hz"
    return (kind, picture or value, rate, str(len(topic.publishers)), str(len(topic.subscribers)))


def thumbnail(latest: LatestValue, url: str) -> Thumbnail | None:
    """Return the small picture of the topic at a URL; None where its latest value is no picture that is drawn.

    Its address is another one with each message, so that a page that is kept up to date fetches it again then only.
    """
    if latest.picture is None:
        return None
    format = "png" if latest.picture.type_name == OCCUPANCY_GRID else "jpeg"  # of maps much is transparent
    query = f"format={format}&width={_THUMBNAIL_WIDTH}&v={latest.picture.sequence}"
    return Thumbnail(url, query, "" if latest.json is None else brief_text(latest.json))


def service_cells(service: Service, space: Space) -> tuple[Cell, ...]:
    """Return the cells of a service: its type and who provides it."""
    kind = NamedNode(space.class_of(service.type.name)) if service.type else ""
    return (kind, NamedNode(space.node(service.providers[0])) if service.providers else "")


def action_cells(action: Action, space: Space) -> tuple[Cell, ...]:
    """Return the cells of an action: its type and who serves it."""
    kind = NamedNode(space.class_of(action.type.name)) if action.type else ""
    return (kind, NamedNode(space.node(action.servers[0])) if action.servers else "")
