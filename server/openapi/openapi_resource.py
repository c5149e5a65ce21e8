"""`/openapi.json`: the OpenAPI 3.1 description of all current resources."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable, Iterable, Mapping
from functools import lru_cache, partial

from msgspec import Struct
from starlette.responses import Response

from rosld import __version__
from rosld.adapters.model import Graph, RosError, TypeRef
from rosld.server.auth import enforcement
from rosld.server.auth.authenticator import UNRESTRICTED
from rosld.server.auth.permissions import Permissions
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.fields import Link, render_links
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import OBJECT, JsonSchema, MessageSchemas
from rosld.server.openapi.description import add_security, description, description_parts, permitted_paths
from rosld.server.openapi.path_collector import DescribedPath, PathCollector
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.namespaces import LISTING_PARAMETERS, listed_graph
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PART_QUERY, PathItem, parse_part
from rosld.server.rest.resource import LDP, RESOURCE
from rosld.server.rest.responses import bytes_response, resource_headers
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.session import used_types
from rosld.server.runtime.version_cache import IdentityKey, VersionCache

_ABOUT = (
    "A robot as Linked Data. Start at `/` and follow links. `Allow` lists the methods that a resource supports now, "
    "and problems name the next step (RFC 9457). Every URL that supports GET supports HEAD and conditional requests "
    "(RFC 9110 13), and every URL supports OPTIONS. `Accept` selects an RDF syntax. `application/json` is plain "
    "JSON for ROS values: integers beyond 53 bits are strings of digits, and an object replaces a value that is too "
    "large or is not UTF-8."
)


MEDIA_TYPES = ("application/json", "application/openapi+json", "application/vnd.oai.openapi+json")
"""Media types of the description; the registered ones follow the one that every tool knows."""
_PATIENCE = 3.0
"""Seconds to wait for missing types; those that arrive later appear in the next description."""
_MANY = 500
"""Number of paths from which a worker process writes the description, as writing holds the interpreter's lock."""
_HIDDEN = "?hidden=true"
"""Query of the description that includes hidden names."""
_LARGE = 1_000_000
"""Bytes from which a worker process splits the description into parts."""
_AT_ONCE = 25
"""Number of paths collected before the event loop gets a turn, which takes some milliseconds."""
_digest = lru_cache(maxsize=4)(digest)
_MAX_VARIANTS = 8
"""Maximum number of cached descriptions, one per set of permissions."""


class Described(Struct, frozen=True, eq=False):
    """A description, its paths and schemas, and its version."""

    version: Hashable
    data: bytes
    paths: tuple[DescribedPath, ...]
    schemas: Mapping[str, JsonSchema]


