"""HTTP methods on any resource: Allow, negotiation, preconditions, preferences (RFC 9110, LDP 4.2)."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.ontology.body import BodyError
from rosld.ontology.lower import LoweringError
from rosld.ontology.serialize import CannotCarry, Syntax, serialize
from rosld.ontology.urls import Location, Space
from rosld.server.auth import enforcement
from rosld.server.auth.errors import invalid_token
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.auth.redaction.problems import redact_problem
from rosld.server.events import query_params
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.event_stream import HEADERS, EventStream, StreamEnd, StreamFormat
from rosld.server.events.long_poll import wait_for_state
from rosld.server.events.motion_stream import MotionStream
from rosld.server.events.until import Until
from rosld.server.html import Notice
from rosld.server.http import link, negotiation
from rosld.server.http.charset import FORM
from rosld.server.http.conditional import ETag, check_preconditions, digest
from rosld.server.http.problem import Problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.file_response import file_stream
from rosld.server.rest.formats import FORMATS, HTML, JSON, OFFERS, VARIANTS
from rosld.server.rest.keyed_lock import KeyedLock
from rosld.server.rest.large import LargeDocuments
from rosld.server.rest.motion import Motion
from rosld.server.rest.pages import InvalidForm, PageRenderer
from rosld.server.rest.raw_response import RawResponse
from rosld.server.rest.resource import LDP, Answer, CreatedAnswer, Resource, ShownAnswer, allow_field
from rosld.server.rest.resource_headers import ACCEPT_FIELDS, rendered, resource_headers
from rosld.server.rest.ros_problems import problem_of, problem_of_body
from rosld.server.rest.state import Rendering, State
from rosld.server.storage import StorageError

_JSON_IS_JSONLD = {JSON: Syntax.JSON_LD.media_type}


@dataclass(frozen=True, slots=True)
class Dispatcher:
    """Answers requests on resources. `instance_id` tells this run of the server from others in ETags.

    `near` finds the URLs near one at which there is nothing.
    """

    instance_id: str
    pages: PageRenderer
    broadcasters: Broadcasters
    keyed_lock: KeyedLock
    large: LargeDocuments
    near: Callable[[str], Sequence[str]]

    async def answer(self, exchange: Exchange, resource: Resource) -> Response:
        """The response to a request on a resource; raises Problems. Either says what it is (LDP 4.2.1.4)."""
        try:
            resource = await resource.select_variant(exchange)
            await resource.prepare()
            if not exchange.permissions.is_unrestricted:
                self._permissions(exchange, resource)
                exchange.answering = resource
            response = await self._answer(exchange, resource)
        except (BodyError, LoweringError, RosError, Problem) as error:
            raise self._with_near(exchange, resource, _linked(resource, _problem(error))) from error
        if response.status_code == 204 and resource.links and b"link" not in dict(response.raw_headers):
            response.raw_headers = [*response.raw_headers, (b"link", rendered(resource.links).encode("latin-1"))]
        return response

    def _with_near(self, exchange: Exchange, resource: Resource, problem: Problem) -> Problem:
        """A 404 with the URLs that are near; who may not read everything is not told what there is in its place."""
        if problem.status == 404 and exchange.permissions.may_read_all:
            problem.near = tuple(self.near(resource.url))
        return problem

    def _permissions(self, exchange: Exchange, resource: Resource) -> None:
        """Refuse what who asks may not do here. A form is judged once it has said what it means."""
        if not _is_form(exchange, resource):
            enforcement.authorize(exchange.permissions, exchange.method, self._place(exchange), resource)

    def _place(self, exchange: Exchange) -> Location | None:
        return enforcement.location_of(exchange.request.scope, self.pages.space)

    async def _answer(self, exchange: Exchange, resource: Resource) -> Response:
        method = exchange.method
        if method in ("GET", "HEAD"):
            return await self.read(exchange, resource)
        if method == "OPTIONS":
            return Response(status_code=204, headers=options(resource, await resource.current_methods()))
        if _is_form(exchange, resource):
            return await self._form(exchange, resource)
        if method not in resource.methods():
            raise Problem(405, resource.deny_reason(method), headers={"Allow": allow_field(resource)})
        try:
            _refuse_partial_put(exchange)
            _check_media_type(exchange, resource)
            if method != "DELETE" and not resource.streams_body(exchange):
                await exchange.raw_body()  # before the preconditions: nothing is to come between them and the write
            answer = await self._write(exchange, resource)
        except (BodyError, LoweringError, Problem) as error:
            raise _constrained(resource, error) from error
        if isinstance(answer, CreatedAnswer):
            return await self._create(exchange, resource, answer)
        if isinstance(answer, ShownAnswer):
            return await self._shown(exchange, answer)
        return await self._as_preferred(exchange, resource, answer)

    async def _write(self, exchange: Exchange, resource: Resource) -> Answer:
        """What a write comes to; what is conditional, or depends on what is there, is carried out alone."""
        write = _VERBS[exchange.method]
        exchange.audit.begin()
        if not exchange.is_conditional and exchange.method not in resource.in_turn:
            return await write(resource, exchange)
        async with self.keyed_lock.acquire(resource.url):
            if exchange.is_conditional:
                await self._check_preconditions(exchange, resource)
            return await write(resource, exchange)

    async def read(self, exchange: Exchange, resource: Resource) -> Response:
        """GET and HEAD."""
        special = await resource.custom_get(exchange)
        if isinstance(special, Motion):
            return self._motion(exchange, resource, special)
        if special is not None:
            return special
        if query_params.stream_is_preferred(exchange.accept, OFFERS):
            return await self._stream(exchange, resource)
        state = await resource.state()
        unchanged = False
        if b"until=" in exchange.request.scope["query_string"] and "until" in exchange.query:
            state, holds = await self._wait_until(exchange, resource, state)
            if not holds:
                return self._unmet(exchange, resource, state)
        elif b"after=" in exchange.request.scope["query_string"] and "after" in exchange.query:
            await self._wait_for_another(exchange, resource, state)
            if not exchange.auth.is_valid():
                raise invalid_token("Your rights have changed meanwhile.")
            state = await resource.state()
            unchanged = query_params.is_state(exchange.query["after"], self._name(state))
        media_type = negotiate(exchange)
        if state.is_large and media_type != HTML and not (media_type == JSON and state.plain is not None):
            return await self._read_large(exchange, resource, state, media_type, unchanged=unchanged)
        notices = self._notices(exchange, media_type)
        rendering = await self.represented(resource, state, media_type, exchange.permissions, notices)
        headers = rendering.headers
        if state.received_ns is not None:
            age = max(0, time.time_ns() - state.received_ns) // 1_000_000_000
            headers = [*headers, (b"age", b"%d" % age)]
        if unchanged or _not_modified(exchange, rendering):
            return RawResponse(304, b"", [pair for pair in headers if pair[0] not in _CONTENT])
        return RawResponse(200, rendering.body, headers)

    async def _wait_until(self, exchange: Exchange, resource: Resource, state: State) -> tuple[State, bool]:
        """The state of which `?until=` holds, once there is one; what it is like after `?timeout=`, and whether."""
        until, seconds = self._until(exchange, resource), query_params.parse_timeout(exchange.query)
        after = exchange.query.get("after")

        def is_wanted(found: State) -> bool:
            return until.holds(found) and not query_params.is_state(after, self._name(found))

        if is_wanted(state):
            return state, True
        found = await wait_for_state(self.broadcasters, resource, is_wanted, exchange.request, seconds)
        if not exchange.auth.is_valid():
            raise invalid_token("Your rights have changed meanwhile.")
        if isinstance(found, Problem):
            raise found
        return (found, True) if found is not None else (await resource.state(), False)

    def _until(self, exchange: Exchange, resource: Resource) -> Until:
        return Until(exchange.query["until"], partial(redacted_state, resource, permissions=exchange.permissions))

    def _unmet(self, exchange: Exchange, resource: Resource, state: State) -> Response:
        """204: the time is over, and this is the state that the resource is in, by its name."""
        media_type = negotiate(exchange)
        etag = str(ETag(self._name(state), _variant(media_type, exchange.permissions) + state.part))
        headers = _headers(resource, state, media_type, etag)
        del headers["content-type"]
        return RawResponse(204, b"", _encode({**headers, "content-location": link.to_uri(resource.url)}))

    async def _read_large(
        self, exchange: Exchange, resource: Resource, state: State, media_type: str, *, unchanged: bool
    ) -> Response:
        """GET and HEAD of what is large: from a file that a worker process makes; HEAD makes none.

        Without a representation nothing tells its length, and HEAD may leave that out (RFC 9110 9.3.2).
        """
        permissions = exchange.permissions
        variant = _variant(media_type, permissions)
        syntax = _JSON_IS_JSONLD.get(media_type, media_type)
        etag = str(ETag(self._name(state), variant + state.part))
        headers = _headers(resource, state, media_type, etag)
        if unchanged or _not_modified(exchange, Rendering(b"", [], etag)):
            return RawResponse(304, b"", _encode({name: headers[name] for name in headers if name != "content-type"}))
        if exchange.method == "HEAD":
            return RawResponse(200, b"", _encode(headers))
        try:
            file, size = await self.large.file(
                (resource.url, etag, syntax), redacted_state(resource, state, permissions), syntax
            )
        except CannotCarry as error:
            raise _cannot_carry(media_type, error) from error
        return file_stream(_encode({**headers, "content-length": str(size)}), file, size)

    async def rendering(self, exchange: Exchange, resource: Resource, state: State) -> Rendering:
        """The representation that the request prefers, kept with the state or made now. Raises a 406 Problem."""
        return await self.represented(resource, state, negotiate(exchange), exchange.permissions)

    def _notices(self, exchange: Exchange, media_type: str) -> Sequence[Notice]:
        """What a page says of the write that led to it (`?receipt=`)."""
        if media_type != HTML or b"receipt=" not in exchange.request.scope["query_string"]:
            return ()
        return self.pages.receipt_notices(exchange.query.get("receipt", ""), exchange.permissions)

    async def represented(
        self,
        resource: Resource,
        state: State,
        media_type: str,
        permissions: Permissions = ALLOW_ALL,
        notices: Sequence[Notice] = (),
    ) -> Rendering:
        """The representation in a media type, kept with the state or made now. Raises a 406 Problem.

        Bytes are shared by agents of the same rights; a page, which has forms, is one agent's, and with `notices` it is
        made for one reader.
        """
        variant = _variant(media_type, permissions)
        if not permissions.is_unrestricted:
            state = redacted_state(resource, state, permissions)
        if media_type == HTML and (self.pages.version is not None or notices):
            return await self._render(resource, state, media_type, variant, permissions, notices)
        found = state.renderings.get(variant)
        if found is None:
            if len(state.renderings) >= _MAX_RENDERINGS:
                state.renderings.clear()
            found = state.renderings[variant] = await self._render(resource, state, media_type, variant, permissions)
        return found

    async def _render(
        self,
        resource: Resource,
        state: State,
        media_type: str,
        variant: str,
        permissions: Permissions,
        notices: Sequence[Notice] = (),
    ) -> Rendering:
        if media_type == HTML:
            body = await self.pages.page(resource, state, notices, permissions)
        elif media_type == JSON and state.plain is not None:
            body = state.plain()
        elif state.is_large:
            raise Problem(406, "This is too large to be sent here: GET it, or follow it by its notifications.")
        elif state.is_long:
            body = await asyncio.to_thread(_serialize, state, _JSON_IS_JSONLD.get(media_type, media_type))
        else:
            body = _serialize(state, _JSON_IS_JSONLD.get(media_type, media_type))
        name = f"{self.instance_id}-{digest(body)}" if media_type == HTML else self._name(state)  # a page shows more
        etag = str(ETag(name, variant + state.part))
        headers = {**_headers(resource, state, media_type, etag), "content-length": str(len(body))}
        if media_type == HTML:
            headers |= self.pages.headers
        return Rendering(body, _encode(headers), etag)

    def _name(self, state: State) -> str:
        """The state part of the ETags of a state's representations."""
        return f"{state.scope or self.instance_id}-{state.tag}"

    async def _stream(self, exchange: Exchange, resource: Resource) -> Response:
        """The changes of a resource as an event stream. What can be refused is refused before it begins."""
        media_type = _told_as(exchange)
        rate = query_params.parse_rate(exchange.query)

        notices = self._notices(exchange, media_type)

        async def render(state: State) -> bytes:
            return (await self.represented(resource, state, media_type, exchange.permissions, notices)).body

        first, until, seconds = await resource.state(), None, None
        await render(first)
        if "until" in exchange.query:
            until = self._until(exchange, resource)
            until.holds(first)  # for what it refuses
            seconds = query_params.parse_timeout(exchange.query) if "timeout" in exchange.query else None
        self.broadcasters.require_capacity(exchange.request.client)
        headers = _encode(resource_headers(resource))
        if exchange.method == "HEAD":
            return RawResponse(200, b"", [*HEADERS, *headers])
        mark = exchange.permissions.cache_key if media_type == HTML else ""
        told = "".join(notice.text for notice in notices)
        variant = f"{VARIANTS[media_type]}-{exchange.permissions.rights_key}{mark}{told}"
        redact = partial(redact_problem, permissions=exchange.permissions, place=self._place(exchange))
        stream_format = StreamFormat(variant, render, self._name, exchange.auth.is_valid, redact)
        if media_type == HTML:
            stream_format = replace(stream_format, version=lambda: self.pages.version)
        known, lease = exchange.header("last-event-id"), resource.keep_alive(exchange)
        end = None if until is None else StreamEnd(until.holds, seconds)
        return EventStream(self.broadcasters, resource, stream_format, rate, known, headers, lease, end)

    def _motion(self, exchange: Exchange, resource: Resource, motion: Motion) -> Response:
        """Pictures that replace each other, as fast as they are taken. What can be refused was before."""
        rate = query_params.parse_rate(exchange.query)
        self.broadcasters.require_capacity(exchange.request.client)
        stream = MotionStream(
            self.broadcasters, motion, rate, _encode(resource_headers(resource)), exchange.auth.is_valid
        )
        return RawResponse(200, b"", stream.raw_headers) if exchange.method == "HEAD" else stream

    async def _wait_for_another(self, exchange: Exchange, resource: Resource, state: State) -> None:
        """Until the state is another than `?after=`, at most `?timeout=`."""
        after, seconds = exchange.query["after"], query_params.parse_timeout(exchange.query)
        if query_params.is_state(after, self._name(state)):

            def is_another(found: State) -> bool:
                return not query_params.is_state(after, self._name(found))

            await wait_for_state(self.broadcasters, resource, is_another, exchange.request, seconds)

    async def _check_preconditions(self, exchange: Exchange, resource: Resource) -> None:
        """If-Match and If-None-Match of a write (RFC 9110 13.1), judged against the resource as it is now."""
        if_match, if_none_match = exchange.header("if-match"), exchange.header("if-none-match")
        try:
            state: State | None = await resource.state()
        except Problem as problem:
            if problem.status not in (404, 410):
                raise
            state = None
        current = None if state is None else ETag(self._name(state), "any")
        check_preconditions(exchange.method, current, if_match=if_match, if_none_match=if_none_match)

    async def _form(self, exchange: Exchange, resource: Resource) -> Response:
        """A form of one of our pages: the write it means, then the way back to a page (303)."""
        try:
            form = await self.pages.read_form(exchange, resource)
            if not exchange.permissions.is_unrestricted:
                enforcement.authorize(exchange.permissions, form.method, self._place(exchange), resource)
            exchange.audit.begin()
            try:
                answer = await _VERBS[form.method](resource, exchange)
            except (LoweringError, RosError, Problem) as error:
                problem = _problem(error)
                if problem.status not in _TOLD_ON_THE_PAGE:
                    raise
                raise InvalidForm(form, exchange.typed, problem) from error
        except InvalidForm as refusal:
            exchange.audit.set_refusal(refusal.problem.detail)
            return await self.pages.form_errors(resource, refusal, exchange.permissions)
        if isinstance(answer, Response) and answer.status_code == 202 and form.method != "DELETE":
            return await self.pages.with_notice(
                resource, "It was published, but no subscriber was there to get it.", exchange.permissions
            )
        back = _back(resource, answer, self.pages.referring_url(exchange), self.pages.space)
        if form.method == "DELETE" and not (isinstance(answer, Response) and answer.status_code == 202):
            back = resource.url.rstrip("/").rpartition("/")[0] + "/"
        exchange.audit.leads_to_page = True
        return Response(status_code=303, headers={"Location": link.to_uri(back)})

    async def _create(self, exchange: Exchange, resource: Resource, created: CreatedAnswer) -> Response:
        """201 with the new resource as body (RFC 9110 15.3.2), or without where less is preferred.

        It says also what that is which the request was sent to (LDP 5.2.1.4).
        """
        headers = [(b"location", link.to_uri(created.location).encode("ascii"))]
        is_member = created.location != resource.url
        links, rendering = created.links, None
        if created.state is not None and not exchange.prefer.minimal:
            rendering = await self._outcome(exchange, created.resource, created.state, answer=is_member)
        if rendering is None:
            links = (*(resource if is_member else created.resource).links, *links)
            if links:
                headers.append((b"link", link.render(links).encode("latin-1")))
            headers.append((b"content-length", b"0"))
            if exchange.prefer.minimal:
                headers.append((b"preference-applied", b"return=minimal"))
            return RawResponse(201, b"", headers)
        if is_member:
            types = (replace(each, anchor=resource.url) for each in resource.links if each.rel == "type")
            links = (*links, *types)
        if links:
            headers.append((b"link", link.render(links).encode("latin-1")))
        return RawResponse(201, rendering.body, [*rendering.headers, *headers, (b"content-location", headers[0][1])])

    async def _shown(self, exchange: Exchange, shown: ShownAnswer) -> Response:
        """200 with the representation of the resource that shows it (RFC 9110 8.7), or 204 where less is preferred."""
        location = (b"content-location", link.to_uri(shown.resource.url).encode("ascii"))
        added = [(b"link", link.render(shown.links).encode("latin-1"))] if shown.links else []
        if exchange.prefer.minimal:
            return RawResponse(204, b"", [location, *added, (b"preference-applied", b"return=minimal")])
        rendering = await self._outcome(exchange, shown.resource, shown.state)
        if rendering is None:
            return RawResponse(204, b"", [location, *added])
        headers = rendering.headers
        if exchange.method == "PUT":  # what was sent is not what was saved (RFC 9110 9.3.4)
            headers = [each for each in headers if each[0] != b"etag"]
        return RawResponse(200, rendering.body, [*headers, location, *added])

    async def _as_preferred(self, exchange: Exchange, resource: Resource, response: Response) -> Response:
        """The representation after a write instead of an empty 204, where the request prefers it (RFC 7240 4.2)."""
        if not exchange.prefer.representation or response.status_code != 204 or exchange.method == "DELETE":
            return response
        rendering = await self._outcome(exchange, resource)
        if rendering is None:
            return response
        headers = [*rendering.headers, (b"preference-applied", b"return=representation")]
        headers.append((b"content-location", link.to_uri(resource.url).encode("ascii")))
        return RawResponse(200, rendering.body, headers)

    async def _outcome(
        self, exchange: Exchange, resource: Resource, state: State | None = None, *, answer: bool = False
    ) -> Rendering | None:
        """What shows a write that was done; None where it cannot be had now, or not as preferred: it is not undone.

        What who asks may not read is not shown, unless it is the `answer` to what was asked, such as a call.
        """
        if not answer and not exchange.permissions.may_read(resource.url):
            return None
        try:
            return await self.rendering(exchange, resource, await resource.state() if state is None else state)
        except (Problem, RosError, StorageError):
            return None


