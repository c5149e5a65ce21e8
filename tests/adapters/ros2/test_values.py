"""Parameter values to ROS 2's tagged messages and back."""

from __future__ import annotations

import math
from datetime import datetime
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.model import Refused
from rosld.adapters.parameter_messages import Tag, from_message, to_fields

TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))
INTEGERS = st.integers(-(2**63), 2**63 - 1)
VALUES = st.one_of(
    st.booleans(),
    INTEGERS,
    st.floats(allow_nan=False),
    TEXT,
    st.binary(),
    st.lists(st.booleans(), min_size=1),
    st.lists(INTEGERS, min_size=1),
    st.lists(st.floats(allow_nan=False), min_size=1),
    st.lists(TEXT, min_size=1),
)


def message(fields: dict[str, object]) -> Any:
    return SimpleNamespace(**fields)


@given(VALUES)
def test_every_value_comes_back_exactly_with_its_own_type(value: Any) -> None:
    back = from_message(message(to_fields("/node/x", value)))
    assert back == value
    assert repr(back) == repr(value)


def test_not_a_number_comes_back_as_such() -> None:
    back = from_message(message(to_fields("/node/x", math.nan)))
    assert isinstance(back, float)
    assert math.isnan(back)


def test_an_empty_list_is_of_the_type_that_the_parameter_has_or_of_texts() -> None:
    for current in (Tag.DOUBLE_ARRAY, Tag.BYTE_ARRAY, Tag.INTEGER_ARRAY):
        assert to_fields("/node/x", [], current)["type"] == current
    for other in (None, Tag.NOT_SET, Tag.DOUBLE, 99):
        assert to_fields("/node/x", [], other)["type"] == Tag.STRING_ARRAY


def test_what_ros_2_cannot_hold_is_refused_by_name() -> None:
    numbers = (2**63, -(2**63) - 1, [2**63], [1, 2.0], [1, True], [[1]])
    values: tuple[Any, ...] = (*numbers, {"a": 1}, [b"x"], None, "a\0b", "\ud800", datetime(2026, 1, 1))
    for value in values:
        with pytest.raises(Refused, match="/node/x"):
            to_fields("/node/x", value)
    for tag in (Tag.NOT_SET, 10, 255):
        assert from_message(message({"type": tag})) is None
