"""What a request for changes asks for."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.events import query_params
from rosld.server.http.problem import Problem
from rosld.server.rest.formats import OFFERS


@pytest.mark.parametrize(
    "accept",
    ["text/event-stream", "Text/Event-Stream", "text/event-stream, */*;q=0.1", "text/event-stream;charset=utf-8"],
)
def test_a_stream_is_for_those_who_like_it_best(accept: str) -> None:
    assert query_params.stream_is_preferred(accept, OFFERS)


@pytest.mark.parametrize(
    "accept",
    [
        None, "", "*/*", "text/*", "text/html,*/*;q=0.8", "text/event-stream;q=0", "text/event-streams",
        "application/json, text/event-stream", "text/event-stream;q=0.5, text/turtle", "application/event-stream",
    ],
)  # fmt: skip
def test_nobody_else_gets_one(accept: str | None) -> None:
    assert not query_params.stream_is_preferred(accept, OFFERS)


def test_a_rate_beyond_the_most_is_the_most() -> None:
    assert query_params.parse_rate({}) == 50.0
    assert query_params.parse_rate({"rate": "0.5"}) == 0.5
    assert query_params.parse_rate({"rate": "1000"}) == 1000.0
    assert query_params.parse_rate({"rate": "2e3"}) == 1000.0
    assert query_params.parse_rate({"rate": "9" * 20}) == 1000.0


def test_a_timeout_beyond_the_most_is_the_most() -> None:
    assert query_params.parse_timeout({}) == 25.0
    assert query_params.parse_timeout({"timeout": "0"}) == 0.0
    assert query_params.parse_timeout({"timeout": "3600"}) == 60.0


HOSTILE = ["", "0", "-1", "nan", "inf", "0x10", "10Hz", "١٠", "1_0", " 1", "1;2", "9" * 21, "0.0001", "%00"]


@pytest.mark.parametrize("text", HOSTILE)
def test_what_is_no_rate_is_refused_with_what_would_be(text: str) -> None:
    with pytest.raises(Problem, match=r"from 0\.001 to 100") as refused:
        query_params.parse_rate({"rate": text})
    assert refused.value.status == 400


def number(read: Callable[[Mapping[str, str]], float], name: str, text: str) -> float | None:
    """What is read, None where it is refused as the client's mistake."""
    try:
        return read({name: text})
    except Problem as refused:
        return None if refused.status == 400 else float("nan")


@given(st.text(max_size=30) | st.floats().map(str) | st.integers().map(str))
def test_any_text_is_refused_or_within_the_bounds(text: str) -> None:
    rate, timeout = number(query_params.parse_rate, "rate", text), number(query_params.parse_timeout, "timeout", text)
    assert rate is None or 0.001 <= rate <= 1000.0
    assert timeout is None or 0.0 <= timeout <= 60.0


@pytest.mark.parametrize("text", ["boot-1", '"boot-1.ttl"', "boot-1.json", 'W/"boot-1.json"', ' "boot-1" '])
def test_a_state_is_known_by_its_event_or_by_any_of_its_entity_tags(text: str) -> None:
    assert query_params.is_state(text, "boot-1")


@pytest.mark.parametrize("text", [None, "", "boot-2", '"boot-11.ttl"', "boot", '"', "."])
def test_another_state_is_not(text: str | None) -> None:
    assert not query_params.is_state(text, "boot-1")
