"""What clients keep: RDF sources, files and containers under `/data/` (LDP 1.0).

Every class here is a resource as its record is now; `kept_room` chooses it anew for each request.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import orjson
from pyoxigraph import NamedNode, Triple
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.ontology.body import RdfBody, parse_body
from rosld.ontology.document import Document
from rosld.ontology.lower import parse_json
from rosld.ontology.urls import Location
from rosld.ontology.vocab import ldp
from rosld.server.html import DeleteForm, Form
from rosld.server.http.conditional import ETag, guard, require_if_match
from rosld.server.http.link import Link, render
from rosld.server.http.link import parse as parse_links
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.files import file_response
from rosld.server.ldp.interaction import (
    declared,
    member_of,
    membership_of,
    membership_triples,
    model_asked,
    model_links,
)
from rosld.server.ldp.parts import ALL, Parts, wanted
from rosld.server.ldp.patch import merge_patch, updated
from rosld.server.ldp.resource import (
    JSON,
    LDP,
    MERGE_PATCH,
    RDF_BODIES,
    READ,
    SPARQL_UPDATE,
    Answer,
    Created,
    Resource,
    moved,
)
from rosld.server.ldp.slug import free_name
from rosld.server.ldp.standing import standing_headers
from rosld.server.ldp.state import State
from rosld.server.records import Blob, Conflict, Member, Membership, Model, Put, Record, Remove, Write
from rosld.server.records.describe import MEMBERSHIP, META, is_managed, record_document, written
from rosld.server.robot import Robot

N3_PATCH = "text/n3"
ANYTHING = "*/*"
PAGE = 1000
"""Members of a container that are told at once; a larger one comes in pages."""


class _Kept(Resource):
    """What all of them have in common. `path` is the URL without the base."""

    lasting = False

    def __init__(self, robot: Robot, path: str) -> None:
        super().__init__(robot.space.base + path)
        self.robot = robot
        self.path = path
        self.title = "/" + path

    writes: ClassVar[frozenset[str]] = frozenset()

    def methods(self) -> frozenset[str]:
        return READ if self.robot.settings.read_only else READ | self.writes

    def why_not(self, method: str) -> str:
        if self.robot.settings.read_only:
            return "This server is read-only."
        return f"{self.kind} resources do not answer {method}."

    @property
    def constrained_by(self) -> str | None:
        return self.robot.space.shape("data")

    def there(self) -> Record:
        """The record; a 404 or 410 Problem where there is none."""
        found = self.robot.records.get(self.path)
        if found is None:
            raise missing(self.robot, self.path)
        return found

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        return self.robot.kept_changes.watch(wake, lambda path: path == self.path)

    def require_guard(self, exchange: Exchange) -> None:
        """Raise a 428 Problem where writes must say what they change, and this one does not."""
        if self.robot.settings.demand_if_match:
            require_if_match(exchange.header("if-match"), "What is kept is changed by those who have read it.")

    async def do(self, *writes: Write) -> Sequence[Record | None]:
        """Do these writes; a 409 Problem where that is not possible as things are."""
        try:
            return await self.robot.records.write(*writes)
        except Conflict as error:
            raise Problem(409, f"{self.robot.space.base}{error.path}: {error.words}.") from error

    async def delete(self, exchange: Exchange) -> Answer:
        self.require_guard(exchange)
        record = self.there()
        await self.do(Remove(self.path, record.version))
        return Response(status_code=204)


def missing(robot: Robot, path: str) -> Problem:
    """410 where something was removed (LDP leaves no room for another thing there), 308 to a container, else 404."""
    if robot.records.was_there(path):
        return Problem(410, f"/{path} was deleted; its URL is not used again.")
    other = path[:-1] if path.endswith("/") else path + "/"
    if robot.records.get(other) is not None:
        return moved(robot.space.base + other)
    return Problem(404, f"There is nothing at /{path}; PUT makes it.")


class AbsentResource(_Kept):
    """Nothing yet: PUT makes it."""

    kind = "Absent"
    writes = frozenset({"PUT"})
    accepts: Mapping[str, Sequence[str]] = {"PUT": (*RDF_BODIES, ANYTHING)}
    links = ()

    async def state(self) -> State:
        raise missing(self.robot, self.path)

    def streams(self, exchange: Exchange) -> bool:
        return self._model(exchange) is Model.NON_RDF_SOURCE

    def _model(self, exchange: Exchange) -> Model:
        return asked_model(exchange, self.url, container=self.url.endswith("/"))

    async def put(self, exchange: Exchange) -> Answer:
        if self.robot.records.was_there(self.path):
            raise missing(self.robot, self.path)
        return await made(self.robot, self.path, self._model(exchange), exchange)


class SourceResource(_Kept):
    """An RDF source."""

    kind = "RDF source"
    writes = frozenset({"PUT", "PATCH", "DELETE"})
    accepts: Mapping[str, Sequence[str]] = {"PUT": RDF_BODIES, "PATCH": (SPARQL_UPDATE, N3_PATCH)}

    async def state(self) -> State:
        return shown(self.robot, self.there())

    async def forms(self) -> Sequence[Form]:
        return [DeleteForm("Delete it")] if "DELETE" in self.methods() else []

    async def put(self, exchange: Exchange) -> Answer:
        self.require_guard(exchange)
        record = self.there()
        require_model(exchange, record.model, self.url)
        body = parse_body(await exchange.body(), exchange.media_type, self.document_url)
        await self.replace(record, triples_of(body))
        return Response(status_code=204)

    async def patch(self, exchange: Exchange) -> Answer:
        self.require_guard(exchange)
        record, data = self.there(), await exchange.body()
        document = (await self.state()).document
        after = triples_of(updated(data, document.triples, self.document_url))
        await self.replace(record, after)
        return Response(status_code=204)

    @property
    def document_url(self) -> str:
        """What relative IRIs are resolved against."""
        return self.url

    async def replace(self, record: Record, triples: Sequence[Triple]) -> None:
        """Keep these triples instead; those that are the server's to say must be as they are, or away."""
        require_contained(self.robot, record, triples)
        url = self.robot.space.base + record.path
        if record.membership is not None:
            require_membership(record.membership, triples, url, record.model)
        kept = written(each for each in triples if not is_managed(each, url))
        await self.do(
            Put(record.path, record.model, kept, record.blob, record.membership, record.member, expected=record.version)
        )


