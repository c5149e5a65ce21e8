"""Pages and their forms: how a browser reads resources and writes to them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl

from starlette.responses import Response

from rosld.adapters.model import Stale
from rosld.ontology.lower import LoweringError
from rosld.server import html
from rosld.server.html import DeleteForm, Form, Notice, ParameterForm, ProblemPage, Site
from rosld.server.html.page import Tone
from rosld.server.html.site import SECTIONS
from rosld.server.http import negotiation
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.state import State

if TYPE_CHECKING:
    from rosld.server.ldp.resource import Resource
    from rosld.server.robot import Robot

FORM = "application/x-www-form-urlencoded"
_PROBLEM_OFFERS = ("application/problem+json", "application/json", "text/turtle", "application/ld+json", "text/html")
_MOST_FIELDS = 10_000


class Pages:
    """Draws the pages of one robot's resources."""

    headers: Mapping[str, str] = {name.lower(): value for name, value in html.HEADERS.items()}

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def site(self) -> Site:
        """What every page says of this server."""
        robot = self._robot
        state = robot.graph.state
        stale = f"since {_moment(state.since_ns)}: {state.why}" if isinstance(state, Stale) else None
        return Site(
            robot.space.base,
            robot.name,
            robot.adapter.capabilities.system,
            stale,
            robot.settings.read_only,
            (*SECTIONS, "bags") if robot.adapter.recordings else SECTIONS,
            robot.space.types,
        )

    async def page(self, resource: Resource, state: State, notices: Sequence[Notice] = ()) -> bytes:
        """The page of a resource as it is."""
        return resource.page(self.site, state, await resource.forms(), self._token(resource), notices)

    def problem(self, exchange: Exchange, problem: Problem) -> Response | None:
        """A problem as a page, for those who prefer one; None for all others."""
        if negotiation.choose(exchange.accept, _PROBLEM_OFFERS) != "text/html":
            return None
        url = str(exchange.request.url.path)
        page = ProblemPage(self.site, problem.status, problem.title, problem.detail, url, problem.violations)
        headers = {**problem.headers, **self.headers, "Vary": "Accept", "Cache-Control": "no-store"}
        return Response(html.render_problem(page), problem.status, headers, "text/html; charset=utf-8")

    async def meant(self, exchange: Exchange, resource: Resource) -> Form:
        """Check a posted form and turn the request into the one it means; the form, for `refused`.

        Raises Problems (403 for a foreign form, 400 for one without a method) and Refused where it does not fit.
        """
        pairs = await self._pairs(exchange)
        token, method, typed = html.split_hidden(pairs)
        self._robot.forms.require(token, resource.url)
        form = next((form for form in await resource.forms() if form.method == method), None)
        if form is None:
            raise Problem(405, resource.why_not(method or "POST"), headers={"Allow": ", ".join(resource.methods())})
        try:
            value = _value(form, typed)
        except LoweringError as error:
            raise FormRefused(form, typed, error) from error
        exchange.become(form.method, "application/json", b"" if value is None else json.dumps(value).encode())
        exchange.typed = typed
        return form

    async def refused(self, resource: Resource, refusal: FormRefused) -> Response:
        """The page again with the form as it was filled in, and what does not fit beside its fields (422)."""
        form = refusal.form
        if isinstance(form, DeleteForm):
            raise refusal.error
        count = len(refusal.error.violations)
        sentence = f"Nothing was sent: {count} field{'s do' if count != 1 else ' does'} not fit."
        notice = Notice(sentence, Tone.ERROR, tuple(refusal.error.violations))
        again = form.refilled(refusal.typed, refusal.error.violations)
        body = resource.page(self.site, await resource.state(), [again], self._token(resource), [notice])
        return Response(body, 422, {**self.headers, "Cache-Control": "no-store"}, "text/html; charset=utf-8")

    async def told(self, resource: Resource, sentence: str) -> Response:
        """The page with a notice, after a form that was carried out with a reservation (202)."""
        body = await self.page(resource, await resource.state(), [Notice(sentence, Tone.WARNING)])
        return Response(body, 202, {**self.headers, "Cache-Control": "no-store"}, "text/html; charset=utf-8")

    async def _pairs(self, exchange: Exchange) -> list[tuple[str, str]]:
        try:
            text = (await exchange.body()).decode("ascii")
            return parse_qsl(text, keep_blank_values=True, errors="strict", max_num_fields=_MOST_FIELDS)
        except (UnicodeDecodeError, ValueError) as error:
            raise Problem(400, f"The form cannot be read: {error}.") from error

    def _token(self, resource: Resource) -> str:
        return self._robot.forms.token(resource.url)


class FormRefused(Exception):
    """What was typed into a form does not fit."""

    def __init__(self, form: Form, typed: Sequence[tuple[str, str]], error: LoweringError) -> None:
        super().__init__(str(error))
        self.form = form
        self.typed = tuple(typed)
        self.error = error


def _value(form: Form, typed: Sequence[tuple[str, str]]) -> object:
    if isinstance(form, DeleteForm):
        return None
    if isinstance(form, ParameterForm):
        return html.parse_parameter(typed)
    return html.parse_form(form.schema, typed)


def _moment(nanoseconds: int) -> str:
    return datetime.fromtimestamp(nanoseconds / 1e9, timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")
