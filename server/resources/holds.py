"""Holds: POST of a message to a topic holds it, PATCH of the hold renews it, DELETE ends it."""

from __future__ import annotations

import contextlib
import socket
import sys
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from typing import ClassVar, cast
from urllib.parse import urljoin, urlsplit

import orjson
from msgspec.structs import replace
from pyoxigraph import NamedNode
from starlette.responses import Response

from rosld.adapters.model import Message, MessageSchema, RosError
from rosld.ontology.body import index_triples, parse_json
from rosld.ontology.describe_holds import (
    LEASE,
    MAX_LEASE,
    MAX_RATE,
    MEANINGS,
    MIN_OF_HOLDS,
    RATE,
    HoldView,
    hold_document,
)
from rosld.ontology.document import Document
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.lower import find_message, lowerer
from rosld.ontology.neutral_message import COMMANDS, TWISTS, with_zeros
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError
from rosld.server.auth.errors import not_found
from rosld.server.html.forms import DeleteForm, Form, HoldForm, HoldTerms, drive_pad
from rosld.server.html.inputs import Json
from rosld.server.http.fields import parse_decimal
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.hypermedia.json_schema import ANYTHING, TEXT, URI, JsonSchema, MessageSchemas, json_object, nullable
from rosld.server.patches.patch import merge_patch
from rosld.server.resources.base import Services
from rosld.server.resources.limit_checks import STRICTNESS
from rosld.server.resources.named_resource import KeptResource
from rosld.server.resources.publisher import PublishingResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, MERGE_PATCH, RDF_BODIES
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import Answer, CreatedAnswer, Find, Resource
from rosld.server.rest.responses import offer_url
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State
from rosld.server.robot.hold_store import HeldMessage, Hold, held_message, new_hold
from rosld.server.robot.session import Session
from rosld.server.robot.velocity import passes_stop, zero_message
from rosld.server.robot.write_policy import PublishLimiter
from rosld.server.runtime.dry_run import expect_status
from rosld.server.runtime.version_cache import IdentityKey
from rosld.shapes.value import Bounds, MessageShape

ZERO, NONE = "zero", "none"
_FORM_TIME = 5.0
"""Default duration in seconds of a hold started with a form."""


async def create_hold(exchange: Exchange, topic: PublishingResource) -> Answer:
    """Carry out a POST to a topic and return the created hold. Raises Problems and LoweringError."""
    session, name = topic.session, topic.name
    rate, (lease, is_timed) = _rate(exchange, session.limiter), _lease(exchange, session) or (LEASE, False)
    if rate is None and not topic.commands_velocity:
        raise Problem(400, f"Give a publish rate: ?rate=10 for ten times per second ({_RATES}).")
    rate = rate or min(RATE, session.limiter.rate)
    schema, message = await topic.read_message(exchange)
    await topic.require_within_limits(schema, message)
    held = _command(session, name, schema, message, restamp=False)
    then, then_requested = await _then(exchange.query.get("then"), topic, held, _readable(topic.services, exchange))
    exchange.audit.add_step(f"hold {name} at {rate:g} Hz, unrenewed for {lease:g} s", topic.url)
    begun = await topic.services.holds.start(
        new_hold(name, exchange.agent, rate, lease, held, then, then_requested, is_timed=is_timed)
    )
    resource = HoldResource(topic.services, begun.id)
    return CreatedAnswer(resource.url, resource, resource.state_of(begun))


_POSITIVE: JsonSchema = {"type": "number", "minimum": MIN_OF_HOLDS}
_KEEP = QueryParameter("keep", "Whether the hold lasts as long as the requested event stream.", {"type": "boolean"})


def hold_parameters(longest: float, required: str = "") -> tuple[QueryParameter, ...]:
    """Return the query parameters to start or change a hold; `longest` is the maximum of `for` in seconds."""
    most = {"rate": MAX_RATE, "lease": MAX_LEASE, "for": longest}
    return tuple(
        QueryParameter(
            name, about, {**_POSITIVE, "maximum": most[name]} if name in most else TEXT, required=name == required
        )
        for name, about in MEANINGS.items()
    )


