"""Pages and their forms, for reading and writing resources with a browser."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Hashable, Mapping, Sequence
from datetime import datetime, timezone
from functools import partial
from typing import ClassVar
from urllib.parse import parse_qsl, urlsplit

from msgspec import Struct
from msgspec.structs import replace
from starlette.responses import Response

from rosld.adapters.model import Stale
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.auth.rules import ANONYMOUS
from rosld.server.html.cockpit_form import CopyForm, EditForm, parse_copy, parse_edit
from rosld.server.html.form_parser import (
    parse_choice,
    parse_value,
    split_hidden,
    split_query,
)
from rosld.server.html.forms import CHOICE_FIELD, ChoiceForm, DeleteForm, Form, HoldForm, ValueForm
from rosld.server.html.page import Csrf, Notice, NoticeLevel, NoticeLink, ProblemPage, receipt_notice
from rosld.server.html.render import render_page, render_problem
from rosld.server.html.site import HEADERS, SECTIONS, Site
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.origin import FormKey
from rosld.server.http.problem import Problem
from rosld.server.receipts.journal import Journal, NoSuchReceipt
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.large import LargeDocuments, excerpt_state
from rosld.server.rest.resource import Resource
from rosld.server.rest.ros_problems import problem_of_body
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.robot.software_stop import SoftwareStop

_PROBLEM_OFFERS = ("application/problem+json", "application/json", "text/turtle", "application/ld+json", "text/html")
_SMALL_FORM = 64 * 1024
"""Maximum number of characters of a form parsed on the loop: percent signs alone take 25 ms."""
_MAX_FIELDS = 10_000
_SHORT_PAGE = 300
"""Maximum number of triples of a page rendered on the loop: some 8 ms."""


class PageRenderer(Struct, eq=False):
    """Renderer of the pages of one robot's resources."""

    headers: ClassVar[Mapping[str, str]] = {name.lower(): value for name, value in HEADERS.items()}

    session: Session
    stops: SoftwareStop
    large: LargeDocuments
    receipts: Journal
    keys: FormKey
    sections: tuple[str, ...] = (*SECTIONS, "bags")
    """Containers in the navigation."""

    @property
    def space(self) -> Space:
        """URLs of this server."""
        return self.session.space

    @property
    def site(self) -> Site:
        """Values of this server that every page shows."""
        return self.site_for(ALLOW_ALL)

    def site_for(self, permissions: Permissions) -> Site:
        """Return the values that every page shows to an agent with these permissions."""
        session, stop_state = self.session, self.stops.stop_state
        state = session.graph.state
        stale = f"since {_moment(state.since_ns)}: {state.why}" if isinstance(state, Stale) else None
        return Site(
            session.space.base,
            session.name,
            session.adapter.capabilities.system,
            stale,
            session.settings.read_only,
            self.sections,
            session.space.types,
            stop_token=self._stop_token(permissions),
            stopped="" if stop_state is None or not permissions.may_read(session.space.stop) else stop_state.words,
            stop_warning=self._stop_warning(permissions),
            may=permissions.may,
            may_subtree=lambda method, url: (
                (place := permissions.locate(url)) is None or permissions.may_subtree(method, place)
            ),
            is_restricted=not permissions.is_unrestricted,
        )

    def _stop_warning(self, permissions: Permissions) -> str:
        """Return why the stopped robot may still move; empty if nothing indicates it, or the reader may not know."""
        may_read = permissions.may_read(self.session.space.stop)
        return (self.stops.warning or "") if self.stops.stop_state is not None and may_read else ""

    def _stop_token(self, permissions: Permissions) -> str:
        """Return the token of the stop form; empty if the reader may not stop the robot."""
        session = self.session
        usable = self.stops.is_usable and permissions.may("POST", session.space.stop)
        return self.keys.token(_token_subject(session.space.stop, permissions)) if usable else ""

    @property
    def version(self) -> Hashable:
        """The version of the values that every page shows, for caches of pages."""
        stop_state = self.stops.stop_state
        return None if stop_state is None else (stop_state, self.stops.warning)

    async def page(
        self, resource: Resource, state: State, notices: Sequence[Notice] = (), permissions: Permissions = ALLOW_ALL
    ) -> bytes:
        """Return the page of a resource in its current form, for an agent with these permissions."""
        return await self._page(resource, state, await resource.forms(), notices, permissions)

    async def _page(
        self,
        resource: Resource,
        state: State,
        forms: Sequence[Form],
        notices: Sequence[Notice],
        permissions: Permissions,
    ) -> bytes:
        """Return a page with these forms; a large state is shown as an excerpt, with a notice."""
        if state.is_large:
            excerpt = await self.large.excerpt(state)
            state = excerpt_state(state, excerpt)
            shown = len(excerpt.document.triples)
            if shown < excerpt.total:
                words = f"This page shows the first {shown:,} of {excerpt.total:,} triples."
                notices = (*notices, Notice(words, link=NoticeLink("?format=ttl", "All of them, as Turtle")))
        may_read = permissions.may_read
        forms = [each.with_choices_of(may_read) if isinstance(each, ValueForm) else each for each in forms]
        page = resource.page(self.site_for(permissions), state, forms, self._csrf(resource, permissions), notices)
        if isinstance(page, bytes):
            return page
        if len(page.document.triples) <= _SHORT_PAGE:
            return render_page(page)
        return await asyncio.to_thread(render_page, page)

    def problem(self, exchange: Exchange, problem: Problem, url: str) -> Response | None:
        """Return a problem of the resource at `url` as a page for clients that prefer one, else None."""
        if choose_offer(exchange.accept, _PROBLEM_OFFERS) != "text/html":
            return None
        page = ProblemPage(
            self.site_for(exchange.permissions),
            problem.status,
            problem.title,
            problem.detail,
            url,
            problem.violations,
            problem.near,
            problem.quotes,
        )
        headers = {
            **problem.headers,
            **self.headers,
            "Vary": problem.headers.get("Vary", "Accept"),
            "Cache-Control": "no-store",
        }
        return Response(render_problem(page), problem.status, headers, "text/html; charset=utf-8")

    async def read_form(self, exchange: Exchange, resource: Resource) -> Form:
        """Check a posted form and turn the request into the one it stands for; return the form.

        Raises Problems (403 for a foreign form, 405 for a method without one), and InvalidForm for invalid values.
        """
        pairs = await self._pairs(exchange)
        token, method, typed = split_hidden(pairs)
        self.keys.require(token, _token_subject(resource.url, exchange.permissions))
        forms = await resource.forms()
        form = next((form for form in forms if form.method == method and not form.action), None)
        if form is None:
            raise resource.not_allowed(method or "POST")
        query, fields = split_query(typed) if isinstance(form, HoldForm | DeleteForm) else ({}, typed)
        try:
            value = _value(form, fields)
        except LoweringError as error:
            raise InvalidForm(form, typed, problem_of_body(error)) from error
        body = b"" if value is None else json.dumps(value).encode()
        exchange.override(form.method, "application/json", body, query)
        exchange.typed = typed
        return form

    async def form_errors(
        self, resource: Resource, refusal: InvalidForm, permissions: Permissions = ALLOW_ALL
    ) -> Response:
        """Return the page with the submitted form and its errors, next to the fields they concern.

        Raises the problem itself if there is no page to show it on.
        """
        form, problem = refusal.form, refusal.problem
        if isinstance(form, DeleteForm):
            raise problem
        fields = problem.violations if problem.status == 422 else ()
        notice = Notice(
            _sentence(len(fields)) if fields else problem.with_quotes, NoticeLevel.ERROR, problem.violations
        )
        if isinstance(form, ChoiceForm):
            again = await resource.forms()
        else:
            again = [replace(form, submitted=refusal.submitted, violations=fields)]
        try:
            state = await resource.state()
            state = state if permissions.is_unrestricted else resource.redact(state, permissions)
        except Problem:
            raise problem from None
        body = await self._page(resource, state, again, [notice], permissions)
        headers = {**problem.headers, **self.headers, "Cache-Control": "no-store"}
        return Response(body, problem.status, headers, "text/html; charset=utf-8")

    async def with_notice(self, resource: Resource, sentence: str, permissions: Permissions = ALLOW_ALL) -> Response:
        """Return the page with a notice, after a form was accepted with a reservation (202)."""
        state = await resource.state()
        state = state if permissions.is_unrestricted else resource.redact(state, permissions)
        body = await self.page(resource, state, [Notice(sentence, NoticeLevel.WARNING)], permissions)
        return Response(body, 202, {**self.headers, "Cache-Control": "no-store"}, "text/html; charset=utf-8")

    def receipt_notices(self, id: str, permissions: Permissions) -> Sequence[Notice]:
        """Return notices about the outcome of a write by its receipt, if the reader may see it."""
        try:
            receipt = self.receipts.find(id).receipt
        except NoSuchReceipt:
            return ()
        agent, url = permissions.agent, self.space.activity(id)
        href = self.site_for(permissions).href(url)
        if href is None and (agent == ANONYMOUS or agent.name != receipt.agent):
            return ()
        return (receipt_notice(receipt, None if href is None else NoticeLink(href, "Receipt")),)

    def referring_url(self, exchange: Exchange) -> str | None:
        """Return the URL of the page with the submitted form (RFC 9110 10.1.3), under the base of this server.

        None if the request does not state it.
        """
        space = self.session.space
        try:
            path = urlsplit(exchange.header("referer") or "").path
        except ValueError:
            return None
        return space.base + path[len(space.path) :].lstrip("/") if path.startswith(space.path) else None

    async def _pairs(self, exchange: Exchange) -> list[tuple[str, str]]:
        try:
            text, codec = (await exchange.raw_body()).decode("ascii"), exchange.codec
            read = partial(parse_qsl, text, True, encoding=codec, errors="strict", max_num_fields=_MAX_FIELDS)
            return read() if len(text) <= _SMALL_FORM else await asyncio.to_thread(read)
        except (UnicodeDecodeError, ValueError) as error:
            raise Problem(400, f"The form cannot be read: {error}.") from error

    def _csrf(self, resource: Resource, permissions: Permissions) -> Csrf:
        """Return the tokens for the forms of a page, each for a URL and the agent that reads the page."""
        return lambda action: self.keys.token(_token_subject(action or resource.url, permissions))


