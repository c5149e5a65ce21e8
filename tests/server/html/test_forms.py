"""Forms: created from a schema, filled in, and parsed as the plain JSON that lowers to the intended message."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable
from html.parser import HTMLParser

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from pyoxigraph import Literal

from rosld.adapters.model import (
    OCTETS,
    STRINGS,
    Array,
    Encoding,
    Field,
    FieldType,
    Message,
    MessageSchema,
    MessageType,
    Nested,
    Primitive,
    TypeRef,
)
from rosld.ontology.coercion import RANGES
from rosld.ontology.document import Document
from rosld.ontology.lift import lifter
from rosld.ontology.lower import lowerer
from rosld.ontology.violations import LoweringError, Violation
from rosld.server.html.form_parser import JsonValue, parse_value, split_hidden
from rosld.server.html.forms import Form, ValueForm, message_form
from rosld.server.html.inputs import Json
from rosld.server.html.page import Page
from rosld.server.html.render import render_page
from rosld.server.html.site import Site
from rosld.shapes.value import Bounds, MessageShape, OpenShape, ScalarShape, ValueShape
from tests.server.html.messages import LIBRARY, schema

URL = "http://127.0.0.1:8080/topics/x"
SITE = Site("http://127.0.0.1:8080/", "robot")
TYPES = (
    "std_msgs/msg/String", "std_msgs/msg/Bool", "std_msgs/msg/Float32", "std_msgs/msg/UInt64", "std_msgs/msg/Empty",
    "std_msgs/msg/Float64MultiArray", "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/PoseWithCovariance",
    "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/JointState", "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/PointField", "diagnostic_msgs/msg/DiagnosticArray", "tf2_msgs/msg/TFMessage",
    "nav_msgs/msg/Odometry",
)  # fmt: skip


def refilled(form: ValueForm, pairs: list[tuple[str, str]], violations: Iterable[Violation]) -> ValueForm:
    """Return the form after an invalid submission."""
    return replace(form, submitted=tuple(pairs), violations=tuple(violations))


def parse_form(kind: MessageSchema, pairs: list[tuple[str, str]]) -> JsonValue:
    return parse_value(MessageShape(kind, kind.type.fields), pairs)


class Browser(HTMLParser):
    """Parser of the pairs that a browser sends for the first form of an untouched page (HTML, "form submission")."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.pairs: list[tuple[str, str]] = []
        self.inputs: list[dict[str, str]] = []
        self.forms = 0
        self._textarea: str | None = None
        self._select: str | None = None
        self._text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {name: value or "" for name, value in attrs}
        self.forms += tag == "form"
        if tag in ("input", "textarea", "select"):
            self.inputs.append({"tag": tag, **attributes})
        if self.forms != 1:
            return
        if tag == "input" and (attributes["type"] != "checkbox" or "checked" in attributes):
            self._send(attributes["name"], attributes["value"].replace("\n", ""))
        elif tag == "textarea":
            self._textarea, self._text = attributes["name"], ""
        elif tag == "select":
            self._select = attributes["name"]
        elif tag == "option" and self._select and "selected" in attributes:
            self._textarea, self._text = self._select, "\n"

    def handle_data(self, data: str) -> None:
        self._text += data

    def handle_endtag(self, tag: str) -> None:
        if tag in ("textarea", "option") and self._textarea is not None:
            self._send(self._textarea, self._text.removeprefix("\n"))
            self._textarea = None

    def _send(self, name: str, text: str) -> None:
        self.pairs.append((name, text.replace("\n", "\r\n")))


def page(*forms: Form, allow: tuple[str, ...] = ("GET", "PUT", "POST", "DELETE")) -> Browser:
    drawn = render_page(Page(SITE, "Topic", "/x", Document(URL, ()), allow, forms, csrf=lambda _: "token"))
    return Browser(drawn.decode().partition("<main")[2])  # the forms above it are on every page