def hold_schema(schemas: MessageSchemas, schema: MessageSchema | None) -> JsonSchema:
    """Return the JSON schema of a hold's state for messages of a type."""
    number: JsonSchema = {"type": "number"}
    words: JsonSchema = {
        "id": TEXT,
        "url": URI,
        "offer": URI,
        "topic": TEXT,
        "holder": TEXT,
        "rate": number,
        "lease": number,
    }
    message = ANYTHING if schema is None else schemas.read(schema)
    rest: JsonSchema = {"for": nullable(number), "then": TEXT, "kept": {"type": "boolean"}, "trouble": nullable(TEXT)}
    return json_object(optional={**words, **rest, "message": message})


def hold_form(
    session: Session, topic: str, schema: MessageSchema, latest: Json, bounds: Mapping[str, Bounds]
) -> HoldForm:
    """Return the form that holds a topic, with a pad for velocity commands."""
    lifted = lifter(schema, session.lifting).json(zero_message(schema, session.lifting), session.space.topic(topic))
    zero = cast(Json, parse_json(lifted))
    is_velocity = schema.ref.name in TWISTS
    most, longest = min(MAX_RATE, session.limiter.rate), session.settings.hold_time
    return HoldForm(
        shape=MessageShape(schema, schema.type.fields, bounds),
        method="POST",
        button="Hold",
        terms=HoldTerms(min(RATE, most), most, min(_FORM_TIME, longest), longest, ZERO if is_velocity else NONE),
        title=f"Drive by {topic}" if schema.ref.name in COMMANDS else "Hold the topic",
        about="It is published at that rate for that many seconds, or until you end the hold on its page.",
        value=zero if is_velocity else latest,
        pad=drive_pad(topic, schema, bounds, zero, session.limiter.rate),
    )