def _variant(media_type: str, permissions: Permissions) -> str:
    """The variant part of the ETags of representations in a media type, for agents of these rights."""
    variant = (
        VARIANTS[media_type] if permissions.is_unrestricted else f"{VARIANTS[media_type]}-{permissions.rights_key}"
    )
    return variant + permissions.cache_key if media_type == HTML else variant


def _headers(resource: Resource, state: State, media_type: str, etag: str) -> dict[str, str]:
    """The headers of a representation, but for its length."""
    return {
        "content-type": f"{media_type}; charset=utf-8" if media_type.startswith("text/") else media_type,
        "etag": etag,
        "vary": "Accept",
        "cache-control": f"max-age={state.max_age}" if state.max_age else "no-cache",
        **resource_headers(resource, shapes=state.shapes),
        **state.headers,
    }


def _is_form(exchange: Exchange, resource: Resource) -> bool:
    """Whether it is a form of one of our pages."""
    return (
        exchange.method == "POST" and resource.takes_forms and (exchange.header("content-type") or "").startswith(FORM)
    )


def redacted_state(resource: Resource, state: State, permissions: Permissions) -> State:
    """A state as an agent may see it: made once for the same rights."""
    if permissions.is_unrestricted:
        return state
    found = state.redactions.get(permissions.rights_key)
    if found is None:
        if len(state.redactions) >= _MAX_RENDERINGS:
            state.redactions.clear()
        found = state.redactions[permissions.rights_key] = resource.redact(state, permissions)
    return found