class OpenApiResource(SessionResource):
    """The description, created once for each state of the graph, the known types and the mappings in force."""

    kind = "Description"
    links = (RESOURCE, Link(f"{LDP}NonRDFSource", "type"))
    only: Mapping[str, str] | None = None
    """The described paths, each with the path of an example; None for all."""

    path = "openapi.json"

    def __init__(self, services: Services) -> None:
        super().__init__(services)
        self.workers = services.documents.workers
        self._kept: dict[bool, Described] = {}
        self._of_agents = VersionCache[bytes](_MAX_VARIANTS)
        self._part_sets = VersionCache[tuple[bytes, ...]](_MAX_VARIANTS)
        self._making = asyncio.Lock()

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        query = (*PART_QUERY, *LISTING_PARAMETERS[1:])
        return PathItem("This description", MEDIA_TYPES, OBJECT, query, streams=False)

    async def custom_get(self, exchange: Exchange) -> Response | None:
        media_type = choose_offer(exchange.accept, MEDIA_TYPES)
        if media_type is None:
            raise Problem(406, f"None of {exchange.accept!r} is available; choose from {', '.join(MEDIA_TYPES)}.")
        part = parse_part(exchange.query, self.space.base)
        hidden = exchange.query_flag("hidden") and self.session.adapter.capabilities.hidden_names
        kept = await self.describe(hidden=hidden)
        data = kept.data
        if exchange.auth is not UNRESTRICTED:
            data = await self._for_agent(kept, hidden, exchange.permissions, exchange.auth.public)
        headers = resource_headers(self)
        if part is not None:
            url = f"{self.url}{_HIDDEN}" if hidden else self.url
            parts = await self._parts(data, url, part.below)
            data = part.choose(parts)
            headers["link"] = render_links((*self.links, *part.links(url, len(parts))))
        etag = ETag(f"{self.services.instance_id}-{_digest(data)}", media_type.partition("/")[2].replace(".", "-"))
        return bytes_response(exchange, data, media_type, etag, headers.items())

    async def _parts(self, data: bytes, url: str, below: str) -> tuple[bytes, ...]:
        """Return the parts of a description, cached because clients usually request several of them."""
        key, version = (url, below), _digest(data)
        found = self._part_sets.find(key, version)
        if found is None:
            work = partial(description_parts, data, url, below)
            found = await (self.workers.run(work) if len(data) > _LARGE else asyncio.to_thread(work))
        return self._part_sets.put(key, version, found)

    async def _for_agent(self, kept: Described, hidden: bool, permissions: Permissions, public: Permissions) -> bytes:
        """Return the description for an agent, cached until it changes."""
        key, version = (hidden, permissions.rights_key, public.rights_key), IdentityKey(kept)
        found = self._of_agents.find(key, version)
        if found is None:
            found = await asyncio.to_thread(self._made_for, kept, hidden, permissions, public)
        return self._of_agents.put(key, version, found)

    def _made_for(self, kept: Described, hidden: bool, permissions: Permissions, public: Permissions) -> bytes:
        """Return the description for an agent, rewritten so that not even numbers in names reveal hidden resources."""
        data = kept.data
        if not permissions.is_unrestricted:
            data = self._write(
                permitted_paths(kept.paths, partial(self.may, permissions), permissions.may_read),
                kept.schemas,
                hidden,
            )
        return add_security(data, partial(self.may, public), whole=permissions.is_unrestricted)

    def may(self, permissions: Permissions, method: str, path: str) -> bool:
        """Whether a method may be used at a path below the base, or at some path that matches a template."""
        url = self.space.base.rstrip("/") + path
        place = permissions.locate(url)
        if permissions.is_unrestricted or "{" in path or place is None:
            return permissions.may_template(method, url)
        try:
            return method in enforcement.allowed_methods(permissions, place, self.services.find(path))
        except Problem:
            return False

    async def describe(self, *, hidden: bool) -> Described:
        """Return the current description, with or without hidden names."""
        kept = self._kept.get(hidden)
        if kept is not None and kept.version == self._version(self.session.graph):
            return kept
        async with self._making:
            kept = self._kept.get(hidden)
            if kept is None or kept.version != self._version(self.session.graph):
                kept = self._kept[hidden] = await self._made(hidden)
            return kept

    def _version(self, graph: Graph) -> Hashable:
        return (
            IdentityKey(graph),
            self.session.schemas.count,
            IdentityKey(self.services.mappings.mapping_set),
            self.services.queries.version,
        )

    async def _made(self, hidden: bool) -> Described:
        """Return a new description: collected on the event loop and written on a thread, as a large one takes long."""
        await _learn_types(self.session.schemas, self.session.graph)
        tree = await self.services.affordances.tree()
        # Read the graph only now: it may have changed during the wait for types, and the tree is of a later one.
        graph, capabilities = self.session.graph, self.session.adapter.capabilities
        version = self._version(graph)
        hides = capabilities.hidden_names and not hidden
        schemas = MessageSchemas(self.session.schemas.find_similar, self.session.lifting)
        collector = PathCollector(
            self.services,
            listed_graph(graph, capabilities) if hides else graph,
            tree,
            schemas,
            hidden=not hides,
        )
        paths = await _in_turns(collector.all() if self.only is None else collector.some(self.only))
        if len(paths) > _MANY:
            data = await self.workers.run(self._writing(paths, schemas.by_key, hidden))
        else:
            data = await asyncio.to_thread(self._write, paths, schemas.by_key, hidden)
        return Described(version, data, paths, schemas.by_key)

    def _writing(
        self, paths: Iterable[DescribedPath], schemas: Mapping[str, JsonSchema], hidden: bool
    ) -> Callable[[], bytes]:
        title, base, query = f"rosld: {self.session.name}", self.space.base, _HIDDEN if hidden else ""
        return partial(description, title, base, __version__, _ABOUT, paths, schemas, query=query)

    def _write(self, paths: Iterable[DescribedPath], schemas: Mapping[str, JsonSchema], hidden: bool) -> bytes:
        return self._writing(paths, schemas, hidden)()


async def _in_turns(paths: Iterable[DescribedPath]) -> tuple[DescribedPath, ...]:
    """Return all paths, yielding to the event loop after every few of them."""
    found: list[DescribedPath] = []
    for place in paths:
        found.append(place)
        if len(found) % _AT_ONCE == 0:
            await asyncio.sleep(0)
    return tuple(found)


async def _learn_types(schemas: Schemas, graph: Graph) -> None:
    """Fetch the types in use, as far as the robot sends them in time."""
    unknown = [ref for ref in used_types(graph) if schemas.find_similar(ref) is None]
    if not unknown:
        return

    async def find(ref: TypeRef) -> None:
        try:
            await schemas.get(ref)
        except (RosError, asyncio.TimeoutError):
            pass

    tasks = [asyncio.ensure_future(find(ref)) for ref in unknown]
    _, late = await asyncio.wait(tasks, timeout=_PATIENCE)
    for task in late:
        task.cancel()