def sent(form: Form) -> list[tuple[str, str]]:
    """Return the form's own pairs, after checking the hidden ones."""
    token, method, pairs = split_hidden(page(form).pairs)
    assert (token, method) == ("token", form.method)
    return pairs


def texts() -> st.SearchStrategy[str]:
    return st.text(st.characters(exclude_categories=["Cs"]), max_size=12)


def typed_texts() -> st.SearchStrategy[str]:
    """Return texts that can be typed: without control characters except line ends and tabs."""
    return st.text(st.characters(exclude_categories=("Cs", "Cc", "Cn"), include_characters="\n\t"), max_size=12)


def floats(name: str) -> st.SearchStrategy[object]:
    finite = st.floats(width=32 if name == "float32" else 64, allow_nan=False, allow_infinity=False)
    return finite | st.sampled_from(["NaN", "INF", "-INF", "-0.0"])


def values(kind: FieldType, types: MessageSchema, *, typed: bool = True) -> st.SearchStrategy[object]:
    """Return plain JSON for a field."""
    if isinstance(kind, Nested):
        fields = types.types[kind.name].fields
        return st.fixed_dictionaries({each.name: values(each.type, types, typed=typed) for each in fields})
    if isinstance(kind, Array):
        if kind.element.name in OCTETS:
            return st.just("AAEC/w==") if kind.length is None else st.just("")
        size = kind.length if kind.length is not None else st.integers(0, 3)
        counted = (size, size) if isinstance(size, int) else (0, 3)
        return st.lists(values(kind.element, types, typed=False), min_size=counted[0], max_size=counted[1])
    if kind.name == "bool":
        return st.booleans()
    if kind.name in STRINGS:
        return typed_texts() if typed else texts()
    return st.integers(*RANGES[kind.name]) if kind.name in RANGES else floats(kind.name)


def octets(kind: MessageSchema, message: Message) -> bytes:
    return kind.codec.encode(message, Encoding.ROS1)


@pytest.mark.slow
@settings(max_examples=30)
@given(st.data())
def test_a_form_sent_untouched_means_the_message_it_was_filled_with(data: st.DataObject) -> None:
    kind = schema(data.draw(st.sampled_from(TYPES)))
    value = data.draw(values(Nested(kind.ref.name), kind))
    expected = lowerer(kind).from_json(value)
    plain = json.loads(lifter(kind).json(expected, URL))
    read = lowerer(kind).from_json(parse_form(kind, sent(message_form(kind, value=plain))))
    assert octets(kind, read) == octets(kind, expected)


def test_an_empty_form_means_ros_defaults() -> None:
    for kind in map(schema, TYPES):
        read = lowerer(kind).from_json(parse_form(kind, sent(message_form(kind))))
        assert octets(kind, read) == octets(kind, lowerer(kind).from_json({}, defaults=True)), kind.ref


@pytest.mark.slow
@settings(max_examples=30)
@given(st.sampled_from(TYPES), st.lists(st.tuples(texts(), texts()), max_size=4), st.data())
def test_whatever_is_sent_is_json_or_refused_with_violations(
    name: str, strange: list[tuple[str, str]], data: st.DataObject
) -> None:
    kind = schema(name)
    fair = [(path, data.draw(st.one_of(texts(), st.just(text)))) for path, text in sent(message_form(kind))]
    violations = refusal(kind, fair + strange)
    assert page(refilled(message_form(kind), fair, violations)).forms == 1


def refusal(kind: MessageSchema, pairs: list[tuple[str, str]]) -> tuple[Violation, ...]:
    """Return why pairs are rejected; empty if they are not."""
    try:
        lowerer(kind).from_json(parse_form(kind, pairs))
    except LoweringError as error:
        return error.violations
    return ()


