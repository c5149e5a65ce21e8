"""Brief values: the part of a value that fits into a line, with visible omissions."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.hypermedia.brief_value import brief_json
from rosld.server.hypermedia.value import WHOLE, MessageValue, StoredValue, plain_json
from tests.server.html.messages import message, schema

NUMBERS = st.floats(width=32, allow_nan=False, allow_infinity=False) | st.sampled_from(["NaN", "INF"])
WORDS = st.text(max_size=90)
STATUS = st.fixed_dictionaries({"name": WORDS, "message": WORDS, "level": st.integers(0, 3)})
VALUES = st.one_of(
    st.tuples(st.just("std_msgs/msg/Float32"), st.fixed_dictionaries({"data": NUMBERS})),
    st.tuples(st.just("std_msgs/msg/String"), st.fixed_dictionaries({"data": WORDS})),
    st.tuples(
        st.just("diagnostic_msgs/msg/DiagnosticArray"), st.fixed_dictionaries({"status": st.lists(STATUS, max_size=5)})
    ),
    st.tuples(
        st.just("sensor_msgs/msg/JointState"),
        st.fixed_dictionaries(
            {"name": st.lists(WORDS, max_size=12), "position": st.lists(st.integers(-9, 9), max_size=12)}
        ),
    ),
)


def value_of(type: str, value: object) -> MessageValue:
    kind = schema(type)
    return MessageValue(kind, message(kind, value), kind.type.fields, "http://127.0.0.1/topics/x")


def is_part(brief: Any, whole: Any) -> bool:
    """Whether a brief value has only content of the whole one, and marks its omissions."""
    if isinstance(brief, dict):
        told = {name: each for name, each in brief.items() if name != "..."}
        left_out = whole.keys() - told.keys() - {"header"}
        return all(is_part(each, whole[name]) for name, each in told.items()) and bool(left_out) == ("..." in brief)
    if isinstance(brief, list):
        told = brief[:-1] if brief[-1:] == ["..."] and len(brief) <= len(whole) else brief
        return all(map(is_part, told, whole)) and (len(told) == len(whole) or brief[-1] == "...")
    if isinstance(brief, str) and brief != whole and brief.endswith("..."):
        return bool(whole.startswith(brief[:-3]))
    return bool(brief == whole)


@given(VALUES, st.integers(20, 400))
def test_a_brief_value_is_a_part_of_the_whole_and_as_short_as_it_may_be(value: tuple[str, object], limit: int) -> None:
    given = value_of(*value)
    if given.schema.ref.name.startswith("std_msgs"):  # plain JSON has a single scalar bare
        whole: Any = {"data": json.loads(plain_json(given, WHOLE))}
    else:
        whole = json.loads(plain_json(given, WHOLE))
    text = brief_json(given, limit)
    assert is_part(json.loads(text), whole)
    assert len(text) <= limit + len('{"...":"more"}')


@pytest.mark.parametrize(
    ("type", "value", "brief"),
    [
        ("std_msgs/msg/Float64", {"data": 0.1}, '{"data":0.1}'),
        ("std_msgs/msg/Empty", {}, "{}"),
        ("std_msgs/msg/UInt64", {"data": 2**60}, f'{{"data":"{2**60}"}}'),
        ("sensor_msgs/msg/Image", {"data": "AAAA", "height": 2, "encoding": "rgb8"},
         '{"height":2,"width":0,"encoding":"rgb8","is_bigendian":0,"step":0,"...":"more"}'),
        ("geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 1}}},
         '{"pose":{"position":{"x":1.0,"y":0.0,"z":0.0},"orientation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0}}}'),
        ("std_msgs/msg/Header", {"frame_id": "map"}, '{"seq":0,"stamp":{"sec":0,"nanosec":0},"frame_id":"map"}'),
        ("geometry_msgs/msg/PoseWithCovariance", {},
         '{"pose":{"position":{"x":0.0,"y":0.0,"z":0.0},"orientation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0}},"...":"more"}'),
    ],
)  # fmt: skip
def test_what_matters_of_common_messages_fits(type: str, value: object, brief: str) -> None:
    assert brief_json(value_of(type, value)) == brief


def test_a_parameter_is_whole_or_left_out() -> None:
    briefs = ((0.5, "0.5"), ("x" * 100, f'"{"x" * 60}..."'), ([1, 2], "[1,2]"), ({"a": 1}, '{"a":1}'))
    assert [brief_json(StoredValue(value)) for value, _ in briefs] == [brief for _, brief in briefs]
    assert brief_json(StoredValue(list(range(500)))) == '"..."'