class DescriptionResource(SourceResource):
    """The description of a file, at its URL and `.meta`: it comes and goes with the file (LDP 4.2.1.6, 5.2.3.12)."""

    kind = "Description"
    writes = frozenset({"PUT", "PATCH"})

    def __init__(self, robot: Robot, path: str) -> None:
        super().__init__(robot, path.removesuffix(META))
        self.url = robot.space.base + path
        self.title = "/" + path

    async def forms(self) -> Sequence[Form]:
        return ()


class KeptFile(_Kept):
    """A non-RDF source: bytes as they were sent."""

    kind = "File"
    writes = frozenset({"PUT", "PATCH", "DELETE"})
    accepts: Mapping[str, Sequence[str]] = {"PUT": (ANYTHING,), "PATCH": (MERGE_PATCH,)}

    def __init__(self, robot: Robot, path: str) -> None:
        super().__init__(robot, path)
        self.links = (*model_links(Model.NON_RDF_SOURCE), Link(self.url + META, "describedby"))

    def streams(self, exchange: Exchange) -> bool:
        return exchange.method == "PUT"

    async def state(self) -> State:
        return shown(self.robot, self.there())

    async def special(self, exchange: Exchange) -> Response | None:
        record = self.there()
        assert record.blob is not None
        etag = ETag(f"{self.robot.records.identity}-{record.version}", "bin")
        if_match, if_none_match = exchange.header("if-match"), exchange.header("if-none-match")
        headers = {**standing_headers(self), "vary": "Accept", "cache-control": "no-cache"}
        if guard(exchange.method, etag, if_match=if_match, if_none_match=if_none_match):
            return Response(status_code=304, headers={**headers, "etag": str(etag)})
        return await file_response(
            self.robot.records.file(record.blob),
            record.blob.size,
            record.blob.media_type,
            str(etag),
            headers=headers,
            name=self.title.rpartition("/")[2],
            range_=exchange.header("range"),
            if_range=exchange.header("if-range"),
            head=exchange.method == "HEAD",
        )

    async def put(self, exchange: Exchange) -> Answer:
        self.require_guard(exchange)
        record = self.there()
        require_model(exchange, record.model, self.url)
        blob = await received(self.robot, exchange)
        await self._replace(record, blob)
        return Response(status_code=204)

    async def patch(self, exchange: Exchange) -> Answer:
        """JSON merge patch of a JSON file (RFC 7396)."""
        self.require_guard(exchange)
        record = self.there()
        assert record.blob is not None
        if record.blob.media_type.partition(";")[0].strip() != JSON:
            raise Problem(415, f"{MERGE_PATCH} changes {JSON}, and this is {record.blob.media_type}.")
        if record.blob.size > self.robot.settings.body_limit:
            raise Problem(413, f"A file of {record.blob.size} bytes is too large to be patched; PUT it whole.")
        before = parse_json(self.robot.records.file(record.blob).read_bytes())
        data = orjson.dumps(merge_patch(before, parse_json(await exchange.body())))
        blob = await self.robot.records.receive(one_chunk(data), record.blob.media_type, most=len(data))
        await self._replace(record, blob)
        return Response(status_code=204)

    async def _replace(self, record: Record, blob: Blob) -> None:
        await self.do(
            Put(record.path, record.model, record.triples, blob, None, record.member, expected=record.version)
        )


