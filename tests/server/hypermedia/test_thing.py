"""Thing Descriptions: valid according to the W3C's own schema, with data schemas that accept every value."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal

from rosld.adapters.model import (
    Field,
    Message,
    MessageSchema,
    MessageType,
    Nested,
    Primitive,
    TypeRef,
)
from rosld.ontology.coercion import RANGES
from rosld.ontology.lift import LiftSettings
from rosld.ontology.units import Quantity
from rosld.ontology.vocab import av, xsd
from rosld.server.hypermedia.json_schema import JsonSchema, MessageSchemas, message_schema, patch_schema, value_schema
from rosld.server.hypermedia.thing_description import ThingLink, thing_description
from rosld.server.hypermedia.value import MessageValue, plain_json
from rosld.server.hypermedia.views import ActionAffordance, PropertyAffordance
from rosld.shapes.value import Bounds, MessageShape, OpenShape, ScalarShape, ValueShape
from tests.agents.node import node_modules
from tests.ontology.test_roundtrip import Filler
from tests.server.html.messages import LIBRARY
from tests.server.html.messages import schema as schema_of

JUDGE = Path(__file__).with_name("judge.cjs")
URL = "http://127.0.0.1:8080/resources/aircraft/"
KMH = "http://qudt.org/vocab/unit/KiloM-PER-HR"
SPEED = "http://qudt.org/vocab/quantitykind/Speed"
POWER = ScalarShape(Primitive("string"), Bounds(choices=(Literal("on"), Literal("off"))))


TRIGGER, SET_BOOL = schema_of("std_srvs/srv/Trigger_Request"), schema_of("std_srvs/srv/SetBool_Request")
POSE, IMAGE = schema_of("geometry_msgs/msg/PoseStamped"), schema_of("sensor_msgs/msg/Image")


def judged(pairs: Sequence[tuple[object, object]]) -> list[list[str]]:
    """Return the errors for pairs of a schema (`"td"` for that of Thing Descriptions) and a value, by Ajv."""
    command = ["node", str(JUDGE), str(node_modules())]
    done = subprocess.run(command, input=json.dumps(pairs).encode(), capture_output=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    verdicts: list[list[str]] = json.loads(done.stdout)
    return verdicts


def number(value: str) -> Literal:
    return Literal(value, datatype=xsd.decimal if "." in value else xsd.integer)


def scalar(kind: str, quantity: Quantity | None = None, **bounds: Literal) -> ScalarShape:
    return ScalarShape(Primitive(kind), Bounds(**bounds), quantity or Quantity())  # type: ignore[arg-type]


def whole(schema: MessageSchema) -> MessageShape:
    return MessageShape(schema, schema.type.fields)


THOUSAND = scalar("float64", Quantity(KMH, SPEED), minimum=number("0"), maximum=number("1000"))
PROPERTIES = (
    PropertyAffordance("power", URL + "power", POWER, av.power, write=True, title="Power"),
    PropertyAffordance("engine/speed", URL + "engine/speed", THOUSAND, av.speed, write=True, observe=True),
    PropertyAffordance("pose", URL + "pose", whole(POSE), observe=True),
    PropertyAffordance("image", URL + "image", whole(IMAGE)),
    PropertyAffordance("seats", URL + "seats", OpenShape(), write=True),
    PropertyAffordance("goal", URL + "goal", whole(POSE), read=False, write=True),
    PropertyAffordance("dead", URL + "dead", OpenShape(), read=False),
)
ACTIONS = (
    ActionAffordance("start", URL + "start", TRIGGER, av.start, "Start"),
    ActionAffordance("lights", URL + "lights", SET_BOOL),
    ActionAffordance("unknown", URL + "unknown", None),
)
LINKS = (
    ThingLink("collection", "http://127.0.0.1:8080/resources/"),
    ThingLink(av.engine.value, URL + "engine/"),
    ThingLink("type", "https://w3id.org/rosld", None),
)


def thing(*, whole: bool = False) -> Any:
    return json.loads(
        thing_description("Aircraft", URL, PROPERTIES, ACTIONS, links=LINKS, description="It flies.", whole=whole)
    )


NAMES = st.text(st.characters(exclude_categories=["Cs"]), max_size=8) | st.sampled_from(
    ['"', "a/b", "</script>", "ü💡", "__proto__", "constructor", "@type", "", "x\ny"]
)


@pytest.mark.slow
def test_thing_descriptions_are_valid_by_the_schema_of_the_w3c_whatever_the_names_and_types() -> None:
    empty = thing_description("Nothing", URL, (), ())
    evil = [PropertyAffordance(f"evil{each}", URL + "evil", whole(recursive(each))) for each in (1, 10)]
    grown = thing_description("Evil", URL, evil, [])
    assert len(grown) < 1_000_000, "a type that contains itself, or grows without end, has a small schema"
    things = [thing(), thing(whole=True), json.loads(empty), json.loads(grown)]

    @settings(max_examples=40, deadline=None, phases=[Phase.generate])
    @given(NAMES)
    def collect(name: str) -> None:
        shape = ScalarShape(Primitive("string"), Bounds(choices=(Literal(name),)))
        properties = [PropertyAffordance(name, URL + "x", shape, title=name)]
        actions = [ActionAffordance(name, URL + "y", SET_BOOL, title=name)]
        described = json.loads(thing_description(name, URL, properties, actions, description=name))
        assert list(described["properties"]) == list(described["actions"]) == [name]
        things.append(described)

    collect()
    *errors, broken = judged([("td", each) for each in (*things, thing() | {"security": 1})])
    assert not any(errors)
    assert broken


def test_a_property_has_its_data_schema_and_a_form_for_each_operation() -> None:
    speed = thing()["properties"]["engine/speed"]
    forms = speed.pop("forms")
    assert speed == {
        "oneOf": [{"type": "number"}, {"type": "null"}],
        "minimum": 0,
        "maximum": 1000,
        "unit": KMH,
        "readOnly": False,
        "writeOnly": False,
        "observable": True,
        "map:predicate": {"@id": av.speed.value},
        "qudt:hasUnit": {"@id": KMH},
        "qudt:hasQuantityKind": {"@id": SPEED},
    }
    target = {"href": URL + "engine/speed", "contentType": "application/json"}
    assert forms == [
        {**target, "op": "readproperty", "htv:methodName": "GET"},
        {**target, "op": "writeproperty", "htv:methodName": "PUT"},
        {**target, "op": ["observeproperty", "unobserveproperty"], "htv:methodName": "GET", "subprotocol": "sse"},
    ]


def test_what_can_only_be_read_or_only_be_written_says_so_and_the_rest_is_left_out() -> None:
    properties = thing()["properties"]
    for name, only, operation in (("pose", "readOnly", "readproperty"), ("goal", "writeOnly", "writeproperty")):
        assert properties[name][only] is True
        assert properties[name]["forms"][0]["op"] == operation
    assert properties["goal"]["observable"] is False
    assert "dead" not in properties
    assert list(thing()["actions"]) == ["start", "lights"]
    plain, elided = properties["image"]["properties"]["data"]["oneOf"]
    assert plain == {"type": "string", "contentEncoding": "base64"}
    assert elided["required"] == ["elided", "length", "href"]


SCALARS: list[tuple[ValueShape, JsonSchema]] = (
    [
        (scalar("bool"), {"type": "boolean"}),
        (scalar("uint8"), {"type": "integer", "minimum": 0, "maximum": 255}),
        (scalar("int16"), {"type": "integer", "minimum": -32768, "maximum": 32767}),
        (scalar("int32", minimum=number("0")), {"type": "integer", "minimum": 0, "maximum": 2147483647}),
        (scalar("int64", minimum=number("-5"), exclusive_maximum=number("7")),
         {"type": "integer", "minimum": -5, "exclusiveMaximum": 7}),
        (scalar("float32", exclusive_minimum=number("0.5")), {"type": "number", "exclusiveMinimum": 0.5}),
        (scalar("string"), {"type": "string"}),
        (ScalarShape(Primitive("string", 8)), {"type": "string", "maxLength": 8}),
        (ScalarShape(Primitive("string", 8), Bounds(min_length=1, max_length=20, pattern="^[a-z]+$")),
         {"type": "string", "minLength": 1, "maxLength": 8, "pattern": "^[a-z]+$"}),
        (POWER, {"type": "string", "enum": ["on", "off"]}),
        (ScalarShape(Primitive("int8"), Bounds(choices=(number("1"), number("2"), number("01")))),
         {"type": "integer", "enum": [1, 2]}),
        (ScalarShape(Primitive("float64"), Bounds(choices=(number("1.5"), Literal("NaN", datatype=xsd.double)))),
         {"enum": [1.5, "NaN"]}),
        (ScalarShape(Primitive("uint64"), Bounds(choices=(number("18446744073709551615"),))),
         {"enum": ["18446744073709551615"]}),
        (OpenShape(), {}),
        (OpenShape(Bounds(minimum=number("1"))), {"type": "number", "minimum": 1}),
        (OpenShape(Bounds(choices=(Literal("true", datatype=xsd.boolean), Literal("a"), number("1")))),
         {"enum": [True, "a", 1]}),
        (OpenShape(Bounds(minimum=Literal("2026-01-01T00:00:00Z", datatype=xsd.dateTime))), {}),
        (OpenShape(Bounds(minimum=Literal("INF", datatype=xsd.double))), {}),
        (OpenShape(quantity=Quantity(KMH)), {"unit": KMH}),
    ]
)  # fmt: skip


def test_scalars_have_plain_schemas() -> None:
    wrong = {str(shape): value_schema(shape) for shape, expected in SCALARS if value_schema(shape) != expected}
    assert not wrong, wrong


def test_only_patterns_that_mean_the_same_in_ecmascript_are_kept() -> None:
    portable = (r"^\d{3}-[A-Z]\.$", r"^(?:on|off)$", r"[^\-(a-z]{1,2}\]")
    others = (r"\i\c*", r"\p{IsGreek}", r"[a-z-[aeiou]]", r"(?i)on", r"a\-b", r"a{,3}", r"a]")
    for pattern in (*portable, *others):
        schema = value_schema(ScalarShape(Primitive("string"), Bounds(pattern=pattern)))
        assert ("pattern" in schema) is (pattern in portable), pattern


def test_a_part_of_a_message_is_the_object_of_that_part_with_its_limits() -> None:
    shape = MessageShape(
        POSE, POSE.type.fields[1:], {"pose.position.x": Bounds(minimum=number("0"), maximum=number("9"))}
    )
    found = json.dumps(value_schema(shape))
    assert json.loads(found)["required"] == ["pose"]
    unit = "http://qudt.org/vocab/unit/M"
    assert f'"x": {{"type": "number", "minimum": 0, "maximum": 9, "unit": "{unit}"}}' in found
    assert "header" not in found


def test_what_only_the_server_says_is_not_to_be_sent() -> None:
    octets = {"type": "string", "contentEncoding": "base64"}
    schemas, schema = MessageSchemas(lambda ref: None, LiftSettings()), schema_of("sensor_msgs/msg/Image")
    image = MessageShape(schema, schema.type.fields[-1:])
    read, sent = schemas.value(image), schemas.value(image, sent=True)
    assert read["required"] == ["data"]
    assert '"readOnly": true' in json.dumps(read)
    assert sent == {"type": "object", "properties": {"data": {**octets, "default": ""}}}
    assert patch_schema(sent) == {"type": "object", "properties": {"data": octets}}
    speed = ScalarShape(Primitive("float64"), quantity=Quantity(KMH))
    assert schemas.value(speed, sent=True) == {"type": "number", "x-unit": KMH}


def recursive(breadth: int) -> MessageSchema:
    kinds = {
        f"evil/msg/T{depth}": MessageType(
            f"evil/msg/T{depth}",
            tuple(Field(f"f{index}", Nested(f"evil/msg/T{(depth + 1) % 40}"), f"f{index}") for index in range(breadth)),
        )
        for depth in range(40)
    }
    return MessageSchema(TypeRef("evil/msg/T0", "0"), kinds, "", POSE.codec)


TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)


EVERYTHING = LIBRARY.learn_message(
    "test_msgs/msg/Everything",
    "\n".join(
        [f"{kind} a_{kind}\n{kind}[] some_{kind}\n{kind}[3] three_{kind}" for kind in (*RANGES, "bool", "string")]
        + [f"{kind} a_{kind}\n{kind}[] some_{kind}\n{kind}[2] two_{kind}" for kind in ("float32", "float64")]
        + ["time stamp", "duration lasting", "geometry_msgs/Pose[] poses", "geometry_msgs/Pose[2] two_poses"]
    ),
)
TYPES = [
    EVERYTHING,
    *map(schema_of, ("sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState", "nav_msgs/msg/Path", "std_msgs/msg/Int64")),
]


def misfits() -> Iterator[tuple[JsonSchema, object]]:
    """Yield pairs of a schema and a value: one that fits, and others that do not."""
    right = {"a_uint8": 255, "stamp": {"sec": 0, "nanosec": 0}}
    schema = {**message_schema(EVERYTHING), "required": list(right)}
    yield schema, right
    for wrong in (
        {"a_uint8": 256},
        {"a_uint8": "255"},
        {"stamp": {"sec": 0}},
        {"a_float64": "infinite"},
        {"two_float32": [1.0]},
        {"a_int64": "12"},
        {"two_poses": []},
    ):
        yield schema, right | wrong


@pytest.mark.slow
def test_the_plain_json_of_every_message_fits_its_data_schema_and_nothing_else_does() -> None:
    pairs: list[tuple[object, object]] = []

    @settings(
        max_examples=80, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck), database=None
    )
    @given(st.sampled_from(TYPES).flatmap(lambda s: st.tuples(st.just(s), Filler(s, TEXTS).message(s.ref.name))))
    def collect(drawing: tuple[MessageSchema, Message]) -> None:
        schema, message = drawing
        fields = schema.type.fields
        value = MessageValue(schema, message, fields, URL)
        for lifting in (LiftSettings(), LiftSettings(inline_limit=64)):
            single = fields[0].type if len(fields) == 1 else None
            shape = ScalarShape(single) if isinstance(single, Primitive) else whole(schema)
            pairs.append((value_schema(shape, lifting), json.loads(plain_json(value, lifting))))

    collect()
    errors = judged([*pairs, *misfits()])
    assert not any(errors[: len(pairs) + 1])
    assert all(errors[len(pairs) + 1 :])
