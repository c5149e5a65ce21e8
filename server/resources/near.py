"""URLs similar to one at which there is nothing, for its 404."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rosld.adapters.base import Capabilities
from rosld.adapters.model import Graph
from rosld.ontology.names import IdentityCache, namespaces_of
from rosld.ontology.urls import Location, Space
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.resource_tree import ResourceTree, path_of, segments_of
from rosld.server.resources.namespaces import listed_graph, namespaces, things_of
from rosld.server.rest.state import State
from rosld.server.robot.audited_adapter import AuditedAdapter
from rosld.server.search.near_names import NearNames

_IN_GRAPH = frozenset({"nodes", "topics", "services", "actions", "parameters"})


def _near_in_route(things: Mapping[str, object]) -> NearNames:
    return NearNames((*things, *(path_of(namespace) for namespace in namespaces_of(things) if namespace)))


def _near_in_tree(tree: ResourceTree) -> NearNames:
    return NearNames({*tree.properties, *tree.actions, *tree.paths} - {"/"})


_route_names: IdentityCache[Mapping[str, object], NearNames] = IdentityCache(_near_in_route)
_tree_names: IdentityCache[ResourceTree, NearNames] = IdentityCache(_near_in_tree, 2)


def near_urls(space: Space, adapter: AuditedAdapter, affordances: AffordanceService[State], url: str) -> Sequence[str]:
    """The URLs of what the robot has under names near that of `url`, the nearest first.

    None where `url` is in no container of names, and where its name is there: then it is absent for another reason.
    """
    place = space.location(url)
    if place is None or not place.segments:
        return ()
    if place.kind == "resources":
        return _near_resources(space, affordances, place)
    return _near_names(space, adapter.graph, adapter.capabilities, place) if place.kind in _IN_GRAPH else ()


def _near_names(space: Space, graph: Graph, capabilities: Capabilities, place: Location) -> Sequence[str]:
    things, name = things_of(listed_graph(graph, capabilities), place.kind), _name(place)
    if name in things or place.segments in namespaces(graph, place.kind):
        return ()
    return [
        space.container(place.kind, segments_of(each))
        if each.endswith("/")
        else space.url(place.kind, tuple(each[1:].split("/")))
        for each in _route_names(things).of(name)
    ]


def _near_resources(space: Space, affordances: AffordanceService[State], place: Location) -> Sequence[str]:
    tree, name = affordances.cached_tree(), _name(place)
    if tree is None or tree.property(name) is not None or tree.action(name) is not None or f"{name}/" in tree.paths:
        return ()
    return [url_of(each, space) for each in _tree_names(tree).of(name)]


def _name(place: Location) -> str:
    return "/" + "/".join(place.segments)
