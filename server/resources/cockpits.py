"""Cockpits: panels in a grid at `/cockpit/NAME`, stored as RDF; `/cockpit/default` is generated for the robot."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import cast

from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple

from rosld.adapters.base import Watch
from rosld.ontology.cockpit import NOTHING, Cockpit, cockpit_triples, read_cockpit, without_cockpit
from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, triples_about
from rosld.ontology.urls import Location
from rosld.server.auth.errors import forbidden
from rosld.server.auth.permissions import Permissions
from rosld.server.html.cockpit import CockpitPage, FilledPanel
from rosld.server.html.cockpit_form import CopyForm, EditForm, cockpit_of_form
from rosld.server.html.forms import DeleteForm, Form
from rosld.server.html.page import Csrf, MemberColumns, Notice
from rosld.server.html.render import render_cockpit
from rosld.server.html.site import Site
from rosld.server.http.body import FORM
from rosld.server.http.conditional import digest
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.policies.stored_cockpits import DEFAULT, ROUTE, cockpit_titles
from rosld.server.resources.base import Services
from rosld.server.resources.cockpit_panels import PanelReader
from rosld.server.resources.default_cockpit import default_cockpit
from rosld.server.resources.ldp.base import Documents, conflict_problem, write_together
from rosld.server.resources.ldp.containers import ContainerResource, creation_writes
from rosld.server.resources.ldp.rdf_sources import RdfSourceResource
from rosld.server.resources.ldp.representation import state_of
from rosld.server.resources.ldp.routes import stored_route
from rosld.server.resources.ldp.versions import former_of
from rosld.server.resources.namespaces import listed_graph
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, HTML, JSON, OFFERS
from rosld.server.rest.interaction import choose_name
from rosld.server.rest.path_item import FORMAT, PAGE, PathItem
from rosld.server.rest.resource import RDF_SOURCE as RDF_SOURCE_LINK
from rosld.server.rest.resource import RESOURCE, Answer, CreatedAnswer, Resource
from rosld.server.rest.responses import no_content
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import combine_watches
from rosld.server.storage.record import Conflict, Model, Record, Write

_MAX_TABS = 20
_MAX_SUGGESTIONS = 200


class CockpitState(State, eq=False):
    """The state of a cockpit's page: the document, and the current content of its panels."""

    cockpit: Cockpit = NOTHING
    panels: tuple[FilledPanel, ...] = ()
    hidden: int = 0


def wants_page(exchange: Exchange) -> bool:
    """Whether a request is for the page of a cockpit or submits one of its forms."""
    if exchange.method == "POST":
        return (exchange.header("content-type") or "").startswith(FORM)
    if exchange.method not in ("GET", "HEAD"):
        return False
    return exchange.preferred(FORMATS, OFFERS) == HTML


def cockpit_tabs(documents: Documents) -> tuple[tuple[str, str], ...]:
    """Return the URLs and titles of the default cockpit and of the first stored ones."""
    space = documents.space
    return ((space.cockpit(DEFAULT), "Default"), *cockpit_titles(documents.records, space, _MAX_TABS))


def copy_form(site: Site, source: str) -> CopyForm | None:
    """Return the form that stores a copy, or None if the reader may not store any."""
    return None if site.read_only or not site.may("POST", f"{site.base}{ROUTE}") else CopyForm(source)