class HoldResource(KeptResource[Hold]):
    """One hold of a topic."""

    kind = shape = "Hold"
    url_of = Space.hold
    store_of = attrgetter("holds")
    writes: ClassVar[frozenset[str]] = frozenset({"PATCH", "DELETE"})
    accepts: Mapping[str, Sequence[str]] = {"PATCH": (JSON, MERGE_PATCH, *RDF_BODIES)}

    def gone_words(self, error: LookupError) -> str:
        return f"has ended: {error}"

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        renew = WriteMethod(
            "Renews the lease; a body also replaces the message, without a gap.",
            ANYTHING,
            is_body_required=False,
            done=(200, 204),
            query=(*STRICTNESS, *hold_parameters(self.session.settings.hold_time)),
        )
        end = WriteMethod("Ends the hold and publishes its final message.", done=(204,))
        return PathItem(
            "A hold of a topic",
            plain=hold_schema(schemas, None),
            query=(FORMAT, _KEEP),
            writes={"PATCH": renew, "DELETE": end},
        )

    async def state(self) -> State:
        return self.state_of(self.require())

    def state_of(self, hold: Hold) -> State:
        """Return the state of this version of the hold."""
        shapes = self.space.shapes_of(hold.message.schema)
        return self.states.get_or_make(
            self.url,
            IdentityKey(hold),
            lambda: State(lambda: self.document(hold), lambda: self._plain(hold), shapes=shapes),
        )

    def document(self, hold: Hold) -> Document:
        """Return the RDF of this version of the hold."""
        view = HoldView(
            hold.id,
            hold.topic,
            hold.holder.name,
            hold.rate,
            hold.created_ns,
            hold.last_error,
            hold.lease,
            hold.until_ns,
            (hold.message.schema, hold.message.message),
            None if hold.release_message is None else (hold.release_message.schema, hold.release_message.message),
            hold.release_requested,
            is_timed=hold.is_timed,
            is_changeable=not self.session.settings.read_only,
        )
        return hold_document(view, self.space, self.session.lifting)

    def _plain(self, hold: Hold) -> bytes:
        """Return the hold as plain JSON, with its message in ROS form."""
        members = {
            "id": hold.id,
            "url": self.url,
            "offer": offer_url(self.url),
            "topic": hold.topic,
            "holder": hold.holder.name,
            "rate": hold.rate,
            "lease": hold.lease,
            "for": hold.lease if hold.is_timed else None,
            "kept": hold.until_ns is None,
            "then": hold.release_requested,
            "trouble": hold.last_error,
        }
        message = lifter(hold.message.schema, self.session.lifting).json(hold.message.message, self.url)
        return orjson.dumps(members)[:-1] + b',"message":' + message + b"}"

    async def forms(self) -> Sequence[Form]:
        if "DELETE" not in self.methods():
            return ()
        last = f"Its final message is then published on {self.require().topic}."
        renewed = f"It continues for {self.require().lease:g} s from then."
        return (DeleteForm("End the hold", "End", last), DeleteForm("Renew the hold", "Renew", renewed, method="PATCH"))

    def keep_alive(self, exchange: Exchange) -> contextlib.AbstractContextManager[float | None]:
        """Keep the hold alive during an event stream with `?keep=true`, with two heartbeats per lease.

        Raises a 403 Problem for agents other than the holder, and on a read-only server.
        """
        if not exchange.query_flag("keep"):
            return contextlib.nullcontext()
        if self.session.settings.read_only:
            raise Problem(403, READ_ONLY)
        require_holder(exchange, self.require())
        return self._keep(exchange, min(self.require().lease, MAX_LEASE))

    @contextlib.contextmanager
    def _keep(self, exchange: Exchange, lease: float) -> Iterator[float]:
        _notice_silence(exchange, lease)
        with self.services.holds.keep_alive(self.id):
            yield lease / 2

    async def patch(self, exchange: Exchange) -> Answer:
        """Renew the hold, changing its message, `?rate=`, `?lease=` or `?for=` (seconds) and `?then=` if given.

        Raises a 403 Problem for agents other than the holder.
        """
        hold = self.require()
        require_holder(exchange, hold)
        topic = PublishingResource(self.services, hold.topic)
        new_held = await self._changed_message(exchange, topic, hold)
        then, then_requested = hold.release_message, hold.release_requested
        if "then" in exchange.query or (new_held is not hold.message and then_requested == ZERO):
            words = exchange.query.get("then", then_requested)
            then, then_requested = await _then(words, topic, new_held, _readable(self.services, exchange))
        lease, is_timed = _lease(exchange, self.session) or (hold.lease, hold.is_timed)
        changed = replace(
            self.require(),
            message=new_held,
            rate=_rate(exchange, self.session.limiter) or hold.rate,
            lease=lease,
            is_timed=is_timed,
            release_message=then,
            release_requested=then_requested,
        )
        if new_held is hold.message and not exchange.query:
            exchange.audit.mark_read_only()  # frequent; the receipt of the hold suffices
        what = f"hold {hold.topic} at {changed.rate:g} Hz, unrenewed for {changed.lease:g} s"
        exchange.audit.add_step(what, self.space.topic(hold.topic))
        expect_status(204)
        self.services.holds.renew(self.id, changed)
        return Response(status_code=204)

    async def _changed_message(self, exchange: Exchange, topic: PublishingResource, hold: Hold) -> HeldMessage:
        """Return the message to hold after applying the body."""
        data = await exchange.body()
        if not data.strip():
            return hold.message
        schema = hold.message.schema
        if exchange.media_type == MERGE_PATCH:
            present = lifter(schema, self.session.lifting.unelided).json(hold.message.message, self.url)
            patched = merge_patch(parse_json(present), parse_json(data))
            message = lowerer(schema, self.session.lifting).from_json(patched)
        else:
            message = await topic.message_of(exchange, schema, self.url)
        await topic.require_within_limits(schema, message)
        return _command(self.session, topic.name, schema, message, restamp=False)

    async def delete(self, exchange: Exchange) -> Answer:
        """End the hold and wait until its final message is published.

        Raises a 403 Problem for agents other than the holder.
        """
        require_holder(exchange, self.require())
        topic = self.require().topic
        exchange.audit.add_step(f"end the hold of {topic}", self.space.topic(topic))
        ended = self.services.holds.end(self.id, f"{exchange.agent.name} ended it")
        if ended is not None:
            await ended
        return Response(status_code=204)


def require_holder(exchange: Exchange, hold: Hold) -> None:
    """Raise a 403 Problem if the agent is not the holder."""
    if exchange.agent != hold.holder:
        raise Problem(403, f"The hold {hold.id} belongs to {hold.holder.name}; POST to /stop ends it in any case.")


# Settings of requests

_RATES = f"at least {MIN_OF_HOLDS:f} and at most {MAX_RATE:g} Hz"
_LEASES = f"at least {MIN_OF_HOLDS:f} and at most {MAX_LEASE:g} s"