def test_what_was_typed_stands_in_the_form_again_beside_what_does_not_fit() -> None:
    kind = schema("geometry_msgs/msg/TwistStamped")
    typed = [("header.frame_id", "base"), ("twist.linear.x", "fast")]
    wrong = (Violation("twist.linear.x", "must be a number", "fast"),)
    form = refilled(message_form(kind, value={"twist": {"linear": {"x": 0.2}}}), typed, wrong)
    body = render_page(Page(SITE, "Topic", "/x", Document(URL, ()), ("GET", "PUT"), (form,))).decode()
    inputs = {each["name"]: each for each in Browser(body).inputs}
    assert inputs["twist.linear.x"]["value"] == "fast"
    assert inputs["twist.linear.x"]["type"] == "text"
    assert inputs["twist.linear.x"]["aria-invalid"] == "true"
    assert "aria-invalid" not in inputs["twist.linear.y"]
    assert body.index('value="fast"') < body.index("must be a number", body.index('value="fast"'))


def violations_of(kind: MessageSchema, pairs: list[tuple[str, str]]) -> list[Violation]:
    with pytest.raises(LoweringError) as refusal:
        parse_form(kind, pairs)
    return list(refusal.value.violations)


def test_a_text_that_is_no_value_is_refused_by_its_path() -> None:
    for name, text, words in (
        ("std_msgs/msg/Float64", "fast", "must be a number"),
        ("std_msgs/msg/Float64", "", "is empty"),
        ("std_msgs/msg/Float64", "1e999", "too large"),
        ("std_msgs/msg/Float64", "1_0", "must be a number"),
        ("std_msgs/msg/Float64", "9" * 5000, "must be a number"),
        ("std_msgs/msg/Int32", "1.5", "integer"),
        ("std_msgs/msg/Int32", "9" * 5000, "integer"),
        ("std_msgs/msg/Bool", "maybe", "true or false"),
    ):
        (found,) = violations_of(schema(name), [("data", text)])
        assert (found.path, found.value, words in found.message) == ("data", text, True), (name, text[:9])
    kind = schema("sensor_msgs/msg/JointState")
    for text in ("", "[1, 2", "[" * 5000, "[NaN]", '{"a":1,"a":2}'):
        pairs = [(name, text if name == "position" else given) for name, given in sent(message_form(kind))]
        assert [each.path for each in violations_of(kind, pairs)] == ["position"]


def test_missing_unknown_and_repeated_fields_are_refused_together() -> None:
    pairs = [("linear.x", "1"), ("linear.x", "2"), ("linear.q", "3"), ("__proto__", "4")]
    said = {(each.path, each.message) for each in violations_of(schema("geometry_msgs/msg/Twist"), pairs)}
    assert ("linear.x", "is given twice") in said
    assert ("linear.y", "is missing") in said
    assert ("linear.q", "is not a field of geometry_msgs/msg/Twist") in said
    assert ("__proto__", "is not a field of geometry_msgs/msg/Twist") in said


def test_headers_and_covariances_are_folded_unless_they_do_not_fit_and_sent_all_the_same() -> None:
    form = message_form(schema("nav_msgs/msg/Odometry"))
    wrong = refilled(form, sent(form), [Violation("header.stamp.sec", "is no number", "x")])
    folded = []
    for each in (form, wrong):
        drawn = render_page(Page(SITE, "Topic", "/x", Document(URL, ()), ("PUT",), (each,))).decode()
        folded.append(re.findall(r'<details class="fold" data-key="fold ([^"]+)">', drawn))
    assert folded[0] == ["header", "header.stamp", "pose.covariance", "twist.covariance"]
    assert folded[1] == ["pose.covariance", "twist.covariance"]
    assert {"header.frame_id", "header.stamp.sec", "pose.covariance"} <= {name for name, _ in sent(form)}


def test_a_field_called_method_or_csrf_is_a_field() -> None:
    kind = LIBRARY.learn_message("odd_msgs/msg/Odd", "string method\nstring csrf\n")
    form = message_form(kind, value={"method": "none", "csrf": "none either"})
    assert parse_form(kind, sent(form)) == {"method": "none", "csrf": "none either"}


