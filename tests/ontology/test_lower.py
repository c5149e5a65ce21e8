"""Lowering: the bodies that fit a message, and the paths in violations of others."""

from __future__ import annotations

import math
from datetime import datetime, timedelta
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import NamedNode

from rosld.adapters.model import Encoding, Message, MessageSchema, Primitive
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.body import RdfBody, parse_body, parse_json
from rosld.ontology.coercion import Misfit, float_fit, to_float32
from rosld.ontology.lexical import NUMBERS, parse_date_time
from rosld.ontology.lift import lifter
from rosld.ontology.lower import find_message, lowerer
from rosld.ontology.violations import LoweringError, Violation
from rosld.ontology.vocab import xsd

D = "http://127.0.0.1:8080/topics/t"
TYPES = "https://w3id.org/rosld/types/"
HEAD = (
    f"@base <{D}> . @prefix ros: <https://w3id.org/rosld#> . @prefix xsd: <http://www.w3.org/2001/XMLSchema#> .\n"
    f"@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> . @prefix t: <{TYPES}made_up/msg/Thing#> .\n"
    f"@prefix i: <{TYPES}made_up/msg/Inner#> . @prefix m: <{TYPES}made_up/msg/> .\n"
    f"@prefix time: <{TYPES}builtin_interfaces/msg/Time#> .\n"
)
INNER = "\n================\nMSG: made_up/Inner\nfloat64 x\nfloat64 y"


def schema_of(definition: str, ros_version: int = 1) -> MessageSchema:
    return TypeLibrary(ros_version=ros_version).learn_message("made_up/msg/Thing", definition)  # type: ignore[arg-type]


def body_of(turtle: str) -> RdfBody:
    return parse_body((HEAD + turtle).encode(), "text/turtle", D)


def from_turtle(schema: MessageSchema, turtle: str) -> Message:
    body, named = body_of(turtle), NamedNode(f"{D}#message")
    root = named if named in body.subjects else find_message(body, D, TYPES + schema.ref.name)
    return lowerer(schema).from_graph(body, root)


def violations_of(schema: MessageSchema, turtle: str) -> dict[str, str]:
    with pytest.raises(LoweringError) as refused:
        from_turtle(schema, turtle)
    return {violation.path: violation.message for violation in refused.value.violations}


def json_violations_of(schema: MessageSchema, text: str, *, defaults: bool = False) -> dict[str, str]:
    with pytest.raises(LoweringError) as refused:
        lowerer(schema).from_json(parse_json(text.encode()), defaults=defaults)
    return {violation.path: violation.message for violation in refused.value.violations}


def value(kind: str, turtle: str, ros_version: int = 1) -> object:
    """Return the value of a field of this kind, from a Turtle object."""
    schema = schema_of(f"{kind} v", ros_version)
    message = from_turtle(schema, f"<#message> t:v {turtle} .")
    for encoding in Encoding:
        schema.codec.encode(message, encoding)
    found: object = vars(message)["v"]
    return found.tolist() if isinstance(found, np.ndarray) else found


@pytest.mark.parametrize(
    ("kind", "turtle", "expected"),
    [
        ("float64", "0.0", 0.0),
        ("float64", '"5"^^xsd:unsignedByte', 5.0),
        ("float64", '"0.1"^^xsd:float', 0.10000000149011612),
        ("float64", '" INF "^^xsd:double', math.inf),
        ("float64", "9007199254740993", 9007199254740992.0),
        ("float32", "0.1", 0.10000000149011612),
        ("float32", '"-INF"^^xsd:double', -math.inf),
        ("float32", "3.4028235677973366e38", None),
        ("float32", "3.4028235e38", 3.4028234663852886e38),
        ("int8", '"5.0"^^xsd:decimal', 5),
        ("int8", "120.00", 120),
        ("int64", '"1e300"^^xsd:double', None),
        ("int32", '"16777217"^^xsd:float', None),
        ("bool", '"0"^^xsd:boolean', False),
        ("string", '"a\\u0000b"', "a\0b"),
        ("string", '"Yf8="^^xsd:base64Binary', "a\udcff"),
        ("uint8[]", '" AP 8= "^^xsd:base64Binary', [0, 255]),
        ("uint8[]", '"00fF"^^xsd:hexBinary', [0, 255]),
        ("uint8[]", '"[0,255]"^^rdf:JSON', [0, 255]),
        ("uint8[2]", "(0 255)", [0, 255]),
        ("float64[]", '"[1,2.5,\\"NaN\\"]"^^rdf:JSON', [1.0, 2.5, math.nan]),
        ("float64[]", "(1 2.5 1e1)", [1.0, 2.5, 10.0]),
        ("int64[]", '"[\\"9223372036854775807\\",5]"^^rdf:JSON', [2**63 - 1, 5]),
        ("int64[]", '"[5.0]"^^rdf:JSON', None),
        ("bool[]", "(true false)", [True, False]),
        ("string[]", '("a" "gA=="^^xsd:base64Binary)', ["a", "\udc80"]),
        ("string[]", '"[\\"a\\"]"^^rdf:JSON', ["a"]),
    ],
)
def test_any_literal_that_holds_the_value_fits(kind: str, turtle: str, expected: object) -> None:
    if expected is None:
        with pytest.raises(LoweringError):
            value(kind, turtle)
    else:
        assert repr(value(kind, turtle)) == repr(expected)


