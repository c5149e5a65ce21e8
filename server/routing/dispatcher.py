"""HTTP methods on any resource: Allow, negotiation, preconditions, preferences (RFC 9110, LDP 4.2)."""

from __future__ import annotations

import time
from collections.abc import Awaitable
from functools import partial

from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.ontology.body import BodyError
from rosld.ontology.violations import LoweringError
from rosld.server.auth import enforcement
from rosld.server.auth.errors import invalid_token
from rosld.server.events import query_params
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.http.conditional import ETag
from rosld.server.http.problem import Problem
from rosld.server.resources.base import Services
from rosld.server.resources.find import near_urls
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import HTML, JSON, OFFERS
from rosld.server.rest.large import LargeDocuments
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.path_item import DRY_RUN
from rosld.server.rest.resource import Answer, CreatedAnswer, Motion, Resource, ShownAnswer
from rosld.server.rest.responses import RawResponse, rendered, resource_headers
from rosld.server.rest.state import State
from rosld.server.routing.observation import Observation
from rosld.server.routing.offers import Offers, wants_offer
from rosld.server.routing.representations import CONTENT_FIELDS, Representations, is_not_modified, negotiate
from rosld.server.routing.write_answers import (
    VERBS,
    KnownParameters,
    WriteAnswers,
    answer_dry_run,
    answer_form,
    check_media_type,
    is_form,
    problem_of_error,
    refuse_partial_put,
    with_constraint_link,
    with_type_links,
)
from rosld.server.runtime.tasks import KeyedLock