_MAX_RENDERINGS = 64
"""Representations, and what they are made from, that are kept with a state."""
_REFUSED_BODIES = frozenset({400, 409, 415, 422})
_TOLD_ON_THE_PAGE = frozenset({409, 422, 423, 429, 502, 503, 504})
"""What may become of a form that was in order: the reader stays on its page."""
_CONTENT = (b"content-type", b"content-length")
_VERBS: Mapping[str, Callable[[Resource, Exchange], Awaitable[Answer]]] = {
    "PUT": lambda resource, exchange: resource.put(exchange),
    "POST": lambda resource, exchange: resource.post(exchange),
    "PATCH": lambda resource, exchange: resource.patch(exchange),
    "DELETE": lambda resource, exchange: resource.delete(exchange),
}


def _problem(error: BodyError | LoweringError | RosError | Problem) -> Problem:
    """The problem that an error comes to."""
    if isinstance(error, Problem):
        return error
    return problem_of(error) if isinstance(error, RosError) else problem_of_body(error)


def _back(resource: Resource, answer: Answer, came_from: str | None, space: Space) -> str:
    """Where a browser goes after a form: to what it made, or back to where it stood, which a cockpit always is."""
    cockpits = space.container("cockpit")
    if came_from is not None and came_from.startswith(cockpits) and not resource.url.startswith(cockpits):
        return came_from
    match answer:
        case CreatedAnswer():
            return answer.location
        case ShownAnswer():
            return answer.resource.url
        case _:
            return answer.headers.get("location") or came_from or resource.url


