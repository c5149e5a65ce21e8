"""Bounds of inputs: never narrower than the constraints, so that browsers accept every value that the shape accepts."""

from __future__ import annotations

import re
from decimal import Decimal

from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import Literal

from rosld.adapters.model import Primitive
from rosld.ontology.coercion import RANGES
from rosld.server.html.inputs import browser_pattern, describe_bounds, number_range, option_texts, same_value
from rosld.shapes.value import Bounds

FLOAT, INT8, TEXT = Primitive("float64"), Primitive("int8"), Primitive("string")
NUMBERS = st.decimals(-1000, 1000, places=2) | st.integers(-200, 200).map(Decimal)
BOUNDS = st.builds(
    lambda *each: Bounds(*(None if one is None else Literal(str(one)) for one in each)),
    *[st.none() | NUMBERS] * 4,
)


def fits(bounds: Bounds, value: Decimal) -> bool:
    """Whether a value conforms to SHACL 4.3."""
    least, greatest, above, below = (
        None if each is None else Decimal(each.value)
        for each in (bounds.minimum, bounds.maximum, bounds.exclusive_minimum, bounds.exclusive_maximum)
    )
    return (
        (least is None or value >= least)
        and (greatest is None or value <= greatest)
        and (above is None or value > above)
        and (below is None or value < below)
    )


@given(BOUNDS)
def test_whole_numbers_are_taken_exactly_where_they_fit(bounds: Bounds) -> None:
    least, greatest = map(Decimal, number_range(INT8, bounds))
    for value in range(*RANGES["int8"]):
        assert (least <= value <= greatest) == fits(bounds, Decimal(value))


@given(BOUNDS, NUMBERS)
def test_every_number_that_fits_is_taken(bounds: Bounds, value: Decimal) -> None:
    least, greatest = number_range(FLOAT, bounds)
    if fits(bounds, value):
        assert not least or value >= Decimal(least)
        assert not greatest or value <= Decimal(greatest)


def test_a_bound_that_no_input_knows_or_beyond_the_type_changes_nothing() -> None:
    for text in ("INF", "NaN", "many", "", "1e999999999", "-1e-999999999"):
        assert number_range(FLOAT, Bounds(minimum=Literal(text), exclusive_maximum=Literal(text))) == ("", "")
        assert number_range(INT8, Bounds(minimum=Literal(text))) == ("-128", "127")
    assert number_range(INT8, Bounds(minimum=Literal(-1000), maximum=Literal(1000))) == ("-128", "127")


@given(st.from_regex(r"\A[a-c]{0,4}\Z"))
def test_a_pattern_is_searched_for_as_shacl_does(text: str) -> None:
    for pattern in ("ab", "^a", "c$", "^(ab|c)+$"):
        found = re.fullmatch(browser_pattern(Bounds(pattern=pattern)), text)
        assert (found is not None) == (re.search(pattern, text) is not None)


def test_a_pattern_that_a_browser_reads_differently_is_left_to_the_shape() -> None:
    for pattern in (r"^\w+$", r"\i\c*", "[a-z-[aeiou]]", "(?i)on"):
        assert browser_pattern(Bounds(pattern=pattern)) == ""
        assert pattern in describe_bounds(Bounds(pattern=pattern))


def test_choices_of_whole_numbers_have_no_fraction_and_equal_numbers_are_one_value() -> None:
    choices = Bounds(choices=(Literal("1.0"), Literal("2"), Literal("1"), Literal("2.5")))
    assert option_texts(INT8, choices) == ("1", "2", "2.5")
    assert option_texts(FLOAT, choices) == ("1.0", "2", "1", "2.5")
    assert option_texts(TEXT, Bounds(choices=(Literal("1.0"),))) == ("1.0",)
    same = {("1", "1.0"): True, ("on", "on"): True, ("on", "off"): False, ("NaN", "INF"): False}
    assert {pair: same_value(*pair) for pair in same} == same