class _CockpitBase(Resource):
    """Base class of cockpits: documents, whose pages show an agent the current values of the panels."""

    kind = "Cockpit"
    _reader: PanelReader | None = None
    """The reader of the panels of a page, or None for the document."""

    def __init__(self, services: Services, url: str) -> None:
        super().__init__(services.space, url)
        self.documents = services.documents
        self._services = services

    async def cockpit(self) -> Cockpit:
        """Return the current cockpit."""
        raise NotImplementedError

    async def document_state(self) -> State:
        """Return the state of the document."""
        raise NotImplementedError

    @property
    def variant_key(self) -> Hashable:
        return self._reader is not None, super().variant_key

    def shown(self, exchange: Exchange) -> Resource:
        """Return the page if requested, else the document."""
        if self._reader is not None or not wants_page(exchange):
            return self
        reader = PanelReader(self._services, exchange.permissions)
        return self.variant(_permissions=exchange.permissions, _reader=reader)

    async def state(self) -> State:
        document = await self.document_state()
        if self._reader is None:
            return document
        cockpit = await self.cockpit()
        panels, hidden = await self._reader.read(cockpit)
        token = digest(repr((document.tag, hidden, [each.version for each in panels])).encode("utf-8", "replace"))
        return CockpitState(
            document.describe, token=token, headers=document.headers, cockpit=cockpit, panels=panels, hidden=hidden
        )

    def redact(self, state: State, permissions: Permissions) -> State:
        """Return the state of a page unchanged, as its panels were read with the agent's permissions."""
        return state if self._reader is not None else super().redact(state, permissions)

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        if self._reader is None:
            return await super().watch(wake)
        own = self.documents.changes.watch(wake, lambda path: path.startswith(ROUTE))
        return combine_watches(own, await self._reader.watch(await self.cockpit(), wake))

    def page(self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]) -> bytes:
        assert isinstance(state, CockpitState)
        edit = next((each for each in forms if isinstance(each, EditForm)), None)
        delete = next((each for each in forms if isinstance(each, DeleteForm)), None)
        return render_cockpit(
            CockpitPage(
                site,
                self.url,
                state.cockpit,
                state.panels,
                state.hidden,
                cockpit_tabs(self.documents),
                csrf,
                edit if site.may("PUT", self.url) else None,
                copy_form(site, self.url),
                delete if site.may("DELETE", self.url) else None,
                tuple(notices),
                _suggestions(self._services, site) if edit is not None else (),
            )
        )


# Stored cockpits


