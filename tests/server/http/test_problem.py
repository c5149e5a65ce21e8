"""Problem details (RFC 9457)."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import RdfFormat, parse

from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import JSON, render


def test_problem_json_is_also_for_who_accepts_nothing_else_that_there_is() -> None:
    for accept in ("*/*", "application/json", "application/problem+json", "image/png", "rubbish", "application/*"):
        rendered = render(Problem(400, "No."), accept)
        assert rendered.headers["content-type"] == JSON
        assert json.loads(rendered.body)["detail"] == "No."


def test_headers_are_sent_and_those_that_would_inject_are_not() -> None:
    problem = Problem(405, "No.", headers={"Allow": "GET", "X-Name": "a\r\nSet-Cookie: b=c", "X-Ü": "x", "Y": "ü"})
    assert render(problem).headers["allow"] == "GET"
    assert not any("cookie" in value.lower() for value in render(problem).headers.values())
    assert set(render(problem).headers) & {"x-name", "x-ü", "y"} == set()


def test_extra_members_are_told_and_replace_none_of_the_standard_ones() -> None:
    told = json.loads(render(Problem(422, "No.", extra={"words": "engine is off", "status": 200})).body)
    assert (told["words"], told["status"]) == ("engine is off", 422)


@given(
    st.text(st.characters(), max_size=60),
    st.dictionaries(st.text(max_size=5), st.text(st.characters(), max_size=10) | st.integers() | st.floats()),
    st.sampled_from([None, "text/html", "text/turtle", "application/ld+json", "application/rdf+xml"]),
)
def test_any_detail_can_be_told_in_any_form(detail: str, extra: dict[str, object], accept: str | None) -> None:
    rendered = render(Problem(400, detail, extra=extra), accept)
    assert rendered.body.decode("utf-8")
    if accept is None:
        assert json.loads(rendered.body)["status"] == 400
    elif accept != "text/html":
        assert list(parse(rendered.body, format=RdfFormat.from_media_type(accept)))


def test_an_endless_value_is_cut() -> None:
    assert len(render(Problem(400, "x" * 1_000_000)).body) < 5000