def twice(name: str, level: int) -> MessageType:
    inner = Nested(f"deep_msgs/msg/L{level}")
    return MessageType(name, (Field("a", inner, "a"), Field("b", inner, "b")))


def test_types_that_nest_without_end_in_sight_have_forms_of_finite_size() -> None:
    """Forty levels, each with the next one twice, would be a million million inputs."""
    types = {f"deep_msgs/msg/L{level}": twice(f"deep_msgs/msg/L{level}", level + 1) for level in range(40)}
    types["deep_msgs/msg/L40"] = MessageType("deep_msgs/msg/L40", (Field("x", Primitive("int8"), "x"),))
    kind = dataclasses.replace(schema("std_msgs/msg/Empty"), ref=TypeRef("deep_msgs/msg/L0", "0"), types=types)
    inputs = page(message_form(kind, value={})).inputs
    assert [each["tag"] for each in inputs if each.get("name") in ("a", "b")] == ["textarea", "textarea"]
    assert len(inputs) < 10


def test_what_is_elided_or_too_long_is_left_to_be_typed() -> None:
    kind = schema("sensor_msgs/msg/JointState")
    elided: Json = {"elided": True, "length": 70000, "href": "?field=position"}
    inputs = {each.get("name"): each for each in page(message_form(kind, value={"position": elided})).inputs}
    assert "required" in inputs["position"]
    pairs = dict(sent(message_form(kind, value={"position": elided, "velocity": [0.123456789] * 9000})))
    assert pairs["position"] == pairs["velocity"] == ""


def test_strings_that_a_browser_would_change_are_not_offered_to_be_changed() -> None:
    form = message_form(schema("std_msgs/msg/String"), value={"data": "bell\x07 and return\r"})
    assert dict(sent(form)) == {"data": ""}


def test_inputs_follow_the_type_of_their_field() -> None:
    for name, attributes in (
        ("std_msgs/msg/Int8", {"type": "number", "min": "-128", "max": "127", "step": "1"}),
        ("std_msgs/msg/UInt64", {"type": "number", "min": "0", "max": "18446744073709551615", "step": "1"}),
        ("std_msgs/msg/Float32", {"type": "number", "step": "any"}),
        ("std_msgs/msg/Bool", {"type": "checkbox", "value": "true"}),
        ("std_msgs/msg/String", {"type": "text"}),
    ):
        found = next(each for each in page(message_form(schema(name))).inputs if each["name"] == "data")
        assert {key: found.get(key) for key in attributes} == attributes, name


