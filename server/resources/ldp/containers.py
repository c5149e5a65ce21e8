"""Containers (LDP 5), and the creation of resources in them."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from functools import partial

from msgspec.structs import replace
from pyoxigraph import Triple

from rosld.ontology.urls import encode_segment
from rosld.server.html.forms import Form
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import MessageSchemas
from rosld.server.resources.ldp.base import (
    DELETES,
    Documents,
    StoredResource,
    conflict_problem,
    with_warnings,
    write_together,
)
from rosld.server.resources.ldp.bodies import (
    as_statements,
    initial_times,
    managed_triples_in,
    model_of_request,
    read_statements,
    receive_blob,
    require_classes,
)
from rosld.server.resources.ldp.rdf_sources import RdfSourceResource, StoredFile
from rosld.server.resources.ldp.representation import page_at, page_state, state_of
from rosld.server.resources.ldp.statements import (
    N3_PATCH,
    NO_STATEMENTS,
    Statements,
    client_triples,
    contained_members,
    member_uri,
)
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import RDF_BODIES, SPARQL_UPDATE
from rosld.server.rest.interaction import choose_name, model_links, parse_membership
from rosld.server.rest.paging import (
    ALL_PARTS,
    ContainerParts,
    LdpPage,
    PagedContainer,
    PagePosition,
    parse_position,
    require_page,
    select_parts,
)
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import Answer, CreatedAnswer, Resource
from rosld.server.rest.state import State
from rosld.server.runtime.dry_run import expect_status
from rosld.server.storage.record import Blob, Conflict, ConflictCause, Model, Put, Record, container_of
from rosld.server.storage.record_documents import META
from rosld.server.storage.sqlite import Records


async def create_record(
    stored: StoredResource, model: Model, exchange: Exchange, blob: Blob | None, *, unused: bool = False
) -> Record:
    """Create the resource `stored` and its missing ancestor containers.

    `blob` is the body of a non-RDF source. Raises Conflict if another request created the resource meanwhile, or, with
    `unused`, if the path was ever in use.
    """
    documents, path = stored.documents, stored.path
    expect_status(201)
    if model is Model.NON_RDF_SOURCE:
        require_free(documents, path)
        put = Put(path, model, blob=blob, expected=0, unused=unused)
        writes = [*_ways_to(documents.records, path), await _as_member(documents, put, NO_STATEMENTS, stored.url)]
    else:
        stated = await read_statements(documents.workers, exchange, stored.url, stored.url)
        writes = await creation_writes(documents, path, model, stated, unused=unused)
    record = (await write_together(documents, writes))[-1]
    assert record is not None
    return record


async def creation_writes(
    documents: Documents, path: str, model: Model, triples: Sequence[Triple], *, unused: bool = False
) -> list[Put]:
    """Return the writes that create an RDF source or container with these triples; its own write is the last.

    With `unused`, that write requires that its path was never in use.
    Raises 409 Problems for a name in use and for containment triples, 422 for triples about triples.
    """
    require_free(documents, path)
    url = documents.space.base + path
    stated = await as_statements(triples, url)
    managed = managed_triples_in(stated.managed, url, model)
    if managed:
        if contained_members(managed, url):
            raise Problem(409, "A new container is empty: omit ldp:contains, and POST its members to it.")
        require_classes(managed, model)
        work = partial(client_triples, stated, url, model, frozenset[Triple](), initial_times(managed))
        content = await documents.workers.run(work) if stated.is_large else work()
    else:
        content = stated.packed
    put = Put(path, model, content, membership=parse_membership(managed, url, model), expected=0, unused=unused)
    return [*_ways_to(documents.records, path), await _as_member(documents, put, stated, url)]


async def _as_member(documents: Documents, put: Put, stated: Statements, url: str) -> Put:
    """Return the record with its URI in the membership triples of its container (LDP 5.5.1.2)."""
    container = documents.records.get(container_of(put.path))
    if container is None or container.membership is None:
        return put
    work = partial(member_uri, container.membership, stated, url)
    member = await documents.workers.run(work) if stated.is_large else work()
    return replace(put, member=member)


def _ways_to(records: Records, path: str) -> list[Put]:
    """Return the writes that create missing ancestor containers."""
    found: list[Put] = []
    above = container_of(path)
    while above and records.get(above) is None:
        found.insert(0, Put(above, Model.BASIC_CONTAINER, only_if_absent=True))
        above = container_of(above)
    return found


def require_free(documents: Documents, path: str) -> None:
    """Raise a 409 Problem if the name already exists as the other kind (container or not)."""
    other = path[:-1] if path.endswith("/") else path + "/"
    if documents.records.get(other) is not None:
        raise Problem(409, f"{documents.space.base}{other} already exists: choose another name.")


_SUMMARIES = {"data/": "Data stored by clients", "mappings/": "Mapping documents", "cockpit/": "Cockpits"}


class ContainerResource(PagedContainer, RdfSourceResource):
    """A container (LDP 5): POST creates a member; many members are listed in pages."""

    kind = "Container"
    shape = "Container"
    writes = frozenset({"PUT", "PATCH", "POST", "DELETE"})
    in_turn = frozenset({"PUT", "PATCH"})
    takes_forms = False

    _parts: ContainerParts = ALL_PARTS

    def __init__(self, documents: Documents, path: str) -> None:
        RdfSourceResource.__init__(self, documents, path)
        self.accepts = {"POST": self.accepted_media_types, "PUT": RDF_BODIES, "PATCH": (SPARQL_UPDATE, N3_PATCH)}
        record = documents.records.get(path)
        self.links = model_links(record.model if record is not None else Model.BASIC_CONTAINER)

    @property
    def variant_key(self) -> Hashable:
        return self._parts, self._place

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        summary = _SUMMARIES.get(self.path, "A container")
        post = WriteMethod(is_body_required=False)
        return self.item or PathItem(summary, is_paged=True, writes={"POST": post, "DELETE": DELETES})

    def methods(self) -> frozenset[str]:
        is_root = self.path.count("/") == 1
        return super().methods() - ({"DELETE"} if is_root else frozenset())

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the parts that Prefer selects (LDP 7.2) or the page `?page=`; 303 to the first of many."""
        if exchange.method not in ("GET", "HEAD"):
            return self
        parts = select_parts(exchange.prefer) if exchange.header("prefer") is not None else ALL_PARTS
        page = exchange.query.get("page")
        if page is not None:
            return self.variant(_parts=parts, _place=parse_position(page))
        if parts.containment or parts.membership:
            require_page(exchange, self.url, self.require_record().count)
        return self if parts is ALL_PARTS else self.variant(_parts=parts)

    async def state(self) -> State:
        record = self.require_record()
        if self._place is None:
            return state_of(self.documents, record, self._parts)
        return page_state(self.documents, record, self._parts, self._place)

    def ldp_page(self, place: PagePosition) -> LdpPage | None:
        record = self.documents.records.get(self.path)
        return None if record is None else page_at(self.documents, record, place)[0]

    async def forms(self) -> Sequence[Form]:
        return ()  # a posted form is stored like any other file

    def streams_body(self, exchange: Exchange) -> bool:
        return exchange.method == "POST" and self._model(exchange) is Model.NON_RDF_SOURCE

    def _model(self, exchange: Exchange) -> Model:
        return model_of_request(exchange, self.url, container=False)

    def is_taken(self, name: str) -> bool:
        """Whether a member of this unencoded name exists or existed (LDP 5.2.3.11)."""
        records = self.documents.records
        paths = (self.path + encode_segment(name), f"{self.path}{encode_segment(name)}/")
        return any(records.get(path) is not None or records.is_tombstone(path) for path in paths)

    async def post(self, exchange: Exchange) -> Answer:
        """Create a member, named by Slug if that name is free (LDP 5.2.3)."""
        self.require_record()
        model = self._model(exchange)
        permissions = exchange.permissions

        def is_taken(name: str) -> bool:
            """Whether the name is taken or forbidden to the agent, who cannot distinguish the two."""
            return not permissions.may("PUT", self.url + encode_segment(name)) or self.is_taken(name)

        blob = await receive_blob(self.documents, exchange) if model is Model.NON_RDF_SOURCE else None
        while True:
            name = encode_segment(choose_name(exchange.header("slug"), is_taken))
            path = f"{self.path}{name}/" if model.is_container else self.path + name
            try:
                return await create_resource(self.documents, path, model, exchange, blob, unused=True)
            except Conflict as error:
                if error.path != path or error.cause not in _NAMED_MEANWHILE:
                    raise conflict_problem(self.space, error) from error


def resource_of(documents: Documents, path: str, model: Model) -> StoredResource:
    """Return the resource of a model."""
    if model is Model.NON_RDF_SOURCE:
        return StoredFile(documents, path)
    return ContainerResource(documents, path) if model.is_container else RdfSourceResource(documents, path)


_NAMED_MEANWHILE = frozenset({ConflictCause.THERE, ConflictCause.NAME, ConflictCause.GONE})
"""Causes of conflicts over a name, which are resolved by choosing another name."""


async def create_resource(
    documents: Documents, path: str, model: Model, exchange: Exchange, blob: Blob | None, *, unused: bool = False
) -> Answer:
    """Create a resource and return the response (LDP 4.2.3, 5.2.3). Raises Conflict like `create_record`."""
    record = await create_record(resource_of(documents, path, model), model, exchange, blob, unused=unused)
    resource = resource_of(documents, path, model)  # reflects the created record
    if model is Model.NON_RDF_SOURCE:
        return CreatedAnswer(
            resource.url, resource, None, (Link(resource.url + META, "describedby", anchor=resource.url),)
        )
    created = CreatedAnswer(resource.url, resource, state_of(documents, record))
    return await with_warnings(documents, path, exchange, created)
