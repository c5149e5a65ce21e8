"""Panels of cockpits, read from their resources with the permissions of one agent."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from itertools import islice
from urllib.parse import parse_qsl

from msgspec.structs import replace

from rosld.adapters.base import Watch
from rosld.adapters.model import RosError
from rosld.ontology.cockpit import Cockpit, Panel, PanelKind
from rosld.ontology.urls import Location
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.redaction import redact_problem
from rosld.server.html.cockpit import (
    MAX_STREAM,
    DriveContent,
    FilledPanel,
    FormsContent,
    PanelContent,
    PictureContent,
    PlotContent,
    SpaceContent,
    StatesContent,
    TableContent,
    ValueContent,
    WordsContent,
)
from rosld.server.html.cockpit_form import EditForm
from rosld.server.html.forms import Form, HoldForm, ValueForm
from rosld.server.html.graphics import picture_view, space_query
from rosld.server.html.labels import capitalize, split_words
from rosld.server.html.offer import forms_of
from rosld.server.html.page import PageResults
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.resources.base import Services
from rosld.server.resources.diagnostics import DiagnosticsResource
from rosld.server.resources.faults import lasting_states
from rosld.server.resources.messages import decode
from rosld.server.resources.plot import NumberFinder
from rosld.server.resources.space import SpaceResource
from rosld.server.resources.sparql_endpoint import page_results
from rosld.server.resources.topics import TopicResource
from rosld.server.rest.resource import Resource
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import call_every, combine_watches
from rosld.server.sparql.protocol import QueryRequest
from rosld.server.sparql.stored_query import OTHER_SETTINGS, StoredQuery, bind_parameters

_PATIENCE = 4.0
"""Seconds after which a panel shows a timeout."""
_LOOK_SECONDS = 2.0
"""Seconds between polls of values without change notifications."""
_ROWS = 50
_TABLE_SECONDS = 10.0
"""Seconds that results of a query are cached at most."""
_QUERY_SECONDS = 3.0
_COMMANDED = frozenset({"services", "actions", "resources", "topics", "parameters", "goals", "holds", "stop"})
"""Kinds of URLs that panels may send to: those that reach the robot."""


class PanelHidden(Exception):
    """Raised when the agent may not read the content of a panel or use its controls."""


class PanelReader:
    """Reader of panels for one agent."""

    def __init__(self, services: Services, permissions: Permissions) -> None:
        self._services = services
        self._session = services.session
        self._permissions = permissions

    async def read(self, cockpit: Cockpit) -> tuple[tuple[FilledPanel, ...], int]:
        """Return the current panels, and the number of panels hidden from the agent."""
        found = await asyncio.gather(*map(self._fill, cockpit.panels))
        there = tuple(each for each in found if each is not None)
        return there, len(found) - len(there)

    async def watch(self, cockpit: Cockpit, wake: Callable[[], None]) -> Watch:
        """Call `wake` whenever a value may have changed; values without notifications are polled."""
        watches = [self._services.software_stop.changes.watch(wake), call_every(_LOOK_SECONDS, wake)]
        kinds = (PanelKind.VALUE, PanelKind.BUTTON)
        for url in {url for each in cockpit.panels if each.kind in kinds for url in each.shows}:
            try:
                if self._permissions.may_read(url):
                    resource = await self._resource(url)
                    watches += [watch for watch in [await resource.watch(wake)] if watch is not None]
            except (Problem, RosError, ValueError):
                continue  # the panel shows the reason
        return combine_watches(*watches)

    async def _fill(self, panel: Panel) -> FilledPanel | None:
        try:
            content, version = await asyncio.wait_for(self._content(panel), _PATIENCE)
        except PanelHidden:
            return None
        except (TimeoutError, asyncio.TimeoutError):
            content = WordsContent(f"No response within {_PATIENCE:g} s.")
            version = content.words
        except (Problem, RosError, ValueError) as error:
            content = WordsContent(_sentence(error, self._permissions))
            version = content.words
        return FilledPanel(panel, content, version)

    async def _content(self, panel: Panel) -> tuple[PanelContent, str]:
        """Return the content of a panel, and its version."""
        base = self._session.space.base
        foreign = next((each for each in panel.shows if not each.startswith(base)), None)
        words = ""
        if not panel.shows:
            words = "It shows nothing: add ros:shows."
        elif foreign is not None:
            words = f"{foreign} is not on this robot: it is linked, not fetched."
        elif panel.kind is None:
            words = f"Unknown panel type {panel.type or 'ros:Panel'}."
        if words:
            return WordsContent(words), words
        if not all(map(self._permissions.may_read, panel.shows)):
            raise PanelHidden
        url = panel.shows[0]
        match panel.kind:
            case PanelKind.PLOT:
                return await self._plot(panel)
            case PanelKind.PICTURE:
                return await self._picture(url)
            case PanelKind.SPACE:
                return self._space(panel.shows)
            case PanelKind.DRIVE:
                return await self._drive(url)
            case PanelKind.BUTTON:
                return await self._forms(panel.shows)
            case PanelKind.QUERY:
                return await self._table(url)
            case _:
                return await self._value(url)

    # Resources

    def _find(self, url: str) -> Resource:
        """Return the resource at a URL of this robot. Raises Problems."""
        path = url.removeprefix(self._session.space.base).partition("#")[0].partition("?")[0]
        try:
            return self._services.find(f"/{path}")
        except ValueError as error:
            raise Problem(404, f"There is nothing at /{path}: {error}.") from error

    async def _resource(self, url: str) -> Resource:
        found = self._find(url)
        if isinstance(found, DiagnosticsResource):
            found = found.select("", self._permissions)
        await found.prepare()
        return found

    async def _state(self, resource: Resource) -> State:
        """Return the state of a resource, redacted for the agent. Raises Problems and RosError."""
        try:
            state = await resource.state()
        except NotImplementedError as error:
            raise Problem(404, f"{resource.url} has no value to show.") from error
        if state.is_large:
            raise Problem(413, f"{resource.url} is too large to be shown here.")
        return state if self._permissions.is_unrestricted else resource.redact(state, self._permissions)

    def _topic(self, url: str) -> TopicResource:
        found = self._find(url)
        if not isinstance(found, TopicResource):
            raise Problem(404, f"{url} is not a topic.")
        if found.found is None:
            raise Problem(404, f"There is no topic {found.name} now.")
        return found

    # Contents

    async def _value(self, url: str) -> tuple[PanelContent, str]:
        resource = await self._resource(url)
        state = await self._state(resource)
        if isinstance(resource, DiagnosticsResource):
            return StatesContent(tuple(resource.part_states)), state.tag
        if url == self._session.space.container("faults"):
            found = lasting_states(self._services.faults, self._permissions.may_read, self._session.space)
            return StatesContent(found) if found else WordsContent("Nothing is wrong."), state.tag
        return ValueContent(state.document, state.view), state.tag

    async def _plot(self, panel: Panel) -> tuple[PanelContent, str]:
        references = list(dict.fromkeys(self._references(panel)))[:MAX_STREAM]
        if not references:
            raise Problem(422, "Choose the numbers to draw with ros:fieldPath.")
        finder = NumberFinder(self._services, self._permissions)
        numbers = [await finder.describe(await finder.locate(each)) for each in references]
        return PlotContent(tuple(numbers), tuple(references)), repr(numbers)

    def _references(self, panel: Panel) -> Sequence[str]:
        """Return references to the numbers that a panel plots: its fields, or those named by the URL of a plot."""
        found: list[str] = []
        for url in panel.shows:
            below = url.removeprefix(self._session.space.base)
            path, _, query = below.partition("?")
            if path == "plot":
                found += [value for name, value in parse_qsl(query, max_num_fields=100) if name == "y" and value]
            elif panel.fields:
                found += [f"{below}#{each}" for each in panel.fields]
            elif path.startswith("resources/"):
                found.append(below)
        return found

    def _space(self, urls: Sequence[str]) -> tuple[PanelContent, str]:
        """Return the space view at a URL, or that of topics."""
        base = self._session.space.base
        if isinstance(self._find(urls[0]), SpaceResource):
            reference = urls[0].removeprefix(base)
        else:
            names = [self._topic(each) for each in urls]
            reference = f"space{space_query('', [each.url.removeprefix(base) for each in names])}"
        return SpaceContent(reference), reference

    async def _picture(self, url: str) -> tuple[PanelContent, str]:
        topic = self._topic(url)
        if not topic.is_picture:
            raise Problem(422, f"The messages of {topic.name} are not pictures.")
        view = await self._session.topics.read(topic.name)
        if view.newest is None:
            raise Problem(404, "No picture has been received yet.")
        decoded = await decode(self._session.schemas, view.newest)
        if decoded.schema is None or decoded.message is None:
            raise Problem(422, f"The picture cannot be read: {decoded.reason}.")
        found = picture_view(decoded.schema, decoded.message, "", moves=True)
        assert found is not None
        return PictureContent(found, view.newest.sequence), f"{found} {view.newest.sequence}"

    async def _drive(self, url: str) -> tuple[PanelContent, str]:
        topic = self._topic(url)
        if "POST" not in topic.methods():
            raise topic.not_allowed("POST")
        if not self._permissions.may("POST", url):
            raise PanelHidden
        if self._session.is_stopped:
            raise Problem(423, "The robot is stopped and cannot be driven until it is released.")
        form = next((each for each in await topic.forms() if isinstance(each, HoldForm) and each.pad), None)
        if form is None or form.pad is None:
            raise Problem(422, f"{topic.name} has no velocity that a pad can command.")
        return DriveContent(replace(form, action=topic.url)), form.pad.json

    async def _forms(self, urls: Sequence[str]) -> tuple[PanelContent, str]:
        found: list[Form] = []
        versions: list[str] = []
        for url in urls:
            forms, version = await self._forms_at(url)
            found += forms
            versions.append(version)
        may = [each for each in found if self._permissions.may(each.method, each.action)]
        if found and not may:
            raise PanelHidden
        if not may and self._session.is_stopped:
            raise Problem(423, "The robot is stopped and receives nothing until it is released.")
        if not may:
            raise Problem(404, "Nothing can be sent to it now.")
        return FormsContent(tuple(may)), repr(versions)

    async def _forms_at(self, url: str) -> tuple[Sequence[Form], str]:
        """Return the forms of a resource, each with its URL, and their version."""
        location = self._session.space.location(url)
        if location is None or location.kind not in _COMMANDED:
            raise Problem(422, "A cockpit can send only to the robot: to a service, an action, a value.")
        resource = await self._resource(url)
        if location.kind == "resources":
            state = await self._state(resource)
            forms: Sequence[Form] = () if state.view is None else forms_of(state.view)
            version = state.tag
        else:
            if resource.is_absent:
                raise Problem(404, f"There is nothing at {resource.url}.")
            forms = [each for each in await resource.forms() if not isinstance(each, HoldForm)]
            version = f"{[(each.method, each.title) for each in forms]}"
        aimed = [_with_action(each, resource.url, location) for each in forms if each.method not in resource.withheld]
        return aimed, f"{version}{len(aimed)}"

    # Tables

    async def _table(self, url: str) -> tuple[PanelContent, str]:
        key = url, self._permissions.rights_key, self._permissions.cache_key
        tables, version = self._services.query_tables, time.monotonic() // _TABLE_SECONDS
        results = tables.find(key, version) or tables.put(key, version, await self._results(url))
        fingerprint = f"{results.variables}{results.rows}{results.boolean}{results.note}"
        return TableContent(results), digest(fingerprint.encode("utf-8", "replace"))

    async def _results(self, url: str) -> PageResults:
        """Return the first result rows of a stored query with the parameters in a URL. Raises Problems."""
        query = await self._query(url)
        pairs = parse_qsl(url.partition("#")[0].partition("?")[2], keep_blank_values=True, max_num_fields=100)
        given = {name: value for name, value in pairs if name not in OTHER_SETTINGS}
        text = bind_parameters(query, given, self._session.space.base)
        request = QueryRequest(text, timeout=_QUERY_SECONDS)
        results = await page_results(self._services.sparql, request, None, self._permissions)
        return replace(results, rows=list(islice(results.rows, _ROWS + 1)), limit=_ROWS)

    async def _query(self, url: str) -> StoredQuery:
        space = self._session.space
        queries, location = self._services.queries, space.location(url)
        if location is None or location.kind != "queries" or len(location.segments) != 1 or location.is_container:
            raise Problem(422, f"{url} is not a stored query.")
        record = self._services.documents.records.get(url[len(space.base) :].partition("#")[0].partition("?")[0])
        if record is not None and record.blob is not None:
            return await queries.executable(record)
        shipped = queries.shipped.get(location.segments[0])
        if shipped is None:
            raise Problem(404, f"There is no stored query {location.segments[0]}.")
        return shipped


def _with_action(form: Form, url: str, location: Location) -> Form:
    """Return a form that posts to a URL from any page, with a description."""
    if form.action or isinstance(form, EditForm):
        return form
    if isinstance(form, ValueForm) and location.kind == "services":
        name = capitalize(split_words(location.segments[-1]))
        return replace(form, action=url, title=location.name, button=name)
    return replace(form, action=url)


def _sentence(error: Problem | RosError | ValueError, permissions: Permissions) -> str:
    if isinstance(error, RosError):
        error = problem_of(error)
    return redact_problem(error, permissions, None).with_quotes if isinstance(error, Problem) else f"{error}."