@pytest.mark.parametrize(
    ("kind", "turtle", "words"),
    [
        ("int8", "1.5", "expected an int8 (an integer from -128 to 127)"),
        ("int8", "1e9", "expected an int8 (an integer from -128 to 127), as an integer or a decimal"),
        ("int8", '"NaN"^^xsd:double', "expected an int8 (an integer from -128 to 127), as an integer or a decimal"),
        ("int8", '"300"^^xsd:byte', "this is not a valid xsd:byte"),
        ("int8", '"1"', "expected an int8 (an integer from -128 to 127)"),
        ("float32", "1e39", "expected a float32, but this is out of its range"),
        ("float32", '"1e39"^^xsd:float', "beyond the range of xsd:float"),
        ("float64", '"1e400"^^xsd:double', "beyond the range of xsd:double"),
        ("float64", f"1{'0' * 399}.0", "expected a float64, but this is out of its range"),
        ("float64", '"1_0"^^xsd:double', "this is not a number"),
        ("float64", '"0x1"^^xsd:integer', "this is not a valid xsd:integer"),
        ("bool", "1", "expected a bool"),
        ("bool", '"yes"^^xsd:boolean', "expected an xsd:boolean"),
        ("string", '"a"@en', "without a language"),
        ("string", '"%"^^xsd:base64Binary', "expected base64"),
        ("uint8[]", '"[256]"^^rdf:JSON', "expected a uint8 (an integer from 0 to 255)"),
        ("uint8[3]", '"AP8="^^xsd:base64Binary', "expected an array of exactly 3 uint8"),
        ("float64[2]", "(1)", "expected an array of exactly 2 float64, but this has 1"),
        ("float64[]", '"[1,true]"^^rdf:JSON', "expected a float64"),
        ("float64[]", '"{}"^^rdf:JSON', "expected an array of float64 in JSON"),
        ("float32[]", '"[1e39]"^^rdf:JSON', "expected a float32, but this is out of its range"),
        ("float64[]", "[rdf:first 1]", "malformed rdf:List"),
        ("float64[]", "[rdf:first 1, 2; rdf:rest ()]", "malformed rdf:List"),
        ("float64[]", "_:a . _:a rdf:first 1 ; rdf:rest _:a", "malformed rdf:List: it never ends"),
        ("float64[]", "<#e> . <#e> a ros:Elided", "elided"),
        ("string", "<#e> . <#e> a ros:Elided", "elided"),
        ("float64", "1, 2", "expected one value, but there are 2"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_path_and_what_was_expected(kind: str, turtle: str, words: str) -> None:
    found = violations_of(schema_of(f"{kind} v"), f"<#message> t:v {turtle} .")
    ((path, message),) = found.items()
    assert path.partition(".")[0] == "v"
    assert words in message


def test_bounds_of_ros_2_are_kept() -> None:
    assert value("string<=2", '"ü"', 2) == "ü"
    assert value("float64[<=2]", "(1 2)", 2) == [1.0, 2.0]
    schema = schema_of("string<=2 s\nfloat64[<=2] a\nstring<=1[] t", 2)
    found = violations_of(schema, '<#message> t:s "üü" ; t:a (1 2 3) ; t:t ("a" "bc") .')
    assert found == {
        "s": "expected a string of at most 2 bytes, but this has 4",
        "a": "expected an array of at most 2 float64, but this has 3",
        "t.1": "expected a string of at most 1 bytes, but this has 2",
    }


TWO = schema_of("Inner a\nInner b" + INNER)


def test_a_whole_message_is_read_from_blank_nodes_too() -> None:
    message = from_turtle(TWO, "[] a m:Thing ; t:a [ i:x 1 ; i:y 2 ] ; t:b [ a m:Inner ; i:x 3 ; i:y 4 ] .")
    assert lifter(TWO).json(message, D) == b'{"a":{"x":1.0,"y":2.0},"b":{"x":3.0,"y":4.0}}'


def test_what_is_missing_and_what_is_no_field_are_named() -> None:
    assert violations_of(TWO, "<#message> t:a [ i:x 1 ] .") == {
        "a.y": "missing: expected a float64",
        "b": "missing: expected a made_up/msg/Inner",
    }
    found = violations_of(TWO, "<#message> t:a [ i:x 1 ; i:y 2 ; i:z 3 ] ; t:b [ i:x 3 ; i:y 4 ] ; <http://e/p> 5 .")
    assert found.keys() == {"a.z", "http://e/p"}
    assert f"<{TYPES}made_up/msg/Inner#z> is not a field of <{TYPES}made_up/msg/Inner>; it has x, y" == found["a.z"]


def test_another_type_is_refused() -> None:
    found = violations_of(TWO, "<#message> a ros:Topic ; t:a [ i:x 1 ; i:y 2 ] ; t:b [ a m:Thing ; i:x 3 ; i:y 4 ] .")
    assert found == {
        "": f"expected a node of type <{TYPES}made_up/msg/Thing>",
        "b": f"expected a node of type <{TYPES}made_up/msg/Inner>",
    }


def test_a_node_within_itself_is_refused() -> None:
    schema = schema_of("Middle m\n=====\nMSG: made_up/Middle\nInner i" + INNER)
    found = violations_of(schema, f"<#message> t:m <#a> . <#a> <{TYPES}made_up/msg/Middle#i> <#a> .")
    assert "contains itself" in found["m.i"]


def test_a_few_triples_cannot_stand_for_a_giant_message() -> None:
    schema = schema_of(
        "A[] a\n=====\nMSG: made_up/A\nB[] b\n=====\nMSG: made_up/B\nC[] c\n=====\nMSG: made_up/C\nfloat64 x"
    )
    lists = "".join(
        [
            f"{node} <{TYPES}made_up/msg/{name}> ( {f'<#{target}> ' * 60}) .\n"
            for node, name, target in (("<#message>", "Thing#a", "a"), ("<#a>", "A#b", "b"), ("<#b>", "B#c", "c"))
        ]
    )
    found = violations_of(schema, lists + f"<#c> <{TYPES}made_up/msg/C#x> 1 .")
    assert "the same nodes are used too often in this body" in found.values()


@pytest.mark.parametrize(
    ("turtle", "seconds", "nanosec"),
    [
        ("[ time:sec 5 ; time:nanosec 7 ]", 5, 7),
        ('[ ros:dateTime "1970-01-01T00:00:05.000000007Z"^^xsd:dateTime ]', 5, 7),
        ('[ ros:dateTime "1970-01-01T01:00:00+02:00"^^xsd:dateTime ]', -3600, 0),
        ('[ time:sec 5 ; time:nanosec 7 ; ros:dateTime "nonsense" ]', 5, 7),
    ],
)
def test_a_stamp_is_its_fields_or_a_date_time_alone(turtle: str, seconds: int, nanosec: int) -> None:
    stamp = vars(from_turtle(schema_of("time t"), f"<#message> t:t {turtle} ."))["t"]
    assert (stamp.sec, stamp.nanosec) == (seconds, nanosec)


@pytest.mark.parametrize(
    "turtle",
    [
        "[ time:sec 5 ]",
        '[ ros:dateTime "1970-01-01T00:00:05"^^xsd:dateTime ]',
        '[ ros:dateTime "2970-01-01T00:00:05Z"^^xsd:dateTime ]',
        '[ ros:dateTime "1970-02-30T00:00:05Z"^^xsd:dateTime ]',
        '[ ros:dateTime "1970-01-01T00:00:05Z" ]',
    ],
)
def test_half_a_stamp_is_refused(turtle: str) -> None:
    assert violations_of(schema_of("time t"), f"<#message> t:t {turtle} .")


@given(st.datetimes(), st.integers(0, 999_999_999))
def test_date_times_are_exact_to_the_nanosecond(when: datetime, nanosecond: int) -> None:
    whole = when.replace(microsecond=0)
    seconds = (whole - datetime(1970, 1, 1)) // timedelta(seconds=1)
    assert parse_date_time(f"{whole.isoformat()}.{nanosecond:09d}Z") == seconds * 10**9 + nanosecond


# The node of the message


@pytest.mark.parametrize(
    "turtle",
    [
        "<#message> a m:Thing ; t:v 1 . <#other> a m:Thing ; t:v 2 .",
        "<> ros:latest <#mine> . <#mine> a m:Thing ; t:v 1 . <#other> a m:Thing ; t:v 2 .",
        "<> a ros:Topic ; ros:latest [ a m:Thing ; t:v 1 ] .",
        "<#anything> a m:Thing ; t:v 1 .",
        "[] a m:Thing ; t:v 1 .",
        "[] a m:Thing ; t:v 1 ; <http://e/whole> [ a m:Thing ; t:v 2 ] .",
    ],
)
def test_the_message_is_found(turtle: str) -> None:
    body = body_of(turtle)
    root = find_message(body, D, f"{TYPES}made_up/msg/Thing")
    assert [str(each) for each in body.properties(root)[next(p for p in body.properties(root) if "#v" in p.value)]] == [
        '"1"^^<http://www.w3.org/2001/XMLSchema#integer>'
    ]


@pytest.mark.parametrize(
    ("turtle", "count"), [("<#message> t:v 1 .", "none"), ("<#a> a m:Thing . <#b> a m:Thing .", "2")]
)
def test_no_message_or_too_many_is_told(turtle: str, count: str) -> None:
    with pytest.raises(LoweringError, match=f"expected one node of type .* is {count}: give <{D}#message> that type"):
        find_message(body_of(turtle), D, f"{TYPES}made_up/msg/Thing")


# Plain JSON


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("int8", '"1"'),
        ("int8", "true"),
        ("int64", '"1.0"'),
        ("int64", '"9223372036854775808"'),
        ("float64", "1e400"),
        ("float64", '"nan"'),
        ("float64[]", "[1e400]"),
        ("string", '"\\ud800"'),
        ("string", '{"@value":"a","@type":"http://www.w3.org/2001/XMLSchema#string"}'),
        ("string", '{"@value":5,"@type":"http://www.w3.org/2001/XMLSchema#base64Binary"}'),
        ("uint8[]", '"#"'),
        ("uint8[2]", '"AQID"'),
        ("string[]", '"a"'),
        ("uint8[]", '{"elided":true,"length":5,"href":"http://x"}'),
    ],
)
def test_json_that_does_not_fit_is_refused_with_its_path(kind: str, text: str) -> None:
    found = json_violations_of(schema_of(f"{kind} v"), f'{{"v":{text}}}')
    ((path, words),) = found.items()
    assert path.partition(".")[0] == "v"
    assert "expected" in words or "elided" in words


def test_elements_are_named_by_their_index() -> None:
    schema = schema_of("Inner[] many\nfloat32[] f" + INNER)
    found = json_violations_of(schema, '{"many":[{"x":1,"y":2},{"x":1},5],"f":[1,2,"x"]}')
    assert found.keys() == {"many.1.y", "many.2", "f.2"}


def test_defaults_are_for_those_who_ask_and_for_what_is_missing_only() -> None:
    schema = schema_of("Inner a\nInner[2] two\nfloat64[3] f\nstring s\nuint8[] o\nbool b\nint8 n" + INNER)
    assert "a" in json_violations_of(schema, "{}")
    message = lowerer(schema).from_json({"a": {"y": 1}}, defaults=True)
    assert lifter(schema).json(message, D) == (
        b'{"a":{"x":0.0,"y":1.0},"two":[{"x":0.0,"y":0.0},{"x":0.0,"y":0.0}],"f":[0.0,0.0,0.0],"s":"","o":"","b":false,'
        b'"n":0}'
    )
    assert schema.codec.encode(message, Encoding.ROS1)
    assert json_violations_of(schema, '{"z":1}', defaults=True).keys() == {"z"}
    assert json_violations_of(schema, '{"s":null}', defaults=True).keys() == {"s"}
    assert json_violations_of(TWO, '{"a":{"x":1,"y":2},"c":{}}').keys() == {"b", "c"}
    assert json_violations_of(TWO, "[]") == {"": "expected a made_up/msg/Thing"}
    assert len(json_violations_of(schema_of("\n".join(f"int8 f{i}" for i in range(50))), "{}")) == 20


def test_violations_show_the_value_shortened() -> None:
    with pytest.raises(LoweringError) as refused:
        lowerer(schema_of("int8 v")).from_json({"v": "x" * 10_000})
    (violation,) = refused.value.violations
    assert isinstance(violation, Violation)
    assert violation.value is not None
    assert len(violation.value) == 120


# Rounding


@given(st.decimals(allow_nan=False, allow_infinity=False, min_value=-(10**39), max_value=10**39, places=12))
def test_a_float32_is_the_nearest_of_all(number: Decimal) -> None:
    try:
        found = float_fit(Primitive("float32"))(number)
    except Misfit:
        assert abs(number) > Decimal("3.402823e38")
        return
    off = abs(Fraction(number) - Fraction(found))
    for other in (np.nextafter(np.float32(found), np.float32(end)) for end in (-np.inf, np.inf)):
        assert not np.isfinite(other) or off <= abs(Fraction(number) - Fraction(float(other)))


def test_rounding_twice_decides_no_tie() -> None:
    tie = Fraction(1) + Fraction(1, 2**24)
    above = Decimal(tie.numerator) / Decimal(tie.denominator) + Decimal("1e-25")
    assert to_float32(float(above)) == 1.0
    assert to_float32(above) == 1.0 + 2**-23
    assert NUMBERS[xsd.float](str(above)) == 1.0 + 2**-23