class ContainerResource(SourceResource):
    """A container (LDP 5): POST makes a member, its members are told with it, in pages where there are many."""

    kind = "Container"
    accepts: Mapping[str, Sequence[str]] = {
        "POST": (*RDF_BODIES, ANYTHING),
        "PUT": RDF_BODIES,
        "PATCH": (SPARQL_UPDATE, N3_PATCH),
    }
    writes = frozenset({"PUT", "PATCH", "POST", "DELETE"})
    takes_forms = False

    def __init__(self, robot: Robot, path: str, parts: Parts = ALL, after: int | None = None) -> None:
        super().__init__(robot, path)
        self._parts = parts
        self._after = after
        record = robot.records.get(path)
        self.links = model_links(record.model if record is not None else Model.BASIC_CONTAINER)

    def methods(self) -> frozenset[str]:
        is_root = self.path.count("/") == 1
        return super().methods() - ({"DELETE"} if is_root else frozenset())

    async def narrowed(self, exchange: Exchange) -> Resource:
        """The parts that Prefer asks for (LDP 7.2), the page that `?page=` does, the first of many pages (303)."""
        if exchange.method not in ("GET", "HEAD"):
            return self
        parts = wanted(exchange.prefer) if exchange.header("prefer") is not None else ALL
        page = exchange.query.get("page")
        if page is not None:
            return ContainerResource(self.robot, self.path, parts, after_page(page))
        if self.there().count > PAGE and (parts.containment or parts.membership):
            raise Problem(
                303, "It comes in pages.", title="See its first page", headers={"Location": f"{self.url}?page=0"}
            )
        return self if parts is ALL else ContainerResource(self.robot, self.path, parts)

    async def state(self) -> State:
        record = self.there()
        if self._after is None:
            return shown(self.robot, record, self._parts)
        return page_shown(self.robot, record, self._parts, self._after)

    def streams(self, exchange: Exchange) -> bool:
        return exchange.method == "POST" and self._model(exchange) is Model.NON_RDF_SOURCE

    def _model(self, exchange: Exchange) -> Model:
        return asked_model(exchange, self.url, container=False)

    async def post(self, exchange: Exchange) -> Answer:
        """A member, named by Slug where that is free (LDP 5.2.3)."""
        self.there()
        model = self._model(exchange)
        records = self.robot.records

        def taken(name: str) -> bool:
            paths = (self.path + name, f"{self.path}{name}/")
            return any(records.get(path) is not None or records.was_there(path) for path in paths)

        name = free_name(exchange.header("slug"), taken)
        path = f"{self.path}{name}/" if model.is_container else self.path + name
        return await made(self.robot, path, model, exchange)


# Making