def _rate(exchange: Exchange, limiter: PublishLimiter) -> float | None:
    rate = _number(exchange, "rate", MAX_RATE, _RATES)
    if rate is not None and rate > limiter.rate:
        limit = f"{limiter.rate:g} messages a second (--max-publish-rate)"
        raise Problem(400, f"?rate={rate:g}: the maximum is {limit}.")
    return rate


def _lease(exchange: Exchange, session: Session) -> tuple[float, bool] | None:
    """Return the seconds that a hold lasts without renewal, and whether `?for=` set them; None if neither is given."""
    longest = session.settings.hold_time
    words = f"at least {MIN_OF_HOLDS:f} and at most {longest:g} s (--setting hold_time)"
    lease, time = _number(exchange, "lease", MAX_LEASE, _LEASES), _number(exchange, "for", longest, words)
    if lease is not None and time is not None:
        raise Problem(
            400, "?for= and ?lease= are mutually exclusive: a hold lasts for a fixed time, or while it is renewed."
        )
    if time is not None:
        return time, True
    return None if lease is None else (lease, False)


def _number(exchange: Exchange, name: str, limit: float, words: str) -> float | None:
    if name not in exchange.query:
        return None
    given = exchange.query[name]
    value = parse_decimal(given)
    if value is None or not MIN_OF_HOLDS <= value <= limit:
        raise Problem(400, f"?{name}={given[:100]}: it must be {words}.")
    return value


def _readable(services: Services, exchange: Exchange) -> Find:
    """Return a finder of resources that hides those that the agent may not read."""

    def found(path: str) -> Resource:
        if not exchange.permissions.may_read(services.space.base + path.lstrip("/")):
            raise not_found()
        return services.find(path)

    return found


async def _then(
    requested: str | None, topic: PublishingResource, held: HeldMessage, find: Find
) -> tuple[HeldMessage | None, str]:
    """Return the checked and encoded final message of a hold, and the text that requested it."""
    session, schema = topic.session, held.schema
    words = requested or (ZERO if schema.ref.name in TWISTS else NONE)
    if words == NONE:
        return None, NONE
    try:
        message = (
            with_zeros(schema, held.message)
            if words == ZERO
            else await _message_at(words, session.space, session.lifting, schema, find)
        )
        await topic.require_within_limits(schema, message)
    except LoweringError as error:
        detail = f"?then={words[:500]}: {error}"
        raise Problem(422, detail, title="Does not fit", violations=error.violations) from error
    except Problem as problem:
        problem.detail = f"?then={words[:500]}: {problem.detail}"
        raise
    return _command(session, topic.name, schema, message, restamp=True), words


async def _message_at(url: str, space: Space, lifting: LiftSettings, schema: MessageSchema, find: Find) -> Message:
    """Return the current message at a URL of this server. Raises Problems (422), and LoweringError."""
    base = space.base
    whole = urljoin(base, url)
    document, _, fragment = whole.partition("#")
    if not document.startswith(base) or urlsplit(document).query:
        raise Problem(422, f"It is zero, none, or the URL of a message below {base}")
    try:
        resource = find("/" + document[len(base) :])
        await resource.prepare()
        state = await resource.state()
    except ValueError as error:
        raise Problem(422, f"{error}.") from error
    except RosError as error:
        raise problem_of(error) from error
    except Problem as problem:
        raise Problem(422, problem.detail, extra=problem.quoted_members, about=problem.about) from problem
    body = index_triples(state.document.all_triples())
    type_iri = space.class_of(schema.ref.name)
    root = NamedNode(whole) if fragment else find_message(body, document, type_iri)
    return lowerer(schema, lifting).from_graph(body, root)


def _command(session: Session, topic: str, schema: MessageSchema, message: Message, *, restamp: bool) -> HeldMessage:
    encoding, clock = session.adapter.capabilities.encoding, not session.graph.simulated_time
    made = held_message(schema, message, encoding, restamp=restamp, clock=clock)
    return replace(made, passes_stop=passes_stop(session, topic, schema, message))


def _notice_silence(exchange: Exchange, seconds: float) -> None:
    """Close the connection if sent data stays unacknowledged, where the system supports that."""
    transport = exchange.request.scope.get("rosld.transport")
    found = None if transport is None else transport.get_extra_info("socket")
    if found is not None and sys.platform == "linux":
        with contextlib.suppress(OSError):
            found.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, max(1, int(seconds * 1000)))