class Dispatcher:
    """Dispatcher of requests to the methods of resources."""

    def __init__(
        self,
        services: Services,
        pages: PageRenderer,
        broadcasters: Broadcasters,
        keyed_lock: KeyedLock,
        large: LargeDocuments,
    ) -> None:
        session = self._session = services.session
        self._representations = Representations(services.instance_id, pages, large)
        self._observation = Observation(self._representations, broadcasters, pages)
        self._write_answers = WriteAnswers(self._representations)
        self._offers = Offers(session)
        self._known_parameters = KnownParameters(session.lifting)
        self._pages = pages
        self._keyed_lock = keyed_lock
        self._near = partial(near_urls, services)

    def answer(self, exchange: Exchange, resource: Resource) -> Awaitable[Response]:
        """Return the response to a request on a resource, with its type links (LDP 4.2.1.4). Raises Problems.

        Problems have the links too.
        """
        if exchange.request.scope["query_string"] and exchange.method in VERBS and exchange.query_flag(DRY_RUN.name):
            return answer_dry_run(exchange, resource, self._session, lambda: self._respond(exchange, resource))
        return self._respond(exchange, resource)

    async def _respond(self, exchange: Exchange, resource: Resource) -> Response:
        query_string, target = exchange.request.scope["query_string"], resource
        try:
            resource = await resource.select_variant(exchange)
            await resource.prepare()
            if not exchange.permissions.is_unrestricted:
                self._authorize(exchange, resource)
                exchange.answering = resource
            if query_string and exchange.method != "OPTIONS" and not is_form(exchange, resource):
                self._known_parameters.require(exchange.method, query_string, target, resource)
            wanted = wants_offer(exchange)
            response = await (self._offers.answer if wanted else self._answer)(exchange, resource)
        except (BodyError, LoweringError, RosError, Problem) as error:
            raise self._with_near(exchange, resource, with_type_links(resource, problem_of_error(error))) from error
        if response.status_code == 204 and resource.links and b"link" not in dict(response.raw_headers):
            response.raw_headers = [*response.raw_headers, (b"link", rendered(resource.links).encode("latin-1"))]
        return response

    def _with_near(self, exchange: Exchange, resource: Resource, problem: Problem) -> Problem:
        """Add the URLs similar to a missing one to a 404, if the agent may read everything."""
        if problem.status == 404 and exchange.permissions.may_read_all:
            problem.near = tuple(self._near(resource.url))
        return problem

    def _authorize(self, exchange: Exchange, resource: Resource) -> None:
        """Raise a 401 or 403 Problem if the agent lacks permission; forms are authorized once they are parsed."""
        if not is_form(exchange, resource):
            enforcement.authorize(
                exchange.permissions,
                exchange.method,
                enforcement.location_of(exchange.request.scope, self._pages.space),
                resource,
            )

    async def _answer(self, exchange: Exchange, resource: Resource) -> Response:
        method = exchange.method
        if method in ("GET", "HEAD"):
            return await self.read(exchange, resource)
        if method == "OPTIONS":
            return Response(status_code=204, headers=options(resource, await resource.current_methods()))
        if is_form(exchange, resource):
            return await answer_form(self._pages, self._known_parameters, exchange, resource)
        if method not in resource.methods():
            raise resource.not_allowed(method)
        try:
            if exchange.format and not resource.has_own_formats:
                negotiate(exchange)  # nothing is written if the response could not be given
            refuse_partial_put(exchange)
            check_media_type(exchange, resource)
            if method != "DELETE" and not resource.streams_body(exchange):
                await exchange.raw_body()  # read first: nothing may happen between the preconditions and the write
            answer = await self._write(exchange, resource)
        except (BodyError, LoweringError, Problem) as error:
            raise with_constraint_link(resource, error) from error
        if isinstance(answer, CreatedAnswer):
            return await self._write_answers.created(exchange, resource, answer)
        if isinstance(answer, ShownAnswer):
            return await self._write_answers.shown(exchange, answer)
        return await self._write_answers.as_preferred(exchange, resource, answer)

    async def _write(self, exchange: Exchange, resource: Resource) -> Answer:
        """Run a write; conditional or state-dependent ones hold the lock of the URL."""
        write = VERBS[exchange.method]
        exchange.audit.begin()
        if not exchange.is_conditional and exchange.method not in resource.in_turn:
            return await write(resource, exchange)
        async with self._keyed_lock.acquire(resource.url):
            if exchange.is_conditional:
                await self._check_preconditions(exchange, resource)
            return await write(resource, exchange)

    async def read(self, exchange: Exchange, resource: Resource) -> Response:
        """Answer GET and HEAD (RFC 9110 9.3.1) with a representation or a stream, possibly after waiting for a change.

        Raises the Problems of the resource, 406, and 401 if the rights changed during the wait; and RosError.
        """
        special = await resource.custom_get(exchange)
        if isinstance(special, Motion):
            return self._observation.motion(exchange, resource, special)
        if special is not None:
            return special
        if query_params.stream_is_preferred(exchange.accept, OFFERS):
            return await self._observation.stream(exchange, resource)
        if query_string := exchange.request.scope["query_string"]:
            query_params.require_numbers(exchange.query)
        state = await resource.state()
        unchanged = False
        if b"until=" in query_string and "until" in exchange.query:
            state, holds = await self._observation.wait_until(exchange, resource, state)
            if not holds:
                return self._representations.unmet(exchange, resource, state)
        elif b"after=" in query_string and "after" in exchange.query:
            await self._observation.wait_for_another(exchange, resource, state)
            if not exchange.auth.is_valid():
                raise invalid_token("Your permissions have changed.")
            state = await resource.state()
            unchanged = query_params.is_state(exchange.query["after"], self._representations.name(state))
        media_type = negotiate(exchange)
        if state.is_large and media_type != HTML and not (media_type == JSON and state.plain is not None):
            return await self._representations.read_large(exchange, resource, state, media_type, unchanged=unchanged)
        notices = self._representations.receipt_notices(exchange, media_type)
        rendering = await self._representations.represent(resource, state, media_type, exchange.permissions, notices)
        headers = rendering.headers
        if state.received_ns is not None:
            age = max(0, time.time_ns() - state.received_ns) // 1_000_000_000
            headers = [*headers, (b"age", b"%d" % age)]
        if unchanged or is_not_modified(exchange, rendering):
            return RawResponse(304, b"", [pair for pair in headers if pair[0] not in CONTENT_FIELDS])
        return RawResponse(200, rendering.body, headers)

    async def _check_preconditions(self, exchange: Exchange, resource: Resource) -> None:
        """Raise a 412 Problem if If-Match or If-None-Match of a write fail now (RFC 9110 13.1)."""
        try:
            state: State | None = await resource.state()
        except Problem as problem:
            if problem.status not in (404, 410):
                raise
            state = None
        current = None if state is None else ETag(self._representations.name(state), "any")
        exchange.check_preconditions(current)


def options(resource: Resource, methods: frozenset[str] | None = None) -> dict[str, str]:
    """Return the headers of a response to OPTIONS; `methods` as in `resource_headers`."""
    return {**resource_headers(resource, methods), "vary": "Accept"}