async def made(robot: Robot, path: str, model: Model, exchange: Exchange) -> Created:
    """Make a resource, and the containers on the way to it that are missing."""
    url = robot.space.base + path
    resource = resource_of(robot, path, model)
    if model is Model.NON_RDF_SOURCE:
        put = Put(path, model, blob=await received(robot, exchange), expected=0)
        body = RdfBody({}, 0)
    else:
        body = parse_body(await exchange.body(), exchange.media_type, url)
        triples = triples_of(body)
        if any(each.subject == NamedNode(url) and each.predicate == ldp.contains for each in triples):
            raise Problem(409, "A new container contains nothing: leave ldp:contains away, and POST its members to it.")
        kept = written(each for each in triples if not is_managed(each, url))
        put = Put(path, model, kept, membership=membership_asked(model, triples, url), expected=0)
    writes = [*_ways_to(robot, path), _as_member(robot, put, body, url)]
    records = await resource.do(*writes)
    record = records[-1]
    assert record is not None
    links: tuple[Link, ...] = ()
    if model is Model.NON_RDF_SOURCE:
        links = (Link(url + META, "describedby", anchor=url),)
    return Created(url, resource, shown(robot, record), links)


def _as_member(robot: Robot, put: Put, body: RdfBody, url: str) -> Put:
    """With what stands for it in the membership triples of its container (LDP 5.5.1.2)."""
    container = robot.records.get(container_of(put.path))
    if container is None or container.membership is None:
        return put
    member = member_of(container.membership, body, url)
    return Put(put.path, put.model, put.triples, put.blob, put.membership, member, put.expected)


def _ways_to(robot: Robot, path: str) -> list[Put]:
    """The containers to be made first."""
    found: list[Put] = []
    above = container_of(path)
    while robot.records.get(above) is None:
        found.insert(0, Put(above, Model.BASIC_CONTAINER, expected=0))
        above = container_of(above)
    return found


def container_of(path: str) -> str:
    """The path of the container that a path lies in."""
    return path.rstrip("/").rpartition("/")[0] + "/"


def membership_asked(model: Model, triples: Sequence[Triple], url: str) -> Membership | None:
    """The membership of a Direct or Indirect container, as its body says."""
    return membership_of(triples, url, model) if model in (Model.DIRECT_CONTAINER, Model.INDIRECT_CONTAINER) else None


async def received(robot: Robot, exchange: Exchange) -> Blob:
    """The body as a blob, streamed to where it is kept."""
    media_type = exchange.header("content-type") or "application/octet-stream"
    limit = robot.settings.upload_limit
    return await robot.records.receive(exchange.chunks(limit=limit), media_type, most=limit)


async def one_chunk(data: bytes) -> AsyncIterator[bytes]:
    yield data


def asked_model(exchange: Exchange, url: str, *, container: bool) -> Model:
    """The interaction model that a request to `url` asks for; `container`: what is made has a URL of a container."""
    links = parse_links(exchange.header("link") or "")
    media_type = exchange.media_type if exchange.header("content-type") is not None else None
    return model_asked(links, url, media_type, container_hint=container)


def require_model(exchange: Exchange, model: Model, url: str) -> None:
    """Raise a 409 Problem where a request asks to turn a resource into one of another model (LDP 4.2.3, 5.2.3.4)."""
    links = parse_links(exchange.header("link") or "")
    asked = any(link.rel == "type" for link in links)
    if asked and asked_model(exchange, url, container=url.endswith("/")) is not model:
        raise Problem(409, f"This is an ldp:{model.value}, and stays one: make another resource for another model.")


def triples_of(body: RdfBody) -> tuple[Triple, ...]:
    """The triples of a body. Raises a 422 Problem for triples about triples, which are not kept."""
    found = []
    for subject, properties in body.subjects.items():
        for predicate, objects in properties.items():
            for each in objects:
                if isinstance(subject, Triple) or isinstance(each, Triple):
                    raise Problem(422, "Triples about triples are not kept here.")
                found.append(Triple(subject, predicate, each))
    return tuple(found)


def require_membership(membership: Membership, triples: Sequence[Triple], url: str, model: Model) -> None:
    """Raise a 409 Problem where a body would change what a container's membership triples are made of."""
    stated = {each.predicate for each in triples if each.subject == NamedNode(url)} & MEMBERSHIP
    if stated and membership_of(triples, url, model) != membership:
        raise Problem(409, "What membership triples are made of was said when the container was made, and stays so.")


