"""Subscription requests (Solid Notifications Protocol 2.2): validation of requested channels. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime, timezone
from decimal import Decimal
from urllib.parse import urlsplit

import orjson
from msgspec import Struct
from pyoxigraph import Literal, NamedNode

from rosld.ontology.body import BodyError, RdfBody, Subject, check_json_depth, parse_body
from rosld.ontology.notifications import DEFINITIONS, KNOWN_CONTEXTS, type_named
from rosld.ontology.vocab import notify, rdf
from rosld.server.http.negotiation import choose_offer, parse_media_type
from rosld.server.http.problem import Problem

MAX_BYTES = 16 * 1024
"""Maximum size of a request, which contains only a topic and a few features."""
JSON_LD = "application/ld+json"
MEDIA_TYPES = (JSON_LD, "application/json", "text/turtle", "application/n-triples")
"""Media types of requests."""
MESSAGE_TYPES = (JSON_LD, "application/json", "application/activity+json", "text/turtle", "application/n-triples")
"""Media types of notifications, the default first."""
MIN_INTERVAL, DEFAULT_INTERVAL, MAX_INTERVAL = 0.01, 0.1, 86_400.0
"""Limits and default of the seconds between two notifications of a channel."""

_DURATION = re.compile(
    r"P(?:(\d{1,9})D)?(?:T(?=\d)(?:(\d{1,9})H)?(?:(\d{1,9})M)?(?:(\d{1,9}(?:\.\d{1,9})?)S)?)?", re.ASCII
)
_DATE_TIME = re.compile(r"(\d{4})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)(?:\.(\d{1,18}))?(Z|[+-]\d\d:\d\d)?", re.ASCII)
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_MAX_LENGTH = 200


class ChannelRequest(Struct, frozen=True):
    """A requested channel: `interval` in seconds, times in ns since 1970, `accept` the negotiated media type."""

    topic: str
    accept: str = JSON_LD
    interval: float = DEFAULT_INTERVAL
    start_at: int | None = None
    end_at: int | None = None
    state: str | None = None


def check_profile(content_type: str | None) -> None:
    """Raise a 415 Problem for a profile of JSON-LD that is not the protocol's (2.2)."""
    if content_type is None:
        return
    try:
        profile = parse_media_type(content_type).parameter("profile")
    except ValueError as error:
        raise Problem(415, f"Content-Type: {error}.") from error
    for one in (profile or "").split():
        if one not in KNOWN_CONTEXTS:
            raise Problem(415, f"Unknown profile {one[:_MAX_LENGTH]!r}: omit it.")


def read_subscription(data: bytes, media_type: str, service: str, channel_type: str, now: int) -> ChannelRequest:
    """Return the channel requested from `service`, which creates channels of one type; `now` in ns since 1970.

    Raises BodyError for unreadable bodies, and Problems (422) for unsupported values, each naming the value.
    """
    if media_type in (JSON_LD, "application/json"):
        data, media_type = with_known_contexts(data), JSON_LD
    body = parse_body(data, media_type, service)
    channel = _channel(body)
    _check_type(body, channel, channel_type)
    start_at, end_at = (_date_time(_text(body, channel, term)) for term in (notify.startAt, notify.endAt))
    if end_at is not None and end_at <= max(now, start_at or now):
        raise _refusal(f"endAt {_text(body, channel, notify.endAt)} is before the start: choose a later time.")
    return ChannelRequest(
        topic=_topic(body, channel),
        accept=_accept(_text(body, channel, notify.accept)),
        interval=_interval(_text(body, channel, notify.rate)),
        start_at=start_at,
        end_at=end_at,
        state=_text(body, channel, notify.state),
    )


def with_known_contexts(data: bytes) -> bytes:
    """Replace the URL of the protocol's JSON-LD context by the context itself, and add it where none is named.

    Nothing is fetched. Raises BodyError for invalid JSON, and a 422 Problem for an unknown context.
    """
    check_json_depth(data)
    try:
        root = orjson.loads(data)
    except orjson.JSONDecodeError as error:
        raise BodyError(f"this is not JSON: {error.msg}", error.lineno, error.colno) from error
    if not isinstance(root, dict | list):
        raise _refusal("A subscription must be a JSON object.")
    if isinstance(root, dict):
        root.setdefault("@context", DEFINITIONS)
    for part in _objects(root):
        if "@import" in part:
            raise _unknown_context(part["@import"])
        if "@context" in part:
            part["@context"] = _known_context(part["@context"])
    return orjson.dumps(root)


def _objects(root: object) -> Iterator[dict[str, object]]:
    waiting = [root]
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            yield value
            waiting += value.values()
        elif isinstance(value, list):
            waiting += value