JSON = st.recursive(
    st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | texts(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts(), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=50)
@given(JSON)
def test_a_parameter_form_sent_untouched_means_the_present_value(value: object) -> None:
    if isinstance(value, int) and abs(value) >= 10**39:
        return
    read = parse_value(OpenShape(), sent(ValueForm(OpenShape(), value=value)))  # type: ignore[arg-type]
    assert (read, type(read)) == (value, type(value))


# Values of properties

PRIMITIVES = st.sampled_from([Primitive(name) for name in ("bool", "int8", "uint64", "float32", "float64", "string")])


@settings(max_examples=50)
@given(st.data())
def test_a_scalars_form_sent_untouched_means_the_present_value(data: st.DataObject) -> None:
    kind = data.draw(PRIMITIVES)
    value = data.draw(values(kind, schema("std_msgs/msg/Empty")))
    read = parse_value(ScalarShape(kind), sent(ValueForm(ScalarShape(kind), value=value)))  # type: ignore[arg-type]
    one = LIBRARY.learn_message(f"odd_msgs/msg/One{kind.name.capitalize()}", f"{kind.name} data\n")
    as_read, as_it_was = (lowerer(one).from_json({"data": each}) for each in (read, value))
    assert octets(one, as_read) == octets(one, as_it_was)


CHOICES = (Literal("on"), Literal(2), Literal(0.5), Literal(True))


def test_a_choice_is_read_as_its_type_and_an_unchecked_box_is_false() -> None:
    for text, value in (("on", "on"), ("2", 2), ("0.5", 0.5), ("true", True)):
        read = parse_value(OpenShape(Bounds(choices=CHOICES)), [("value", text)])
        assert (read, type(read)) == (value, type(value))
    choices: dict[str, tuple[Json, ...]] = {
        "string": ("a", "b"), "bool": (True, False), "int8": (1, 2), "float64": (0.5, 1.5)
    }  # fmt: skip
    for kind, (other, wanted) in choices.items():
        shape = ScalarShape(Primitive(kind), Bounds(choices=(Literal(other), Literal(wanted))))  # type: ignore[arg-type]
        assert parse_value(shape, sent(ValueForm(shape, value=wanted))) == wanted
    assert parse_value(ScalarShape(Primitive("bool")), []) is False


def test_a_value_that_is_none_is_refused() -> None:
    twist = schema("geometry_msgs/msg/Twist")
    refused: tuple[tuple[ValueShape, list[tuple[str, str]], str], ...] = (
        (ScalarShape(Primitive("float64")), [], "is missing"),
        (ScalarShape(Primitive("float64")), [("value", "")], "is empty"),
        (ScalarShape(Primitive("int8")), [("value", "1.5")], "integer"),
        (ScalarShape(Primitive("bool")), [("value", "maybe")], "true or false"),
        (ScalarShape(Primitive("string")), [("value", "a"), ("value", "b")], "given twice"),
        (ScalarShape(Primitive("string")), [("value", "a"), ("data", "b")], "not a field of this form"),
        (OpenShape(Bounds(choices=CHOICES)), [("value", "off")], "must be one of on, 2, 0.5, true"),
        (OpenShape(), [("type", "number"), ("value", "many")], "must be a number"),
        (MessageShape(twist, twist.type.fields[:1]), [("angular.x", "1")], "is not a field of"),
    )
    for shape, pairs, words in refused:
        with pytest.raises(LoweringError) as refusal:
            parse_value(shape, pairs)
        assert any(words in each.message for each in refusal.value.violations), words
        assert page(refilled(ValueForm(shape), pairs, refusal.value.violations)).forms == 1


@settings(max_examples=30)
@given(PRIMITIVES, st.lists(st.tuples(st.sampled_from(["value", "type", "x"]), texts()), max_size=4), texts())
def test_whatever_is_sent_for_a_value_is_read_or_refused(
    kind: Primitive, pairs: list[tuple[str, str]], option: str
) -> None:
    bounds = Bounds(choices=(Literal(option),))
    for shape in (ScalarShape(kind), ScalarShape(kind, bounds), OpenShape(), OpenShape(bounds)):
        violations: tuple[Violation, ...] = ()
        try:
            parse_value(shape, pairs)
        except LoweringError as error:
            violations = error.violations
        assert page(refilled(ValueForm(shape), pairs, violations)).forms == 1


def test_bounds_of_fields_are_attributes_of_their_inputs() -> None:
    kind = schema("geometry_msgs/msg/TwistStamped")
    bounds = {
        "twist.linear.x": Bounds(minimum=Literal(-1), maximum=Literal(1)),
        "header.frame_id": Bounds(pattern="^[a-z]+$", min_length=1, max_length=9),
        "header.seq": Bounds(choices=(Literal(1), Literal(2))),
    }
    form = ValueForm(MessageShape(kind, kind.type.fields, bounds), value={"header": {"seq": 2}})
    inputs = {each["name"]: each for each in page(form).inputs}
    assert (inputs["twist.linear.x"]["min"], inputs["twist.linear.x"]["max"]) == ("-1", "1")
    frame = inputs["header.frame_id"]
    assert (frame["pattern"], frame["minlength"], frame["maxlength"]) == (".*(?:^[a-z]+$).*", "1", "9")
    assert "required" in frame
    assert inputs["header.seq"]["tag"] == "select"
    assert "min" not in inputs["twist.linear.y"]
    assert dict(sent(form))["header.seq"] == "2"