def require_contained(robot: Robot, record: Record, triples: Sequence[Triple]) -> None:
    """Raise a 409 Problem where a body would change what a container contains (LDP 5.2.4.1)."""
    subject = NamedNode(robot.space.base + record.path)
    stated = {each.object for each in triples if each.subject == subject and each.predicate == ldp.contains}
    if not stated:
        return
    members = {NamedNode(robot.space.base + each.path) for each in all_members(robot, record)}
    if stated != members:
        raise Problem(409, "What a container contains is changed by POST and DELETE, not by its triples.")


def all_members(robot: Robot, record: Record) -> list[Member]:
    """All members of a container."""
    found: list[Member] = []
    if record.model.is_container:
        while page := robot.records.members(record.path, after=found[-1].number if found else 0):
            found += page
    return found


# Showing


def shown(robot: Robot, record: Record, parts: Parts = ALL) -> State:
    """A record as it is, or the parts of a container that are asked for: kept while it does not change."""
    url = robot.space.base + record.path
    return robot.states.get(
        f"{url}#{parts.variant}",
        (record.version, record.listed),
        lambda: _state(robot, record, parts, all_members(robot, record) if _lists(parts) else []),
    )


def page_shown(robot: Robot, record: Record, parts: Parts, after: int) -> State:
    """One page of a container: the members made after number `after` (LDP Paging 1.0)."""
    url = robot.space.base + record.path
    found = robot.records.members(record.path, after=after, most=PAGE)
    links = [Link(f"{LDP}Page", "type"), Link(f"{url}?page=0", "first"), Link(url, "canonical")]
    if len(found) == PAGE:
        links.append(Link(f"{url}?page={found[-1].number}", "next"))
    headers = {"link": render([*model_links(record.model), *links])}
    return robot.states.get(
        f"{url}?page={after}#{parts.variant}",
        (record.version, record.listed),
        lambda: _state(robot, record, parts, found, headers=headers, page=f"p{after}"),
    )


def _lists(parts: Parts) -> bool:
    return parts.containment or parts.membership


def _state(
    robot: Robot,
    record: Record,
    parts: Parts,
    members: Sequence[Member],
    *,
    headers: Mapping[str, str] = {},
    page: str = "",
) -> State:
    url = robot.space.base + record.path
    tag = f"{record.version}-{record.listed}{page}{parts.variant}" if record.model.is_container else f"{record.version}"
    if parts.applied:
        headers = {**headers, "preference-applied": str(parts.preference_applied)}
    if record.model.is_container:
        headers = {**headers, "vary": "Accept, Prefer"}
    return State(
        lambda: _document(robot, record, parts, url, members),
        token=tag,
        scope=robot.records.identity,
        headers=headers,
    )


def _document(robot: Robot, record: Record, parts: Parts, url: str, members: Sequence[Member]) -> Document:
    membership = declared(record.membership, url) if record.membership is not None and parts.minimal else []
    if record.membership is not None and parts.membership:
        membership += membership_triples(record.membership, [each.member or robot.space.base + each.path for each in members])
    contained = [robot.space.base + each.path for each in members] if parts.containment else []
    kept = record if parts.minimal else replace(record, triples=b"")
    return record_document(kept, url, contained, membership)


def after_page(text: str) -> int:
    """The number that `?page=` names; a 404 Problem for what is none."""
    if not (text.isascii() and text.isdigit() and len(text) < 19):
        raise Problem(404, f"?page={text[:100]} is no page of this container; follow the links from ?page=0.")
    return int(text)


def resource_of(robot: Robot, path: str, model: Model) -> _Kept:
    """The resource of a model."""
    if model is Model.NON_RDF_SOURCE:
        return KeptFile(robot, path)
    return ContainerResource(robot, path) if model.is_container else SourceResource(robot, path)


def kept_room(robot: Robot, location: Location) -> Resource:
    """`/data/` and below: as what is recorded now has it."""
    path = robot.space.url(location.kind, location.segments)[len(robot.space.base) :]
    if location.is_container:
        path += "/"
    record = robot.records.get(path)
    if record is not None:
        return resource_of(robot, path, record.model)
    if path.endswith(META):
        described = robot.records.get(path.removesuffix(META))
        if described is not None and described.model is Model.NON_RDF_SOURCE:
            return DescriptionResource(robot, path)
    return AbsentResource(robot, path)
