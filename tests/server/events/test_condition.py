"""Conditions of `?until=`: parsing, evaluation, rejection."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.events.condition import MAX_DEPTH, MAX_LENGTH, ConditionError, parse_condition

VALUE: Any = {
    "data": 3, "speed": 0.5, "status": "on", "is_on": True, "empty": None, "ranges": [1.5, "INF", "NaN"],
    "count": "9007199254740993", "pose": {"position": {"x": 2.0, "y": -1}},
    "big": {"@value": "NaN", "@type": "xsd:double"},
}  # fmt: skip


HOLDS = (
    ("data >= 3", True),
    ("data>3", False),
    ("data == 3.0", True),
    ("speed < 5e-1", False),
    ("speed <= .5", True),
    ("status = 'on'", True),
    ('status != "on"', False),
    ("status > 'off'", True),
    ("is_on = true", True),
    ("is_on != false and empty = null", True),
    ("empty > 3", False),
    ("empty.x = 3", False),
    ("pose.position.x > 2 or pose.position.y = -1", True),
    ("not (data = 3 and pose.position.x > 2)", True),
    ("not not data = 3", True),
    ("ranges[0] < 2", True),
    ("ranges[1] > 1e300", True),
    ("ranges[2] < 1 or ranges[2] >= 1", False),
    ("ranges[7] = 1", False),
    ("count = 9007199254740993", True),
    ("count = 9007199254740992", False),
    ("big != 0", True),
)
NO_CONDITIONS = (
    ("", "expected the name of a field at the end"),
    ("data", "one of ="),
    ("data >", "a number"),
    ("data > x", "at 'x' (character 8)"),
    ("data > 3 status = 1", "nothing more"),
    ("data = 3 and", "at the end"),
    ("(data = 3", "a closing parenthesis"),
    ("data = 3)", "at ')'"),
    ("data = 'on", "cannot be read"),
    ("data ~ 3", "cannot be read"),
    ("1 = data", "the name of a field"),
    ("a[-1] = 1", "index"),
    ("a[1.5] = 1", "index"),
    ("a..b = 1", "name of a field"),
    ("is_on > true", "compare it with ="),
    ("data < 1e999", "too large a number"),
    ("a = 1.2.3", "cannot be read"),
    ("and = 1", "name of a field"),
    ("__import__('os') = 1", "one of ="),
    ("a = 1 or " * 100 + "a = 1", str(MAX_LENGTH)),
    ("(" * (MAX_DEPTH + 1) + "a = 1" + ")" * (MAX_DEPTH + 1), "nested"),
    ("not " * (MAX_DEPTH + 1) + "a = 1", "nested"),
)
NEVER = (
    ("dat = 3", "there is no dat: there are big, count, data"),
    ("pose.position.z = 3", "there is no z in pose.position: there are x, y"),
    ("data.x = 3", "there is no x in data: it has no parts"),
    ("pose = 3", "pose is an object; compare a part of it: there are position"),
    ("ranges > 3", "there are [0] to [2]"),
    ("status = 3", "status is text, now 'on'"),
    ("data = '3'", "data is a number, now 3"),
    ("is_on = 1", "is_on is a boolean, now true"),
)


def holds(text: str, value: Any) -> bool:
    """Whether a condition holds for a value to which it is applicable."""
    condition = parse_condition(text)
    condition.check(value)
    return condition.holds(value)


def test_a_condition_holds_or_does_not() -> None:
    assert not [text for text, expected in HOLDS if holds(text, VALUE) is not expected]


def test_a_value_that_is_no_object_is_called_value() -> None:
    for value, text in ((5, "value > 4"), ("on", "value = 'on'"), ([1, 2], "value[1] = 2"), (None, "value = null")):
        assert holds(text, value)
    assert not parse_condition("data != 1").holds(None), "nothing is known of a value that there is not"


def test_a_text_that_is_no_condition_is_refused_with_the_place_of_the_error() -> None:
    for text, words in NO_CONDITIONS:
        with pytest.raises(ConditionError) as caught:
            parse_condition(text)
        assert words in str(caught.value), text


def test_a_condition_that_can_never_hold_is_refused_with_what_there_is() -> None:
    for text, words in NEVER:
        with pytest.raises(ConditionError) as caught:
            parse_condition(f"data = 3 or {text}").check(VALUE)
        assert words in str(caught.value), text
    with pytest.raises(ConditionError) as caught:
        parse_condition("x = 1").check({f"field_{number}": number for number in range(500)})
    assert len(str(caught.value)) < 500, "few names are listed"


NUMBERS = st.integers(-5, 5) | st.floats(-5, 5).map(lambda number: round(number, 2))
FIELDS = {"a": NUMBERS, "b": NUMBERS, "t": st.sampled_from(["", "on", "off", "it is"]), "f": st.booleans()}
SPACE = st.sampled_from(["", " ", "  "])


@st.composite
def comparisons(draw: st.DrawFn) -> tuple[str, str]:
    """Return a comparison in rosld and the same in Python."""
    name = draw(st.sampled_from([*FIELDS]))
    sign = draw(st.sampled_from(["=", "==", "!="] if name == "f" else ["=", "==", "!=", "<", "<=", ">", ">="]))
    literal: Any = draw(FIELDS[name])
    ours = str(literal).lower() if isinstance(literal, bool) else repr(literal)
    space = draw(SPACE)
    return f"{name}{space}{sign}{space}{ours}", f"{name} {'==' if sign == '=' else sign} {literal!r}"


def combined(parts: st.SearchStrategy[tuple[str, str]]) -> st.SearchStrategy[tuple[str, str]]:
    return st.one_of(
        st.tuples(parts, st.sampled_from(["and", "or"]), parts).map(
            lambda found: (f"{found[0][0]} {found[1]} {found[2][0]}", f"{found[0][1]} {found[1]} {found[2][1]}")
        ),
        parts.map(lambda found: (f"({found[0]})", f"({found[1]})")),
        parts.map(lambda found: (f"not {found[0]}", f"not {found[1]}")),
    )


@given(st.recursive(comparisons(), combined, max_leaves=8), st.fixed_dictionaries(FIELDS))
def test_a_condition_holds_where_python_says_so(condition: tuple[str, str], value: dict[str, Any]) -> None:
    ours, python = condition
    assert parse_condition(ours).holds(value) is eval(python, {"__builtins__": {}}, value)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["a", "b"]), inner, max_size=2),
    max_leaves=6,
)


@given(st.text("ab.[]01=<>!()'\" notrued", max_size=40) | st.text(max_size=40), JSON)
def test_no_text_and_no_value_break_it(text: str, value: Any) -> None:
    try:
        condition = parse_condition(text)
        condition.check(value)
    except ConditionError:
        return
    assert condition.holds(value) in (True, False)