class CockpitResource(_CockpitBase, RdfSourceResource):
    """A cockpit stored by a client."""

    def __init__(self, services: Services, path: str) -> None:
        RdfSourceResource.__init__(self, services.documents, path)
        self._services = services

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the requested former version, or the page, or the document."""
        return former_of(self.documents, self.path, exchange) or self.shown(exchange)

    async def document_state(self) -> State:
        return await RdfSourceResource.state(self)

    async def cockpit(self) -> Cockpit:
        return self._cockpit

    @property
    def _cockpit(self) -> Cockpit:
        return read_cockpit(state_of(self.documents, self.require_record()).document.triples, self.url)

    async def forms(self) -> Sequence[Form]:
        if "PUT" not in self.methods():
            return ()
        edit = EditForm(self._cockpit, self.space.base, str(self.require_record().version))
        return (edit, DeleteForm("Delete this cockpit"))

    async def put(self, exchange: Exchange) -> Answer:
        """Replace the cockpit by the body, or by the one that a form describes.

        Raises a 409 Problem if the cockpit was changed after the form was loaded.
        """
        if self._reader is None:
            return await super().put(exchange)
        value = cast("Mapping[str, object]", json.loads(await exchange.body()))
        cockpit = cockpit_of_form(value, self.space.base)

        async def changed(record: Record) -> Write:
            if value.get("version") != str(record.version):
                raise Problem(409, "The cockpit was changed meanwhile: reload the page and repeat your change.")
            before = state_of(self.documents, record).document.triples
            after = [*without_cockpit(before, self.url), *_triples(self.url, cockpit)]
            return await self.with_triples(record, after, record.version, frozenset(before))

        await self.change_record(exchange, changed)
        return no_content()


def _triples(url: str, cockpit: Cockpit) -> list[Triple]:
    """Return the triples of a cockpit. Raises a 422 Problem for an invalid IRI."""
    try:
        return cockpit_triples(url, cockpit)
    except ValueError as error:
        raise Problem(422, f"What a panel shows must be an IRI or a path below the base: {error}.") from error


def _suggestions(services: Services, site: Site) -> tuple[str, ...]:
    """Return the paths that a panel may show, relative to the base."""
    session = services.session
    space, graph = session.space, listed_graph(session.graph, session.adapter.capabilities)
    urls = (
        *map(space.topic, graph.topics),
        f"{space.base}diagnostics",
        space.stop,
        *map(space.query, services.queries.shipped),
        *map(space.service, graph.services),
    )
    return tuple(each.removeprefix(space.base) for each in urls if site.may("GET", each))[:_MAX_SUGGESTIONS]


# The default cockpit


class DefaultCockpit(_CockpitBase):
    """The cockpit generated for the robot. It is not stored, but copies of it are."""

    title = "Default cockpit"
    item = PathItem("The cockpit that is generated from what the robot has", query=(FORMAT,))
    links = (RESOURCE, RDF_SOURCE_LINK)

    def __init__(self, services: Services) -> None:
        super().__init__(services, services.space.cockpit(DEFAULT))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.space.document_shape("Source"), self.space.shape("cockpit"))

    def deny_reason(self, method: str) -> str:
        if self.documents.settings.read_only:
            return READ_ONLY
        container = self.space.container("cockpit")
        return f"This cockpit is generated: PUT one with another name to {container}NAME."

    async def select_variant(self, exchange: Exchange) -> Resource:
        return self.shown(exchange)

    async def cockpit(self) -> Cockpit:
        return await default_cockpit(self._services)

    async def document_state(self) -> State:
        cockpit = await self.cockpit()
        return self.documents.states.get_or_make(self.url, cockpit, lambda: State(lambda: self._document(cockpit)))

    def _document(self, cockpit: Cockpit) -> Document:
        own = triples_about(NamedNode(self.url), *RDF_SOURCE)
        return Document(self.url, (*own, *cockpit_triples(self.url, cockpit)))


# The container


class CockpitContainer(ContainerResource):
    """`/cockpit/`: stored cockpits. Its page also lists the default cockpit and creates copies."""

    item = PathItem("The cockpits", query=(FORMAT, PAGE))
    takes_forms = True

    def __init__(self, services: Services) -> None:
        super().__init__(services.documents, ROUTE)
        self._services = services

    def is_taken(self, name: str) -> bool:
        return name == DEFAULT or super().is_taken(name)

    async def forms(self) -> Sequence[Form]:
        if self.documents.settings.read_only:
            return ()
        return (CopyForm(self.space.cockpit(DEFAULT)),)

    def listing(self) -> MemberColumns:
        return MemberColumns(("title",), {url: (name,) for url, name in cockpit_tabs(self.documents)})

    async def post(self, exchange: Exchange) -> Answer:
        """Create a cockpit, or the copy that a form requests."""
        return await (self._copy(exchange) if exchange.essence == JSON else super().post(exchange))

    async def _copy(self, exchange: Exchange) -> Answer:
        value = cast("Mapping[str, str]", json.loads(await exchange.body()))
        documents, permissions = self.documents, exchange.permissions
        cockpit = await self._source(value["source"], permissions)
        name = choose_name(value["name"], lambda name: False)
        url = documents.space.cockpit(name)
        path = url[len(documents.space.base) :]
        if not permissions.may("PUT", url):
            raise forbidden(permissions.agent, "write this")
        if self.is_taken(name):
            raise Problem(409, f"{url} already exists, or was deleted: choose another name.")
        title = name if cockpit.title in ("", DefaultCockpit.title) else cockpit.title
        triples = cockpit_triples(url, replace(cockpit, title=title))
        try:
            record = (
                await write_together(documents, await creation_writes(documents, path, Model.RDF_SOURCE, triples))
            )[-1]
        except Conflict as error:
            raise conflict_problem(documents.space, error) from error
        assert record is not None
        made = CockpitResource(self._services, path)
        return CreatedAnswer(made.url, made, state_of(documents, record))

    async def _source(self, url: str, permissions: Permissions) -> Cockpit:
        """Return the cockpit at a URL, with the panels that the agent may read. Raises a 404 Problem."""
        space = self.space
        if url == space.cockpit(DEFAULT) and permissions.may_read(url):
            found = await DefaultCockpit(self._services).cockpit()
        else:
            record = self.documents.records.get(url[len(space.base) :]) if url.startswith(self.url) else None
            if record is None or record.model is not Model.RDF_SOURCE or not permissions.may_read(url):
                raise Problem(404, f"There is no cockpit {url[:200]} to copy.")
            found = read_cockpit(state_of(self.documents, record).document.triples, url)
        panels = [each for each in found.panels if all(map(permissions.may_read, each.shows))]
        return replace(found, panels=tuple(panels))


def cockpit_route(services: Services, location: Location) -> Resource:
    """Return the resource at `/cockpit/` or below."""
    if location.segments == (DEFAULT,) and not location.is_container:
        return DefaultCockpit(services)
    found = stored_route(services.documents, location)
    match found:
        case ContainerResource() if found.path == ROUTE:
            return CockpitContainer(services)
        case RdfSourceResource() if type(found) is RdfSourceResource:
            return CockpitResource(services, found.path)
    return found
