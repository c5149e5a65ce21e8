"""Types, their shapes, and the ontology: `/types/PKG/msg/NAME` and `/shapes/PKG/msg/NAME`, within containers.

`/shapes/` also contains `/shapes/mapping` and other fixed shapes graphs, and the limits stored by clients.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from functools import partial

from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import MessageSchema, Schema, TypeRef, halves_of
from rosld.ontology.describe_graph import type_container_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.document import Document
from rosld.ontology.modules import CORE, MODULES, module_url, served_triples
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import ldp
from rosld.server.http.conditional import digest
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.policies import active_limits
from rosld.server.resources.accepted_shape import datatypes_of_limits, load_limited_types
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.ldp.base import Documents
from rosld.server.resources.ldp.bodies import require_small
from rosld.server.resources.ldp.containers import ContainerResource
from rosld.server.resources.ldp.representation import all_members
from rosld.server.resources.ldp.routes import stored_route
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FORMAT, PAGE, PathItem, QueryParameter
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource, permanent_redirect
from rosld.server.rest.state import State
from rosld.server.robot.audited_adapter import AuditedAdapter
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.session import used_types
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.storage.record import Put, Record
from rosld.server.storage.record_documents import record_document
from rosld.shapes.message import SHACL_SHACL, shape_document
from rosld.shapes.validation import shapes_file

LIMITS = "limits"
_HASH = QueryParameter("hash", "The hash of the definition, if a name has several.")
_SUMMARIES = {
    "cockpit": "The shape of cockpits",
    "data": "The shapes of data",
    "documents": "The shapes of documents",
    "limits": "The limits in force",
    "mapping": "The shape of mapping documents",
    "query": "The shape of stored queries",
    "recording": "The shape of orders of recordings",
}
SHAPES_GRAPHS = tuple(_SUMMARIES)
"""The shapes graphs below `/shapes/` that are not about one type, nor stored by clients."""


class TypeResource(SessionResource):
    """One message, service or action type; `?hash=` selects one of several definitions."""

    kind = "Type"
    is_found_by_state = True
    shape = "Type"
    item = PathItem("One of the types", query=(FORMAT, _HASH))

    def __init__(self, services: Services, name: str) -> None:
        super().__init__(services, services.space.type(name))
        self.ref = TypeRef(name)

    async def select_variant(self, exchange: Exchange) -> Resource:
        hash = exchange.query.get("hash")
        ref = TypeRef(self.ref.name, hash)
        return self if hash is None else self.variant(url=self.space.type(ref), ref=ref)

    async def state(self) -> State:
        schema = await schema_of(self.session.schemas, self.ref)
        variants = tuple(ref for ref in known_types(self.session.adapter) if ref.name == self.ref.name)
        return self.states.get_or_make(
            self.url,
            (IdentityKey(schema), variants),
            lambda: State(lambda: type_document(schema, self.space, variants)),
        )


class ShapeResource(SessionResource):
    """The SHACL shape of one type."""

    kind = "Shape"
    shape = SHACL_SHACL
    is_found_by_state = True
    item = PathItem("One of the shapes")

    def __init__(self, services: Services, name: str) -> None:
        super().__init__(services, services.space.shape(name))
        self.name = name

    async def state(self) -> State:
        schema = await schema_of(self.session.schemas, TypeRef(self.name))
        return self.states.get_or_make(
            self.url, IdentityKey(schema), lambda: State(lambda: shape_document(schema, self.space))
        )


class ShapesGraphResource(SessionResource):
    """`/shapes/data`, `/shapes/documents`, `/shapes/limits`, ...: a fixed shapes graph."""

    kind = "Shape"
    shape = SHACL_SHACL
    is_found_by_state = True

    def __init__(self, services: Services, name: str) -> None:
        super().__init__(services, services.space.shape(name))
        self.title = name
        self.item = PathItem(_SUMMARIES[self.title])

    def deny_reason(self, method: str) -> str:
        return _deny_reason(self.services, self.url, method)

    async def state(self) -> State:
        if self.title == LIMITS:
            await load_limited_types(self.services.limit_checks)
        key, describe = shapes_graph(self.services.limit_checks, self.title)
        return self.states.get_or_make(self.url, key, lambda: State(describe))


def shapes_graph(limit_checks: LimitChecks, name: str) -> tuple[object, Callable[[], Document]]:
    """Return the version of one of SHAPES_GRAPHS, and a function that describes it."""
    url = limit_checks.session.space.shape(name)
    if name != LIMITS:
        return name, partial(shapes_file, name, url)
    datatypes, graph = datatypes_of_limits(limit_checks), limit_checks.limits.graph
    return (IdentityKey(limit_checks.limits), datatypes), lambda: Document(url, (*graph, *datatypes))


class TypeContainer(SessionResource):
    """`/types/` and `/shapes/`, their packages and kinds."""

    kind = "Types"
    shape = "Container"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, services: Services, route: str, namespace: tuple[str, ...]) -> None:
        super().__init__(services, services.space.container(route, namespace))
        self.route = route
        self.namespace = namespace
        of = ("", " of a package", " of a kind")[min(len(namespace), 2)]
        self.item = PathItem(f"{route.capitalize()}{of}")

    def _nested(self) -> tuple[str, ...]:
        """Return the names of types that only occur within others, whose pages link to their containers."""
        known = (schema for schema in self.session.schemas.all() if isinstance(schema, MessageSchema))
        return child_names(sorted({name for schema in known for name in schema.types}), self.route, self.namespace)

    async def state(self) -> State:
        listed = sorted({ref.name for ref in known_types(self.session.adapter)})
        below = child_names(listed, self.route, self.namespace) or self._nested()
        if self.namespace and not below:
            raise Problem(404, f"No type of {'/'.join(self.namespace)} is known.")
        return self.states.get_or_make(
            self.url,
            below,
            lambda: State(lambda: type_container_document(self.route, self.namespace, below, self.space)),
        )


async def schema_of(schemas: Schemas, ref: TypeRef) -> Schema:
    """Return the schema of a type or of one of the messages of a service or an action; raises UnknownType."""
    base, _, end = ref.name.rpartition("_")
    if any(part in ref.name and end in ends for part, ends in _HALVES.items()):
        whole = await schemas.get(TypeRef(base, ref.hash))
        for half in halves_of(whole):
            if half.ref.name == ref.name:
                return half
    return await schemas.get(ref)


_HALVES = {"/srv/": ("Request", "Response"), "/action/": ("Goal", "Result", "Feedback")}


def known_types(adapter: AuditedAdapter) -> Sequence[TypeRef]:
    """Return the types that are or were in use, each name and hash once."""
    return list(dict.fromkeys([*adapter.known_types(), *used_types(adapter.graph)]))


def child_names(listed: Sequence[str], route: str, namespace: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names that a container of types or shapes shows, of those `listed` by the robot."""
    depth = len(namespace)
    below = tuple(name for name in listed if tuple(name.split("/"))[:depth] == namespace)
    return (*below, *SHAPES_GRAPHS) if route == "shapes" and not namespace else below


