"""Subscription requests: valid ones are parsed, and others are rejected with the invalid value."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.ontology.body import BodyError
from rosld.ontology.notifications import CONTEXT, DEFINITIONS
from rosld.server.events.channel_request import (
    MAX_INTERVAL,
    ChannelRequest,
    check_profile,
    read_subscription,
)
from rosld.server.http.problem import Problem

SERVICE = "http://robot.example/channels/WebSocketChannel2023"
TYPE = "http://www.w3.org/ns/solid/notifications#WebSocketChannel2023"
TOPIC = "http://robot.example/topics/speed"
WISH = {"@context": [CONTEXT], "type": TYPE, "topic": TOPIC}
NOW = 1_800_000_000 * 10**9


def read(wish: Any, media_type: str = "application/ld+json") -> ChannelRequest:
    data = wish if isinstance(wish, bytes) else json.dumps(wish).encode()
    return read_subscription(data, media_type, SERVICE, "WebSocketChannel2023", NOW)


def test_types_and_contexts_may_be_spelt_as_the_drafts_do() -> None:
    for name in ("WebSocketChannel2023", "notify:WebSocketChannel2023", TYPE.replace("notifications", "notification")):
        assert read(WISH | {"type": name}) == ChannelRequest(TOPIC)
    contexts: list[object] = [
        CONTEXT,
        [CONTEXT, {"extra": "http://example.org/extra"}],
        DEFINITIONS,
        "https://www.w3.org/ns/solid/notification/v1",
        {"@vocab": "http://www.w3.org/ns/solid/notifications#", "topic": {"@type": "@id"}, "type": "@type"},
    ]
    for context in contexts:
        assert read(WISH | {"@context": context, "extra": 1}).topic == TOPIC
    plain = {"type": "WebSocketChannel2023", "topic": TOPIC, "state": "x"}
    assert read(plain, "application/json") == ChannelRequest(TOPIC, state="x")


def test_all_features_are_read() -> None:
    wish = read(
        WISH
        | {
            "rate": "PT10s",
            "state": 'W/"abc"',
            "startAt": "2027-01-15T08:00:00Z",
            "endAt": "2027-01-15T10:30:00.25+01:00",
            "accept": "text/turtle, application/ld+json;q=0.5",
        }
    )
    assert wish.interval == 10
    assert wish.state == 'W/"abc"'
    assert wish.start_at == NOW
    assert wish.end_at == NOW + 5_400_250_000_000
    assert wish.accept == "text/turtle"


def test_rates_have_all_units_and_a_least() -> None:
    rates = {"PT1M": 60, "P1D": MAX_INTERVAL, "PT1H1M1.5S": 3661.5, "PT0S": 0.01}
    assert {rate: read(WISH | {"rate": rate}).interval for rate in rates} == rates


def test_a_request_that_cannot_be_met_is_refused_with_its_value() -> None:
    refused: list[tuple[object, str]] = [
        ({"type": TYPE}, "topic"),
        (WISH | {"topic": [TOPIC, TOPIC + "2"]}, "subscribe to each separately"),
        (WISH | {"topic": TOPIC + "#here"}, "without #"),
        (WISH | {"topic": {"@value": TOPIC}}, "not a URL"),
        (WISH | {"type": "StreamingHTTPChannel2023"}, "StreamingHTTPChannel2023"),
        (WISH | {"type": "http://example.org/Pigeon"}, "Pigeon"),
        ({"@context": CONTEXT, "topic": TOPIC}, "type"),
        (WISH | {"@context": "https://evil.example/context"}, "https://evil.example/context"),
        (WISH | {"@context": [CONTEXT, "http://127.0.0.1:1/"]}, "http://127.0.0.1:1/"),
        (WISH | {"x": {"@context": "file:///etc/passwd"}}, "/etc/passwd"),
        (WISH | {"@context": {"@import": CONTEXT}}, "Unknown"),
        (WISH | {"@context": {"x": {"@id": "http://x/y", "@context": "http://evil.example/"}}}, "evil.example"),
        (WISH | {"rate": "10"}, "PT10S"),
        (WISH | {"rate": "-PT1S"}, "-PT1S"),
        (WISH | {"rate": "P"}, "'P'"),
        (WISH | {"rate": "PT"}, "'PT'"),
        (WISH | {"rate": "P1Y"}, "P1Y"),
        (WISH | {"rate": "P2D"}, "maximum of one day"),
        (WISH | {"rate": "PT٣S"}, "xsd:duration"),
        (WISH | {"rate": ["PT1S", "PT2S"]}, "2 times"),
        (WISH | {"rate": {"@id": "http://x/"}}, "literal"),
        (WISH | {"endAt": "tomorrow"}, "tomorrow"),
        (WISH | {"endAt": "2026-02-30T00:00:00Z"}, "does not exist"),
        (WISH | {"endAt": "2020-01-01T00:00:00Z"}, "is before the start"),
        (WISH | {"startAt": "2030-01-02T00:00:00Z", "endAt": "2030-01-01T00:00:00Z"}, "is before the start"),
        (WISH | {"startAt": "0000-01-01T00:00:00Z"}, "does not exist"),
        (WISH | {"endAt": "2030-01-01T00:00:00+99:99"}, "does not exist"),
        (WISH | {"accept": "image/png"}, "image/png"),
        (WISH | {"state": "x" * 1000}, "longer than"),
        ("subscribe", "JSON object"),
    ]
    for wish, words in refused:
        with pytest.raises(Problem) as caught:
            read(wish)
        assert (caught.value.status, words in caught.value.detail) == (422, True), wish
    for data in (b"", b"{", b"\xff", b"nul", b'{"@context": ' + b"[" * 5000 + b"]" * 5000 + b"}"):
        with pytest.raises(BodyError):
            read(data)


KEYS = st.sampled_from(["@context", "@id", "@graph", "@import", "type", "topic", "rate", "x"])
LEAVES = st.none() | st.booleans() | st.integers() | st.text(max_size=8)
VALUES = st.recursive(LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4))


def outcome(wish: object) -> int:
    """Return the status of a request."""
    try:
        read(wish)
    except Problem as problem:
        return problem.status
    except BodyError:
        return 400
    return 201


@given(VALUES)
def test_any_json_is_read_or_refused(value: Any) -> None:
    assert outcome(value) in (201, 400, 422)
    assert outcome(WISH | (value if isinstance(value, dict) else {"rate": value})) in (201, 400, 422)


def test_only_the_profile_of_the_protocol_is_known() -> None:
    for profile in (CONTEXT, "https://www.w3.org/ns/solid/notification/v1"):
        check_profile(f'application/ld+json; profile="{profile}"')
    check_profile(None)
    with pytest.raises(Problem, match="example") as caught:
        check_profile('application/ld+json; profile="http://example.org/other"')
    assert caught.value.status == 415
