"""The catalog of a robot: its computation graph and its resources as search entries. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from msgspec.structs import replace

from rosld.adapters.model import (
    Array,
    Descriptor,
    FieldType,
    Graph,
    MessageSchema,
    Nested,
    Primitive,
    Schema,
    TypeRef,
    halves_of,
)
from rosld.ontology.urls import Space
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.conventions import CONVENTIONS, every_node_has
from rosld.server.hypermedia.mapping import ComplexResource
from rosld.server.hypermedia.resource_tree import ResourceTree
from rosld.server.robot.write_policy import denied_reason, is_reserved, parameter_denied_reason
from rosld.server.search.index import Catalog, Entry, EntryKind

_MAX_FIELDS = 400
"""Maximum number of indexed fields of a type."""
_MAX_DEPTH = 8
STOP_TEXT = "Stop the whole robot: emergency stop, halt"


def catalog_of(
    graph: Graph,
    find_schema: Callable[[TypeRef], Schema | None],
    tree: ResourceTree,
    space: Space,
    *,
    writes: bool = True,
    allow_publish: tuple[str, ...] = (),
) -> Catalog:
    """Return the catalog of a graph and its resources, with the fields of cached types.

    `writes` is whether the robot may be commanded at all, `allow_publish` the globs of --allow-publish.
    """
    found: Iterable[Entry] = (
        *_graph_entries(graph, tree, space, allow_publish),
        *_resource_entries(graph, tree, space),
    )
    if not writes:
        found = [replace(entry, is_writable=False) for entry in found]
    refs = {ref for topic in graph.topics.values() for ref in topic.types}
    refs |= {service.type for service in graph.services.values() if service.type is not None}
    refs |= {action.type for action in graph.actions.values() if action.type is not None}
    schemas = {ref.name: schema for ref in refs if (schema := find_schema(ref)) is not None}
    return Catalog(tuple(found), {name: field_paths(schema) for name, schema in schemas.items()})


def field_paths(schema: Schema) -> tuple[str, ...]:
    """Return the field paths of a type (`pose.position.x`, `status[].level`); of a service those of both messages."""
    found: list[str] = []
    for half in halves_of(schema):
        for path in _paths(half, Nested(half.ref.name), "", 0):
            found.append(path)
            if len(found) == _MAX_FIELDS:
                return tuple(found)
    return tuple(dict.fromkeys(found))


def _paths(schema: MessageSchema, kind: FieldType, prefix: str, depth: int) -> Iterator[str]:
    """Yield the fields of a type before those of its fields, so that the shortest path of a name comes first."""
    if isinstance(kind, Array):
        kind, prefix = kind.element, f"{prefix}[]"
    if isinstance(kind, Primitive) or depth > _MAX_DEPTH:
        return
    start = f"{prefix}." if prefix else ""
    fields = schema.types[kind.name].fields
    yield from (start + field.name for field in fields)
    for field in fields:
        yield from _paths(schema, field.type, start + field.name, depth + 1)


def _graph_entries(graph: Graph, tree: ResourceTree, space: Space, allow_publish: tuple[str, ...]) -> Iterator[Entry]:
    """Yield the entries of names in the graph, each with a resource of the same name."""
    properties, actions = set(tree.properties), set(tree.actions)

    def resource(name: str, among: set[str]) -> str | None:
        return url_of(name, space) if name in among else None

    for name, topic in graph.topics.items():
        types = tuple(ref.name for ref in topic.types)
        own = resource(name, properties)
        texts = _property_texts(tree, name, own)
        can, of_ros = denied_reason(topic, graph, allow_publish) is None, is_reserved(name, graph)
        yield Entry(EntryKind.TOPIC, name, space.topic(name), types, texts, own, can, of_ros)
    for name, service in graph.services.items():
        types = () if service.type is None else (service.type.name,)
        own, can, of_ros = resource(name, actions), service.uncallable is None, CONVENTIONS.excludes(name)
        yield Entry(EntryKind.SERVICE, name, space.service(name), types, (), own, can, of_ros)
    for name, action in graph.actions.items():
        types = () if action.type is None else (action.type.name,)
        yield Entry(EntryKind.ACTION, name, space.action(name), types, (), resource(name, actions), bool(types))
    for name, parameter in graph.parameters.items():
        own = resource(name, properties) if name not in graph.topics else None
        texts = (*_property_texts(tree, name, own), *_declared_texts(parameter.descriptor))
        can, of_ros = parameter_denied_reason(graph, name) is None, every_node_has(parameter)
        yield Entry(EntryKind.PARAMETER, name, space.parameter(name), (), texts, own, can, of_ros)
    for name in graph.nodes:
        yield Entry(EntryKind.NODE, name, space.node(name), is_internal=True)


def _resource_entries(graph: Graph, tree: ResourceTree, space: Space) -> Iterator[Entry]:
    """Yield the resources without a name in the graph: properties of getters and setters, mapped ones, and paths."""
    yield Entry(EntryKind.RESOURCE, "/stop", space.stop, (), (STOP_TEXT,), None, True)
    for name in tree.properties:
        if name not in graph.topics and name not in graph.parameters:
            url = url_of(name, space)
            can = bool(tree.catalogue.properties[name].writers) if name in tree.catalogue.properties else False
            yield Entry(EntryKind.RESOURCE, name, url, (), _property_texts(tree, name, url), None, can)
    for name in tree.actions:
        if name not in graph.services and name not in graph.actions:
            yield Entry(EntryKind.RESOURCE, name, url_of(name, space), is_writable=True)
    for path in tree.paths:
        if path != "/":
            mapped = tree.mapping_set.resources.get(path)
            yield Entry(EntryKind.RESOURCE, path, url_of(path, space), (), _complex_texts(mapped))


def _complex_texts(mapped: ComplexResource | None) -> tuple[str, ...]:
    return () if mapped is None or mapped.title is None else (mapped.title,)


def _property_texts(tree: ResourceTree, name: str, url: str | None) -> tuple[str, ...]:
    """Return the texts of a mapping about a property: its relation, unit, and kind of quantity."""
    plan = None if url is None else tree.property(name)
    mapped = None if plan is None else plan.mapped
    if mapped is None:
        return ()
    terms = (mapped.predicate.value, *mapped.quantity)
    return (mapped.name, *(local_name(term) for term in terms if term is not None))


def _declared_texts(descriptor: Descriptor | None) -> Sequence[str]:
    return () if descriptor is None else tuple(filter(None, (descriptor.description, descriptor.constraints)))


def local_name(iri: str) -> str:
    """Return the local name of an IRI: `M-PER-SEC` for QUDT's metres per second."""
    return iri.rstrip("/#").rpartition("#")[2].rpartition("/")[2]