def type_route(services: Services, location: Location) -> Resource:
    """Return the resource at `/types/` or below."""
    if location.is_container or len(location.segments) < 3:
        return _container(services, "types", location)
    return TypeResource(services, "/".join(location.segments))


def shape_route(services: Services, location: Location) -> Resource:
    """Return the resource at `/shapes/` or below: shapes of types, and stored limits."""
    if location.is_container and not location.segments:
        return LimitsContainer(services)
    if len(location.segments) == 1 and not location.is_container:
        name = location.segments[0]
        if name in SHAPES_GRAPHS:
            return ShapesGraphResource(services, name)
        if name in _packages(services.session.adapter):
            return PackageRedirect(services, services.space.shape(name))
        return stored_route(services.documents, location)
    if location.is_container or len(location.segments) < 3:
        return _container(services, "shapes", location)
    return ShapeResource(services, "/".join(location.segments))


class PackageRedirect(SessionResource):
    """`/shapes/PKG`: redirect to the shapes of a package, at the URL with a final slash."""

    kind = "Shape"
    is_cacheable = False

    def deny_reason(self, method: str) -> str:
        return _deny_reason(self.services, self.url, method)

    async def select_variant(self, exchange: Exchange) -> Resource:
        if exchange.method in ("GET", "HEAD"):
            raise permanent_redirect(f"{self.url}/")
        return self