def _token_subject(url: str, permissions: Permissions) -> str:
    """Return the subject of a form's token: a URL, and the agent if it is known."""
    return f"{url} {permissions.cache_key}" if permissions.cache_key else url


class InvalidForm(Exception):
    """A form has invalid values, or its request was refused."""

    def __init__(self, form: Form, typed: Sequence[tuple[str, str]], problem: Problem) -> None:
        super().__init__(problem.detail)
        self.form = form
        self.submitted = tuple(typed)
        self.problem = problem


def _sentence(count: int) -> str:
    return f"Nothing was sent: {count} field{'s are' if count != 1 else ' is'} invalid."


def _value(form: Form, typed: Sequence[tuple[str, str]]) -> object:
    if isinstance(form, DeleteForm):
        return None
    if isinstance(form, EditForm):
        return parse_edit(typed)
    if isinstance(form, CopyForm):
        return parse_copy(typed)
    if isinstance(form, ChoiceForm):
        return parse_choice(form.name, typed)
    if form.choices is None:
        return parse_value(form.shape, typed)
    value = parse_value(form.shape, [pair for pair in typed if pair[0] != CHOICE_FIELD])
    assert isinstance(value, dict)
    field, names = form.choices.field, [name for each, name in typed if each == CHOICE_FIELD]
    return {**value, field: " ".join([str(value[field]), *names])}


def _moment(nanoseconds: int) -> str:
    return datetime.fromtimestamp(nanoseconds / 1e9, timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")
