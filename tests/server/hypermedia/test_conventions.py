"""Conventions: the resources that follow from a robot's names and types."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TypeVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosld.adapters.model import (
    Array,
    Field,
    FieldType,
    Graph,
    MessageSchema,
    MessageType,
    Nested,
    Parameter,
    Primitive,
    Schema,
    Service,
    ServiceSchema,
    Topic,
    TypeRef,
    UnknownType,
    freeze,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.lift import lifter
from rosld.ontology.lower import lowerer
from rosld.server.hypermedia.catalogue import (
    Catalogue,
    Getter,
    ParameterSource,
    Property,
    Setter,
    TopicSource,
)
from rosld.server.hypermedia.conventions import CONVENTIONS, Conventions, catalogue, needed_types
from rosld.server.hypermedia.type_inference import is_convertible, is_small, value_fields
from rosld.shapes.value import MessageShape, OpenShape, ScalarShape, ValueShape, value_shape

_V = TypeVar("_V")

LIBRARY = TypeLibrary(ros_version=1)

SERVICES = {
    # name: request, response
    "GetBool": ("", "bool data"),
    "GetInt": ("", "int32 data"),
    "GetFloat": ("", "float64 value"),
    "GetText": ("", "string text"),
    "GetTold": ("", "bool success\nstring status_message\nfloat64 value"),
    "GetBusy": ("", "float64 value\nstring message"),
    "GetWords": ("", "string message"),
    "GetVerdict": ("", "bool success"),
    "GetCount": ("", "int32 success\nstring message"),
    "GetPose": ("", "float32 y\nfloat32 x\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity"),
    "GetPoint": ("", "bool success\nstring message\ngeometry_msgs/Point point\nint32 layer"),
    "GetPair": ("", "float64[2] pair"),
    "GetMany": ("", "float64[65] many"),
    "GetAll": ("", "float64[] all"),
    "GetMatrix": ("", "geometry_msgs/Twist[60] rows"),
    "GetCovariances": ("", "geometry_msgs/PoseWithCovariance[2] each"),
    "GetAt": ("float64 when", "float64 value"),
    "SetBool": ("bool on", ""),
    "SetByte": ("uint8 data", ""),
    "SetInt": ("int64 data", "bool success\nstring message"),
    "SetFloat": ("float32 data", "bool success\nstring message"),
    "SetText": ("string text", "bool success\nstring message"),
    "SetPose": ("float32 x\nfloat32 y\nfloat32 theta\nfloat32 linear_velocity\nfloat32 angular_velocity", ""),
    "SetXY": ("float64 x\nfloat64 y", ""),
    "SetPoint": ("geometry_msgs/Point point\nint32 layer", ""),
    "SetPair": ("float64[2] pair", ""),
}
for _name, (_request, _response) in SERVICES.items():
    LIBRARY.learn_service(f"demo/srv/{_name}", f"{_request}\n---\n{_response}\n")


def known(ref: TypeRef) -> Schema | None:
    try:
        return LIBRARY.find(ref)
    except UnknownType:
        return None


def message(name: str) -> MessageSchema:
    schema = LIBRARY.find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    return schema


def service(name: str) -> ServiceSchema:
    schema = LIBRARY.find(TypeRef(name if "/" in name else f"demo/srv/{name}"))
    assert isinstance(schema, ServiceSchema)
    return schema


def graph(
    topics: Mapping[str, Iterable[str] | str] | None = None,
    services: Mapping[str, str | None] | None = None,
    parameters: Iterable[str | Parameter] = (),
) -> Graph:
    """Return a graph: types by name, those of `SERVICES` by their last word; None and () for unknown types."""
    own = [each if isinstance(each, Parameter) else Parameter(each) for each in parameters]
    return Graph(
        1,
        topics=freeze({name: Topic(name, _refs(types)) for name, types in (topics or {}).items()}),
        services=freeze({name: Service(name, _service(kind)) for name, kind in (services or {}).items()}),
        parameters=freeze({each.name: each for each in own}),
    )


def _refs(types: Iterable[str] | str) -> tuple[TypeRef, ...]:
    return tuple(TypeRef(name) for name in ([types] if isinstance(types, str) else types))


def _service(kind: str | None) -> TypeRef | None:
    return None if kind is None else TypeRef(kind if "/" in kind else f"demo/srv/{kind}")


def found(
    topics: Mapping[str, Iterable[str] | str] | None = None,
    services: Mapping[str, str | None] | None = None,
    parameters: Iterable[str | Parameter] = (),
    conventions: Conventions = CONVENTIONS,
) -> Catalogue:
    return catalogue(graph(topics, services, parameters), known, conventions)


def sources(one: Property) -> tuple[list[str], list[str]]:
    """Return the readers and writers of a property, by kind and name."""
    return [_told(each) for each in one.readers], [_told(each) for each in one.writers]


def _told(source: object) -> str:
    assert isinstance(source, TopicSource | Getter | Setter | ParameterSource)
    return f"{type(source).__name__.removesuffix('Source').lower()} {source.name}"


FLOAT = "std_msgs/msg/Float64"


class TestNames:
    def test_the_names_of_services_say_which_property_they_read_and_write(self) -> None:
        read = {
            "/get_power": "/power",
            "/a/b/get_power": "/a/b/power",
            "/a/getPower": "/a/power",
            "/a/getX": "/a/x",
            "/a/getURL": "/a/URL",
            "/a/getXPos": "/a/XPos",
            "/a/getÉtat": "/a/état",
            "/a/power/get": "/a/power",
            "/a//get_x\n y": "/a//x\n y",
            "/a/get_get_x": "/a/get_x",
            "/get/get": "/get",
        }
        assert {name: list(found(services={name: "GetFloat"}).properties) for name in read} == {
            name: [one] for name, one in read.items()
        }
        for name in ("/get", "/a/get_", "/a/getter", "/get/x", "/a/forget_x", "/get_x/y", "/a/get2d", "/a/Get_x"):
            listing = found(services={name: "GetFloat"})
            assert (list(listing.properties), list(listing.actions)) == ([], [name])
        listing = found(services={"/a/set_x": "SetFloat", "/a/setSpeed": "SetFloat", "/a/z/set": "SetFloat"})
        assert listing.by_service == {"/a/set_x": "/a/x", "/a/setSpeed": "/a/speed", "/a/z/set": "/a/z"}


class TestGetters:
    def test_the_value_is_what_a_small_response_holds_beside_its_status(self) -> None:
        expected = {
            "GetFloat": ["value"],
            "GetTold": ["value"],
            "GetBusy": ["value", "message"],
            "GetWords": ["message"],
            "GetCount": ["success", "message"],
            "GetPoint": ["point", "layer"],
            "GetPair": ["pair"],
            "GetMatrix": ["rows"],
        }
        for kind, fields in expected.items():
            assert [field.name for field in value_fields(service(kind))] == fields
            assert list(found(services={"/a/get_x": kind}).properties) == ["/a/x"]

    def test_a_service_that_may_act_or_answers_much_is_an_action_whatever_its_name(self) -> None:
        kinds = ("std_srvs/srv/Trigger", "GetVerdict", "GetAt", "GetMany", "GetAll", "GetCovariances")
        for kind in kinds:
            listing = found(services={"/a/get_coffee": kind})
            assert not listing.properties
            assert [(one.service, one.schema) for one in listing.actions.values()] == [("/a/get_coffee", service(kind))]

    def test_a_type_is_judged_at_once_however_it_nests(self) -> None:
        assert not is_small(made({"A": [("b", Nested("B"))], "B": [("a", Nested("A"))]}))
        layers: dict[str, list[tuple[str, FieldType]]] = {
            f"T{n}": [(side, Nested(f"T{n + 1}")) for side in "abcd"] for n in range(100)
        }
        assert is_small(made({**layers, "T100": [("x", Primitive("bool"))]}, "T0"))
        assert not is_small(made({**layers, "T100": [("x", Array(Primitive("bool")))]}, "T0"))

    def test_the_first_convention_wins_and_the_other_getters_are_actions(self) -> None:
        listing = found(services={"/a/x/get": "GetInt", "/a/getX": "GetInt", "/a/get_x": "GetInt"})
        assert sources(listing.properties["/a/x"]) == (["getter /a/get_x"], [])
        assert list(listing.actions) == ["/a/getX", "/a/x/get"]
        listing = found(services={"/a/getX": "GetInt", "/a/get_x": "std_srvs/srv/Trigger"})
        assert sources(listing.properties["/a/x"]) == (["getter /a/getX"], [])


def made(types: Mapping[str, Iterable[tuple[str, FieldType]]], root: str = "A") -> MessageSchema:
    """Return a schema of types that no definition could have."""
    codec = message(FLOAT).codec
    layouts = {
        name: MessageType(name, tuple(Field(field, kind, field) for field, kind in fields))
        for name, fields in types.items()
    }
    return MessageSchema(TypeRef(root, "0"), layouts, "", codec)


class TestSetters:
    def test_a_setter_takes_the_same_fields_or_one_scalar(self) -> None:
        setters = [
            (FLOAT, "SetFloat"),
            ("std_msgs/msg/UInt64", "SetByte"),
            ("std_msgs/msg/Bool", "SetBool"),
            ("std_msgs/msg/String", "SetText"),
            ("turtlesim/msg/Pose", "SetPose"),
        ]
        for topic, setter in setters:
            listing = found({"/a/x": topic}, {"/a/set_x": setter})
            assert sources(listing.properties["/a/x"]) == (["topic /a/x"], ["setter /a/set_x", "topic /a/x"])
            assert not listing.actions
        others = [
            (FLOAT, "SetInt"),
            (FLOAT, "SetText"),
            ("std_msgs/msg/String", "SetBool"),
            ("std_msgs/msg/Int32", "SetBool"),
            ("geometry_msgs/msg/Point", "SetXY"),
            ("turtlesim/msg/Pose", "SetFloat"),
            (FLOAT, "SetXY"),
            ("std_msgs/msg/Empty", "SetFloat"),
            (FLOAT, "std_srvs/srv/Trigger"),
        ]
        for topic, setter in others:
            listing = found({"/a/x": topic}, {"/a/set_x": setter})
            assert sources(listing.properties["/a/x"]) == (["topic /a/x"], ["topic /a/x"])
            assert list(listing.actions) == ["/a/set_x"]


class TestTopics:
    def test_a_topic_of_no_known_type_can_only_be_read(self) -> None:
        for types in ((), ("nowhere/msg/X",), (FLOAT, "std_msgs/msg/String"), ("std_srvs/srv/Empty",)):
            one = found({"/x": types}).properties["/x"]
            assert one == Property("/x", OpenShape(), (TopicSource("/x", None),), ())

    def test_a_getter_joins_a_topic_of_its_kind_alone(self) -> None:
        listing = found(
            {"/t": "turtlesim/msg/Pose", "/x": FLOAT}, {"/get_t": "GetPose", "/get_x": "GetInt", "/set_x": "SetFloat"}
        )
        assert sources(listing.properties["/t"])[0] == ["topic /t", "getter /get_t"]
        assert sources(listing.properties["/x"]) == (["topic /x", "getter /get_x"], ["setter /set_x", "topic /x"])
        assert listing.properties["/x"].shape == ScalarShape(Primitive("float64"))
        others = {
            "turtlesim/msg/Pose": "GetFloat",
            FLOAT: "GetText",
            "std_msgs/msg/Int32": "GetFloat",
            "geometry_msgs/msg/Point": "GetPoint",
        }
        for topic, getter in others.items():
            listing = found({"/x": topic}, {"/get_x": getter})
            assert sources(listing.properties["/x"])[0] == ["topic /x"]
            assert list(listing.actions) == ["/get_x"]


class TestParameters:
    def test_parameters_that_ros_2_gives_every_node_are_left_out(self) -> None:
        for name in ("use_sim_time", "start_type_description_service", "qos_overrides./cmd_vel.publisher.depth"):
            assert found(parameters=[Parameter(f"/talker/{name}", node="/talker")]) == found()
            assert found(parameters=[Parameter(f"/talker/{name}")]) != found()  # ROS 1 gives nodes no parameters
        assert list(found(parameters=[Parameter("/talker/rate", node="/talker")]).properties) == ["/talker/rate"]


class TestExcluded:
    def test_services_that_every_node_has_are_in_no_resource(self) -> None:
        excluded = (
            *("/talker/get_loggers", "/talker/set_logger_level", "/camera/driver/set_parameters", "/get_loggers"),
            *("/talker/describe_parameters", "/talker/get_parameters", "/talker/get_parameter_types"),
            *("/talker/list_parameters", "/talker/set_parameters_atomically", "/talker/get_type_description"),
            *("/fibonacci/_action/send_goal", "/_ros2cli_daemon/get_x"),
        )
        for name in excluded:
            assert found(services={name: "GetFloat"}) == found(services={name: None}) == found()
            assert needed_types(graph(services={name: "GetFloat"})) == ()
        told = graph(services={"/talker/loggers": "std_srvs/srv/SetBool", "/talker/silent": None})
        assert [ref.name for ref in needed_types(told)] == ["std_srvs/srv/SetBool"]
        for name in ("/talker/loggers", "/a/get_loggers_x", "/get_loggers/x", "/a_b/c_"):
            assert list(found(services={name: "std_srvs/srv/Empty"}).actions) == [name]
        assert found({"/a/_action/feedback": FLOAT}) == found()
        assert list(found({"/a/_b/c": FLOAT}).properties) == ["/a/_b/c"]

    def test_topics_of_other_types_that_are_called_as_those_of_an_action_are_properties_nobody_may_write(self) -> None:
        names = sorted(f"/a/{part}" for part in ("goal", "cancel", "status", "feedback", "result"))
        told = graph(dict.fromkeys(names, FLOAT))
        assert list(catalogue(told, known).properties) == names
        assert all(map(told.is_of_action, names))


class TestExtended:
    def test_a_template_that_makes_no_sense_is_refused_with_the_reason(self) -> None:
        reasons = {
            "exactly once": ("get", "", "{name}_{name}", "{name}/{Name}", "{NAME}"),
            "matches every service": ("{name}", "{Name}"),
            "braces": ("get_{name}{x}", "get_{{name}"),
            "slash": ("/get_{name}", "{name}/", "a//{name}"),
        }
        for words, templates in reasons.items():
            for template in templates:
                with pytest.raises(ValueError, match=words) as caught:
                    CONVENTIONS.extend(getters=[template])
                assert repr(template) in str(caught.value)
        with pytest.raises(ValueError, match="slash"):
            CONVENTIONS.extend(setters=["/set_{name}"])

    def test_a_glob_that_matches_nothing_is_refused_with_one_that_might(self) -> None:
        for glob in ("", "get_loggers", "robot/*"):
            with pytest.raises(ValueError, match=r"begin with a slash: try '\*/"):
                CONVENTIONS.extend(excluded=[glob])

    def test_a_template_is_no_regular_expression(self) -> None:
        for template in ("(.*){name}", "{name}[a-z]+", ".{name}|x", "\\{name}$"):
            services = {f"/a/{template.replace('{name}', 'x')}": "GetInt", "/a/yz": "GetInt"}
            listing = found(services=services, conventions=CONVENTIONS.extend(getters=[template]))
            assert list(listing.properties) == ["/a/x"]
            assert list(listing.actions) == ["/a/yz"]


# Any robot at all

SEGMENTS = (
    "a", "b", "x", "X", "é", "get", "set", "get_x", "set_x", "getX", "setX", "get_a", "set_a", "getURL", "setURL",
    "URL", "get_", "_x", "get_loggers", "", "get_get_x", "get__x",
)  # fmt: skip
NAMES = st.lists(st.sampled_from(SEGMENTS), min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))
TOPIC_TYPES = st.one_of(
    st.sampled_from(
        [
            FLOAT, "std_msgs/msg/String", "std_msgs/msg/Bool", "std_msgs/msg/Int32", "std_msgs/msg/Empty",
            "turtlesim/msg/Pose", "geometry_msgs/msg/Point", "nowhere/msg/X",
        ]
    ),
    st.sampled_from([(), (FLOAT, "std_msgs/msg/Bool")]),
)  # fmt: skip
SERVICE_TYPES = st.sampled_from(
    [*SERVICES, "std_srvs/srv/Trigger", "std_srvs/srv/Empty", "nav_msgs/srv/GetMap", "nowhere/srv/X", None]
)
GRAPHS = st.builds(
    graph,
    st.dictionaries(NAMES, TOPIC_TYPES, max_size=6),
    st.dictionaries(NAMES, SERVICE_TYPES, max_size=12),
    st.lists(st.one_of(NAMES, NAMES.map(lambda name: Parameter(name, "/node"))), max_size=6),
)


@given(GRAPHS)
@settings(deadline=None)
def test_every_topic_parameter_and_service_is_in_exactly_one_resource_in_its_namespace(whole: Graph) -> None:
    listing = catalogue(whole, known)
    read = Counter(source for one in listing.properties.values() for source in set(map(_told, one.readers)))
    written = Counter(source for one in listing.properties.values() for source in set(map(_told, one.writers)))
    assert all(count == 1 for count in (*read.values(), *written.values()))
    parameters = {one.name for one in whole.parameters.values()}
    assert read.keys() >= {f"topic {name}" for name in whole.topics} | {f"parameter {name}" for name in parameters}
    for name in whole.services:
        used = (f"getter {name}" in read) + (f"setter {name}" in written) + (name in listing.actions)
        assert used == (0 if CONVENTIONS.excludes(name) else 1)
        assert (name in listing.by_service) == (used == 1 and name not in listing.actions)
    assert listing.by_topic == {name: name for name in whole.topics}
    assert listing.by_parameter == {name: name for name in parameters}
    assert listing.by_service == {
        source.name: one.name
        for one in listing.properties.values()
        for source in (*one.readers, *one.writers)
        if isinstance(source, Getter | Setter)
    }
    for name, one in listing.properties.items():
        assert one.name == name
        assert one.readers or one.writers
        readers, writers = list(map(type, one.readers)), list(map(type, one.writers))
        assert readers == [kind for kind in (TopicSource, Getter, ParameterSource) if kind in readers]
        assert writers == [kind for kind in (Setter, ParameterSource, TopicSource) if kind in writers]
    for name in (*listing.properties, *listing.actions):
        *namespace, leaf = name[1:].split("/")
        assert leaf in listing.namespaces[tuple(namespace)].leaves
    leaves = sum(len(members.leaves) for members in listing.namespaces.values())
    assert leaves == len({*listing.properties, *listing.actions})


@given(GRAPHS)
@settings(deadline=None)
def test_whatever_a_property_is_read_as_can_be_written_to_all_that_write_it(whole: Graph) -> None:
    for one in catalogue(whole, known).properties.values():
        for reader in one.readers:
            if isinstance(reader, Getter):
                assert is_convertible(value_shape(reader.schema.response, reader.fields), one.shape)
        for writer in one.writers:
            if isinstance(writer, ParameterSource):
                continue
            target = writer.schema.request if isinstance(writer, Setter) else writer.schema
            assert target is not None
            lowerer(target).from_json(_sample(one.shape, target))


SAMPLES = {
    "bool": True, "string": "on", "int32": 3, "int64": 3, "uint8": 3, "float32": 0.5, "float64": 0.5,
}  # fmt: skip


def _sample(kind: ValueShape, target: MessageSchema) -> object:
    """Return a value of a kind as the JSON of a message that may accept it."""
    if isinstance(kind, ScalarShape):
        (field,) = target.type.fields
        return {field.name: SAMPLES[kind.kind.name]}
    assert isinstance(kind, MessageShape)
    default = lowerer(kind.schema).from_json({}, defaults=True)
    whole = json.loads(lifter(kind.schema).json(default, "http://127.0.0.1/"))
    return {field.name: whole[field.name] for field in kind.fields}