def _constrained(resource: Resource, error: BodyError | LoweringError | Problem) -> Problem:
    """The refusal of a body, with a link to what constrains it (LDP 4.2.1.6)."""
    problem = error if isinstance(error, Problem) else problem_of_body(error)
    if problem.status in _REFUSED_BODIES and resource.constrained_by is not None:
        problem.headers["Link"] = link.render([link.Link(resource.constrained_by, f"{LDP}constrainedBy")])
    return problem


def _linked(resource: Resource, problem: Problem) -> Problem:
    """A refusal, with links to the types of the resource that refuses; what is not there has none."""
    if problem.status not in (404, 410) and resource.links:
        there = problem.headers.get("Link")
        problem.headers["Link"] = ", ".join([link.render(resource.links), *([there] if there else ())])
    return problem


def negotiate(exchange: Exchange) -> str:
    """The media type to answer with: `?format=` before Accept. Raises a 406 Problem naming what there is."""
    if b"format=" in exchange.request.scope["query_string"] and (wanted := exchange.query.get("format")):
        if wanted not in FORMATS:
            raise Problem(406, f"?format={wanted} is unknown; there are {', '.join(FORMATS)}.")
        return FORMATS[wanted]
    found = negotiation.choose(exchange.accept, OFFERS)
    if found is None:
        raise Problem(406, f"None of {exchange.accept!r} is offered; there are {', '.join(OFFERS)}.")
    return found