def _known_context(context: object) -> object:
    if isinstance(context, list):
        return [_known_context(one) for one in context]
    if not isinstance(context, str):
        return context
    if context not in KNOWN_CONTEXTS:
        raise _unknown_context(context)
    return DEFINITIONS


def _unknown_context(context: object) -> Problem:
    return _refusal(
        f"Unknown JSON-LD context {str(context)[:_MAX_LENGTH]!r}; contexts are not fetched: send "
        f"{sorted(KNOWN_CONTEXTS)[0]}, or include the context itself."
    )


def _channel(body: RdfBody) -> Subject:
    found = [subject for subject, properties in body.subjects.items() if notify.topic in properties]
    if len(found) != 1:
        raise _refusal(f"A subscription must have one channel with a {notify.topic.value}, not {len(found)}.")
    return found[0]


def _check_type(body: RdfBody, channel: Subject, wanted: str) -> None:
    types = [one.value for one in body.objects(channel, rdf.type) if isinstance(one, NamedNode)]
    if not types:
        raise _refusal(f"A subscription needs a type; this service supports {notify.iri}{wanted}.")
    for one in types:
        if type_named(one) != wanted:
            raise _refusal(f"The type {one[:_MAX_LENGTH]!r} is not supported: this service offers {notify.iri}{wanted}")


def _topic(body: RdfBody, channel: Subject) -> str:
    found = body.objects(channel, notify.topic)
    if len(found) > 1:
        raise _refusal(f"A channel must have one topic, not {len(found)}: subscribe to each separately.")
    topic = found[0]
    if not isinstance(topic, NamedNode):
        raise _refusal(f"The topic {str(topic)[:_MAX_LENGTH]} is not a URL: send it as an IRI.")
    try:
        fragment = urlsplit(topic.value).fragment
    except ValueError as error:
        raise _refusal(f"The topic {topic.value[:_MAX_LENGTH]!r} is not a URL: {error}.") from error
    if fragment or topic.value.endswith("#"):
        raise _refusal(
            f"The topic {topic.value[:_MAX_LENGTH]!r} has a fragment: send the URL of the resource, without #."
        )
    return topic.value


def _text(body: RdfBody, channel: Subject, term: NamedNode) -> str | None:
    found = body.objects(channel, term)
    name = term.value.removeprefix(notify.iri)
    if len(found) > 1:
        raise _refusal(f"{name} is given {len(found)} times: send it once.")
    if not found:
        return None
    value = found[0]
    if not isinstance(value, Literal):
        raise _refusal(f"{name} {str(value)[:_MAX_LENGTH]} is not a literal.")
    if len(value.value) > _MAX_LENGTH:
        raise _refusal(f"{name} {value.value[:_MAX_LENGTH]!r}... is longer than {_MAX_LENGTH} characters.")
    return value.value


def _accept(accept: str | None) -> str:
    found = choose_offer(accept, MESSAGE_TYPES)
    if found is None:
        raise _refusal(f"accept {accept!r}: notifications are available as {', '.join(MESSAGE_TYPES)}.")
    return found


def _interval(rate: str | None) -> float:
    """Return the seconds of an xsd:duration, at least the minimum; case is ignored (the drafts write `PT10s`)."""
    if rate is None:
        return DEFAULT_INTERVAL
    match = _DURATION.fullmatch(rate.strip().upper())
    if match is None or not any(part is not None for part in match.groups()):
        raise _refusal(
            f"rate {rate!r} is not an xsd:duration of days, hours, minutes and seconds, such as PT10S or PT0.5S."
        )
    days, hours, minutes, seconds = (Decimal(part or 0) for part in match.groups())
    wanted = float(((days * 24 + hours) * 60 + minutes) * 60 + seconds)
    if wanted > MAX_INTERVAL:
        raise _refusal(f"rate {rate!r} is longer than the maximum of one day ({MAX_INTERVAL:g} s).")
    return max(wanted, MIN_INTERVAL)


def _date_time(text: str | None) -> int | None:
    """Return the ns since 1970 of an xsd:dateTime; without a time zone it is UTC."""
    if text is None:
        return None
    match = _DATE_TIME.fullmatch(text.strip())
    if match is None:
        raise _refusal(f"{text!r} is not an xsd:dateTime such as 2030-01-31T12:00:00Z.")
    *parts, fraction, zone = match.groups()
    try:
        year, month, day, hour, minute, second = map(int, parts)
        offset = "+00:00" if zone in (None, "Z") else zone
        whole = datetime.fromisoformat(f"{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}{offset}")
        since = whole - _EPOCH
    except (ValueError, OverflowError) as error:
        raise _refusal(f"{text!r} does not exist: {error}.") from error
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + int((fraction or "0").ljust(9, "0")[:9])


def _refusal(words: str) -> Problem:
    return Problem(422, words)