class LimitsContainer(ContainerResource):
    """`/shapes/`: the packages with the shapes of their types, and the limits stored by clients."""

    item = PathItem("Shapes", query=(FORMAT, PAGE))

    def __init__(self, services: Services) -> None:
        super().__init__(services.documents, active_limits.ROUTE)
        self.adapter = services.session.adapter

    def is_taken(self, name: str) -> bool:
        return name in SHAPES_GRAPHS or name in _packages(self.adapter) or super().is_taken(name)

    async def state(self) -> State:
        own_state = await super().state()
        listed = _generate(self.space, self.adapter)
        is_here = self._parts.containment and (self._place is None or self._place.after == 0)
        minimal = self._parts.minimal
        more = tuple(one for one in listed.triples if _is_of(one, self.url, containment=is_here, minimal=minimal))

        def describe() -> Document:
            return Document(own_state.document.url, tuple(dict.fromkeys((*own_state.document.triples, *more))))

        return self.documents.states.get_or_make(
            f"{self.url}?{self._place}#{self._parts.variant} with what is generated",
            (IdentityKey(own_state), more),
            lambda: replace(
                own_state, describe=describe, token=f"{own_state.tag}-{digest(repr(more).encode())}", renderings={}
            ),
        )

    async def with_triples(
        self, record: Record, triples: Sequence[Triple], expected: int | None, known: Set[Triple] = frozenset()
    ) -> Put:
        require_small(triples)
        own = set(_generate(self.space, self.adapter).triples)
        return await super().with_triples(record, [one for one in triples if one not in own], expected, known)


def _is_of(triple: Triple, container: str, *, containment: bool, minimal: bool) -> bool:
    """Whether a triple is about a part of the container."""
    is_own = triple.subject == NamedNode(container) and triple.predicate != ldp.contains
    return minimal if is_own else containment


def _generate(space: Space, adapter: AuditedAdapter) -> Document:
    """Return the generated part of `/shapes/`."""
    listed = sorted({ref.name for ref in known_types(adapter)})
    return type_container_document("shapes", (), child_names(listed, "shapes", ()), space)


def shapes_document(adapter: AuditedAdapter, documents: Documents) -> Document:
    """Return the current document of `/shapes/` with all members."""
    space, record = documents.space, documents.records.get(active_limits.ROUTE)
    assert record is not None
    members = [space.base + member.path for member in all_members(documents.records, record)]
    document = record_document(record, space.container("shapes"), members, ())
    return Document(document.url, tuple(dict.fromkeys((*document.triples, *_generate(space, adapter).triples))))


def _packages(adapter: AuditedAdapter) -> set[str]:
    return {ref.name.partition("/")[0] for ref in known_types(adapter)}


def _deny_reason(services: Services, url: str, method: str) -> str:
    if services.settings.read_only:
        return READ_ONLY
    route = services.space.container("shapes")
    return f"{url} is built in and does not support {method}: store limits at {route}NAME, under another name."


def _container(services: Services, route: str, location: Location) -> Resource:
    if not location.is_container:
        raise permanent_redirect(services.space.container(route, location.segments))
    return TypeContainer(services, route, location.segments)


class OntologyResource(SessionResource):
    """A module of the ontology."""

    kind = "Ontology"
    shape = "Ontology"

    def __init__(self, services: Services, name: str = CORE) -> None:
        super().__init__(services, module_url(name, services.space.base))
        self.title = "Ontology" if name == CORE else f"Ontology: {name}"
        self.name = name
        self.item = PathItem(
            "The core of the ontology" if self.name == CORE else f"A module of the ontology: {self.name}"
        )

    async def state(self) -> State:
        return self.states.get_or_make(self.url, 0, lambda: State(self.document))

    def document(self) -> Document:
        """Return the module without triples about its local URL, so that it is the same on every server."""
        return Document(self.url, served_triples(self.name))


def ontology_route(services: Services, location: Location) -> Resource:
    """Return the module of the vocabulary at `/ontology` or below. Raises a 404 Problem if there is none."""
    if location.is_container:
        raise permanent_redirect(services.space.url("ontology", location.segments))
    name = "/".join(location.segments)
    if name == CORE:
        raise permanent_redirect(module_url(CORE, services.space.base))
    if not name or name in MODULES:
        return OntologyResource(services, name or CORE)
    raise Problem(404, f"The ontology has no {name}: its modules are {', '.join(MODULES)}.")