def _told_as(exchange: Exchange) -> str:
    """The media type of an event's data: plain JSON, or what `?format=` says. Raises a 406 Problem."""
    wanted = exchange.query.get("format", "json")
    if wanted not in FORMATS:
        raise Problem(406, f"?format={wanted} cannot be streamed; there are {', '.join(FORMATS)}.")
    return FORMATS[wanted]


def _encode(headers: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.encode("latin-1"), value.encode("latin-1")) for name, value in headers.items()]


def _not_modified(exchange: Exchange, rendering: Rendering) -> bool:
    if_none_match = exchange.header("if-none-match")
    if_match = exchange.header("if-match")
    if if_none_match is None and if_match is None:
        return False
    state, _, variant = rendering.etag.strip('"').rpartition(".")
    return check_preconditions(exchange.method, ETag(state, variant), if_match=if_match, if_none_match=if_none_match)


def _serialize(state: State, media_type: str) -> bytes:
    syntax = next(syntax for syntax in Syntax if syntax.media_type == media_type)
    try:
        return serialize(state.document, syntax)
    except CannotCarry as error:
        raise _cannot_carry(media_type, error) from error


def _cannot_carry(media_type: str, error: CannotCarry) -> Problem:
    return Problem(406, f"{media_type} cannot carry this resource: {error}")


def _refuse_partial_put(exchange: Exchange) -> None:
    """Raise a 400 Problem for a PUT of a part (RFC 9110 14.5), which would replace the whole."""
    if exchange.method == "PUT" and exchange.header("content-range") is not None:
        raise Problem(400, "PUT replaces the whole, and Content-Range sends a part of it: send all, or PATCH.")


def _check_media_type(exchange: Exchange, resource: Resource) -> None:
    accepted = resource.accepts.get(exchange.method)
    if accepted is None:
        return
    if exchange.header("content-type") is None and exchange.header("content-length") in (None, "0"):
        return
    if "*/*" in accepted and exchange.essence is not None:
        return
    if exchange.media_type not in accepted:
        headers = {ACCEPT_FIELDS[exchange.method]: ", ".join(accepted)}
        raise Problem(
            415, f"{exchange.method} takes {', '.join(accepted)} here, not {exchange.media_type}.", headers=headers
        )


def options(resource: Resource, methods: frozenset[str] | None = None) -> dict[str, str]:
    """The headers of an answer to OPTIONS; `methods` as in `standing_headers`."""
    return {**resource_headers(resource, methods), "vary": "Accept"}
