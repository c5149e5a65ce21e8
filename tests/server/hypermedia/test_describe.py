"""Views described: the paper's Listing 3 fact by fact, in every syntax, and what robots may do to it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import (
    CanonicalizationAlgorithm,
    Dataset,
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    RdfFormat,
    Store,
    Triple,
    parse,
)

from rosld.adapters.model import Message, MessageSchema, Primitive, ServiceSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.document import Document
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import lowerer
from rosld.ontology.serialize import Syntax, serialize
from rosld.ontology.urls import Space
from rosld.ontology.vocab import PREFIXES, av, dcterms, hctl, htv, ldp, qudt, rdf, rdfs, ros, td, xsd
from rosld.server.hypermedia.value import MessageValue, Reading, StoredValue
from rosld.server.hypermedia.view_documents import (
    action_document,
    complex_document,
    complex_json,
    fragment_of,
    property_document,
    property_json,
)
from rosld.server.hypermedia.views import (
    ActionAffordance,
    ActionView,
    ComplexView,
    LinkAffordance,
    Member,
    PropertyAffordance,
    PropertyView,
)
from rosld.shapes.value import Bounds, Measure, MessageShape, OpenShape, ScalarShape

BASE = "http://127.0.0.1:8080/"
SPACE = Space(BASE)
LIFTING = LiftSettings()
LIBRARY = TypeLibrary(ros_version=1)
AIRCRAFT = NamedNode(BASE + "resources/aircraft/")
ENGINE = NamedNode(BASE + "resources/aircraft/engine/")
POWER = NamedNode(BASE + "resources/aircraft/power")
SPEED = NamedNode(BASE + "resources/aircraft/engine/speed")
START = NamedNode(BASE + "resources/aircraft/start")
STOP = NamedNode(BASE + "resources/aircraft/stop")
MAPPING = BASE + "mappings/aircraft"
KMH = NamedNode("http://qudt.org/vocab/unit/KiloM-PER-HR")
VELOCITY = NamedNode("http://qudt.org/vocab/quantitykind/Speed")
FORMATS = {
    Syntax.TURTLE: RdfFormat.TURTLE,
    Syntax.JSON_LD: RdfFormat.JSON_LD,
    Syntax.N_TRIPLES: RdfFormat.N_TRIPLES,
    Syntax.RDF_XML: RdfFormat.RDF_XML,
    Syntax.N3: RdfFormat.N3,
    Syntax.N_QUADS: RdfFormat.N_QUADS,
    Syntax.TRIG: RdfFormat.TRIG,
}


def schema_of(name: str) -> MessageSchema:
    schema = LIBRARY.find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    return schema


def request_of(name: str) -> MessageSchema:
    schema = LIBRARY.find(TypeRef(name))
    assert isinstance(schema, ServiceSchema)
    return schema.request


STRING, FLOAT, POSE = (
    schema_of(name) for name in ("std_msgs/msg/String", "std_msgs/msg/Float64", "geometry_msgs/msg/PoseStamped")
)
TRIGGER, SET_BOOL = request_of("std_srvs/srv/Trigger"), request_of("std_srvs/srv/SetBool")
ON_OFF = ScalarShape(Primitive("string"), Bounds(choices=(Literal("on"), Literal("off"))))
THOUSAND = ScalarShape(
    Primitive("float64"),
    Bounds(minimum=Literal("0", datatype=xsd.integer), maximum=Literal("1000", datatype=xsd.integer)),
    Measure(KMH, VELOCITY),
)


def message(schema: MessageSchema, **values: object) -> Message:
    return lowerer(schema).from_json(values, defaults=True)


def reading(name: str, schema: MessageSchema, **values: object) -> Reading:
    value = MessageValue(schema, message(schema, **values), schema.type.fields, SPACE.topic(name))
    return Reading(name, value, read_ns=1)


def power(value: str = "off", *, write: bool = False) -> Member:
    affordance = PropertyAffordance("power", POWER.value, ON_OFF, av.power, write=write)
    return Member(affordance, reading("/aircraft/power", STRING, data=value))


def speed(value: float = 0.0) -> Member:
    affordance = PropertyAffordance("speed", SPEED.value, THOUSAND, av.speed, write=True, observe=True)
    return Member(affordance, reading("/aircraft/engine/speed", FLOAT, data=value))


ABOVE = BASE + "resources/"
STOPPED = ComplexView(
    AIRCRAFT.value, "/aircraft/", (power("off", write=True),),
    (ActionAffordance("start", START.value, TRIGGER, av.start),),
    parent=ABOVE, title="Aircraft", mapping=MAPPING,
)  # fmt: skip
STARTED = ComplexView(
    AIRCRAFT.value, "/aircraft/", (power("on", write=True),),
    (ActionAffordance("stop", STOP.value, TRIGGER, av.stop),),
    (LinkAffordance(av.engine, ENGINE.value),), (ENGINE.value,),
    parent=ABOVE, title="Aircraft", mapping=MAPPING,
)  # fmt: skip
RUNNING = ComplexView(
    ENGINE.value, "/aircraft/engine/", (speed(500.0),), (), (LinkAffordance(av.aircraft, AIRCRAFT.value),),
    parent=AIRCRAFT.value, title="Engine", mapping=MAPPING,
)  # fmt: skip


def described(view: ComplexView) -> Document:
    return complex_document(view, SPACE, LIFTING)


def values(triples: Iterable[Triple], subject: NamedNode, predicate: NamedNode) -> set[object]:
    return {triple.object for triple in triples if triple.subject == subject and triple.predicate == predicate}


def ask(document: Document, pattern: str) -> bool:
    store = Store()
    store.extend(Quad(t.subject, t.predicate, t.object, DefaultGraph()) for t in document.all_triples())
    return bool(store.query(f"ASK {{ {pattern} }}", prefixes=dict(PREFIXES), base_iri=document.url))


def canonical(triples: Iterable[Triple]) -> set[str]:
    dataset = Dataset(Quad(t.subject, t.predicate, t.object, DefaultGraph()) for t in triples)
    dataset.canonicalize(CanonicalizationAlgorithm.RDFC_1_0)
    return {str(quad.triple) for quad in dataset}


def says_the_same_in_every_syntax(document: Document, without: Sequence[Syntax] = ()) -> None:
    expected = canonical(document.all_triples())
    for syntax, form in FORMATS.items():
        if syntax not in without:
            quads = list(parse(serialize(document, syntax), form))
            assert canonical(quad.triple for quad in quads) == expected, syntax


# Listing 3


def test_an_aircraft_that_is_off_has_its_power_and_the_link_start_and_nothing_else() -> None:
    triples = described(STOPPED).all_triples()
    assert values(triples, AIRCRAFT, av.power) == {Literal("off")}
    assert values(triples, AIRCRAFT, av.start) == {START}
    assert values(triples, AIRCRAFT, av.stop) == values(triples, AIRCRAFT, av.engine) == set()
    assert values(triples, AIRCRAFT, ldp.contains) == {POWER, START}
    whole = " ".join(map(str, triples))
    assert "stop" not in whole
    assert "engine" not in whole


def test_an_aircraft_that_is_started_and_stands_has_the_links_stop_and_engine_and_not_start() -> None:
    triples = described(STARTED).all_triples()
    assert values(triples, AIRCRAFT, av.power) == {Literal("on")}
    assert values(triples, AIRCRAFT, av.stop) == {STOP}
    assert values(triples, AIRCRAFT, av.engine) == {ENGINE}
    assert values(triples, AIRCRAFT, av.start) == set()
    assert values(triples, AIRCRAFT, ldp.contains) == {POWER, STOP, ENGINE}
    assert values(triples, AIRCRAFT, dcterms.hasPart) == {ENGINE}


def test_the_engine_has_its_speed_and_the_link_back_to_the_aircraft() -> None:
    triples = described(RUNNING).all_triples()
    assert values(triples, ENGINE, av.speed) == {Literal("500.0", datatype=xsd.double)}
    assert values(triples, ENGINE, av.aircraft) == {AIRCRAFT}
    assert values(triples, ENGINE, dcterms.isPartOf) == {AIRCRAFT}


def test_a_complex_resource_says_what_it_is() -> None:
    triples = described(STARTED).all_triples()
    assert values(triples, AIRCRAFT, rdf.type) == {
        ros.ComplexResource, ldp.Resource, ldp.RDFSource, ldp.Container, ldp.BasicContainer
    }  # fmt: skip
    assert values(triples, AIRCRAFT, ros.name) == {Literal("/aircraft")}
    assert values(triples, AIRCRAFT, dcterms.title) == {Literal("Aircraft")}
    assert values(triples, AIRCRAFT, rdfs.isDefinedBy) == {NamedNode(MAPPING)}
    assert values(triples, AIRCRAFT, dcterms.isPartOf) == {NamedNode(ABOVE)}


def test_the_root_is_a_complex_resource_too() -> None:
    root = NamedNode(ABOVE)
    triples = described(ComplexView(ABOVE, "/", children=(AIRCRAFT.value,))).all_triples()
    assert values(triples, root, ros.name) == {Literal("/")}
    assert values(triples, root, dcterms.title) == {Literal("Resources")}
    assert values(triples, root, ldp.contains) == {AIRCRAFT}


def test_the_plain_json_is_the_object_of_the_values() -> None:
    assert json.loads(complex_json(STARTED, LIFTING)) == {"power": "on"}
    assert json.loads(complex_json(RUNNING, LIFTING)) == {"speed": 500.0}
    assert json.loads(complex_json(ComplexView(ABOVE, "/"), LIFTING)) == {}


@pytest.mark.parametrize("view", [STOPPED, STARTED, RUNNING])
def test_all_syntaxes_say_the_same(view: ComplexView) -> None:
    says_the_same_in_every_syntax(described(view))


# Affordances


def test_an_action_on_offer_says_how_to_invoke_it() -> None:
    assert ask(
        described(STOPPED),
        """<> td:hasActionAffordance ?start . ?start a td:ActionAffordance ; td:name "start" ; map:relation av:start ;
             td:hasForm ?form . ?form a hctl:Form ; hctl:hasTarget ?target ; htv:methodName "POST" ;
             hctl:hasOperationType td:invokeAction ; hctl:forContentType "application/json" .
           FILTER(?target = STRDT(STR(<start>), xsd:anyURI))
           FILTER NOT EXISTS { ?start ros:requestShape ?any }""",
    )


def test_an_action_that_takes_something_names_the_shape_of_its_request() -> None:
    view = replace(STOPPED, actions=(ActionAffordance("lights", AIRCRAFT.value + "lights", SET_BOOL),))
    document = described(view)
    shape = SPACE.shape("std_srvs/srv/SetBool_Request")
    assert ask(document, f'?lights td:name "lights" ; ros:requestShape <{shape}>')
    assert values(document.triples, AIRCRAFT, ldp.contains) == {POWER, NamedNode(AIRCRAFT.value + "lights")}


def test_an_action_whose_request_is_not_known_is_there_but_affords_nothing() -> None:
    view = replace(STOPPED, actions=(ActionAffordance("odd", AIRCRAFT.value + "odd", None),))
    document = described(view)
    assert NamedNode(AIRCRAFT.value + "odd") in values(document.triples, AIRCRAFT, ldp.contains)
    assert not ask(document, "<> td:hasActionAffordance ?any")


def test_a_property_says_how_to_read_write_and_observe_it_and_what_to_send() -> None:
    document = described(RUNNING)
    for name, method, operation in (("read", "GET", "readProperty"), ("write", "PUT", "writeProperty")):
        assert ask(
            document,
            f"""<> td:hasPropertyAffordance ?speed . ?speed a td:PropertyAffordance ; td:name "speed" ;
                  td:isObservable true ; map:predicate av:speed ; td:hasForm <#properties/speed/{name}> .
                <#properties/speed/{name}> a hctl:Form ; hctl:hasTarget ?target ; htv:methodName "{method}" ;
                  hctl:hasOperationType td:{operation} ; hctl:forContentType "application/json" .
                FILTER(?target = STRDT(STR(<speed>), xsd:anyURI))""",
        )
    assert ask(
        document,
        """?speed td:hasForm ?form . ?form hctl:hasOperationType td:observeProperty ; hctl:forSubProtocol "sse" ;
             hctl:forContentType "text/event-stream" ; htv:methodName "GET" ; hctl:hasTarget ?target .
           FILTER(?target = STRDT(STR(<speed>), xsd:anyURI))""",
    )
    assert ask(
        document,
        """?speed ros:shape ?shape . ?shape a sh:NodeShape ; sh:property ?value .
           ?value sh:path rdf:value ; sh:datatype xsd:double ; sh:minInclusive 0 ; sh:maxInclusive 1000 .""",
    )


def test_an_enumeration_shows_in_the_shape() -> None:
    assert ask(
        described(STOPPED),
        """?power td:name "power" ; ros:shape/sh:property/sh:in ?list .
           ?list rdf:rest*/rdf:first "on" . ?list rdf:rest*/rdf:first "off" .""",
    )


def test_a_property_that_cannot_be_written_now_has_no_form_for_it() -> None:
    document = described(replace(STARTED, members=(power("on", write=False),)))
    assert ask(document, '?power td:name "power" ; td:hasForm/hctl:hasOperationType td:readProperty')
    assert not ask(document, "?any hctl:hasOperationType td:writeProperty")
    assert not ask(document, '?any htv:methodName "PUT"')


def test_a_property_that_can_only_be_written_has_no_form_to_read_or_observe() -> None:
    affordance = PropertyAffordance("goal", AIRCRAFT.value + "goal", ON_OFF, read=False, write=True, observe=True)
    document = described(replace(STOPPED, members=(Member(affordance, Reading("/aircraft/goal", None)),)))
    assert ask(document, '?goal td:name "goal" ; td:isObservable false')
    assert not ask(document, '?any htv:methodName "GET"')


def test_units_and_kinds_of_quantity_are_said_of_the_affordance() -> None:
    triples = described(RUNNING).all_triples()
    affordance = NamedNode(ENGINE.value + "#properties/speed")
    assert values(triples, affordance, qudt.hasUnit) == {KMH}
    assert values(triples, affordance, qudt.hasQuantityKind) == {VELOCITY}


def test_every_form_has_one_target_one_method_and_one_operation() -> None:
    for view in (STOPPED, STARTED, RUNNING):
        triples = described(view).triples
        forms = {t.subject for t in triples if t.predicate == rdf.type and t.object == hctl.Form}
        assert forms == {t.object for t in triples if t.predicate == td.hasForm}
        for form in cast("set[NamedNode]", forms):
            for predicate in (hctl.hasTarget, htv.methodName, hctl.hasOperationType, hctl.forContentType):
                assert len(values(triples, form, predicate)) == 1


# Derived resources


def test_without_a_mapping_a_member_speaks_for_itself_and_an_action_has_no_relation() -> None:
    member = Member(PropertyAffordance("power", POWER.value, ON_OFF), reading("/aircraft/power", STRING, data="off"))
    action = ActionAffordance("start", START.value, TRIGGER)
    document = described(ComplexView(AIRCRAFT.value, "/aircraft/", (member,), (action,), parent=ABOVE))
    assert values(document.triples, POWER, rdf.value) == {Literal("off")}
    assert values(document.triples, AIRCRAFT, ldp.contains) == {POWER, START}
    assert {t.predicate for t in document.triples if t.object == START} == {ldp.contains}
    assert values(document.triples, AIRCRAFT, dcterms.title) == {Literal("Resources in /aircraft")}
    assert not ask(document, "?any map:predicate ?one")
    says_the_same_in_every_syntax(document)


# Values


def test_a_member_that_failed_says_so_and_leaves_the_others_whole() -> None:
    failed = replace(power(), reading=Reading("/aircraft/power", None, "the getter did not answer within 2 s"))
    view = replace(RUNNING, members=(failed, speed(7.0)))
    document = described(view)
    assert values(document.triples, POWER, ros.unreadable) == {Literal("the getter did not answer within 2 s")}
    assert not ask(document, "?any av:power ?one")
    assert values(document.triples, ENGINE, av.speed) == {Literal("7.0", datatype=xsd.double)}
    assert complex_json(view, LIFTING) == b'{"power":null,"speed":7.0}'


def test_a_member_without_a_value_yet_has_none_and_no_failure() -> None:
    view = replace(RUNNING, members=(replace(speed(), reading=Reading("/aircraft/engine/speed", None)),))
    document = described(view)
    assert not ask(document, "?any ros:unreadable ?why")
    assert not ask(document, "?any av:speed ?value")
    assert complex_json(view, LIFTING) == b'{"speed":null}'


def pose(name: str = "pose", predicate: NamedNode | None = None) -> Member:
    shape = MessageShape(POSE, tuple(field.name for field in POSE.type.fields))
    found = reading("/aircraft/" + name, POSE, header={"frame_id": "map"}, pose={"position": {"x": 1.5}})
    return Member(PropertyAffordance(name, AIRCRAFT.value + name, shape, predicate, write=True), found)


POSITION = "https://w3id.org/rosld/types/geometry_msgs/msg/PoseStamped#pose"
POINT = "https://w3id.org/rosld/types/geometry_msgs/msg/Pose#position"
X = "https://w3id.org/rosld/types/geometry_msgs/msg/Point#x"


@pytest.mark.parametrize("predicate", [None, NamedNode("http://example.org/pose")])
def test_a_member_that_is_a_message_is_a_node_of_its_name(predicate: NamedNode | None) -> None:
    view = replace(STOPPED, members=(pose(predicate=predicate),))
    document = described(view)
    about = "<> <http://example.org/pose>" if predicate else "<pose> rdf:value"
    assert ask(document, f'{about} <#pose> . <#pose> <{POSITION}>/<{POINT}>/<{X}> "1.5"^^xsd:double')
    assert json.loads(complex_json(view, LIFTING))["pose"]["pose"]["position"]["x"] == 1.5
    says_the_same_in_every_syntax(document)


def test_one_field_of_a_message_may_be_a_property() -> None:
    east = NamedNode("http://example.org/east")
    affordance = PropertyAffordance("east", AIRCRAFT.value + "pose", ScalarShape(Primitive("float64")), east)
    view = replace(STOPPED, members=(Member(affordance, pose().reading, "pose.position.x"),))
    document = described(view)
    assert values(document.triples, AIRCRAFT, east) == {Literal("1.5", datatype=xsd.double)}
    assert document.messages == ()
    assert complex_json(view, LIFTING) == b'{"east":1.5}'


def test_a_field_that_is_not_there_is_a_failure() -> None:
    east = NamedNode("http://example.org/east")
    affordance = PropertyAffordance("east", AIRCRAFT.value + "pose", OpenShape(), east)
    view = replace(STOPPED, members=(Member(affordance, pose().reading, "pose.attitude"),))
    assert ask(described(view), '<pose> ros:unreadable ?why FILTER CONTAINS(?why, "attitude")')
    assert complex_json(view, LIFTING) == b'{"east":null}'


def test_parameters_are_literals_and_lists_are_json() -> None:
    stored = {"seats": StoredValue(2), "checklist": StoredValue(["fuel", "flaps"])}
    members = tuple(
        Member(PropertyAffordance(name, AIRCRAFT.value + name, OpenShape()), Reading(name, value))
        for name, value in stored.items()
    )
    view = replace(STOPPED, members=members)
    document = described(view)
    assert ask(document, '<seats> rdf:value 2 . <checklist> rdf:value "[\\"fuel\\",\\"flaps\\"]"^^rdf:JSON')
    assert complex_json(view, LIFTING) == b'{"seats":2,"checklist":["fuel","flaps"]}'


def test_a_member_taken_from_elsewhere_is_used_but_not_contained() -> None:
    elsewhere = PropertyAffordance("display", BASE + "resources/cockpit/display", ON_OFF, av.power)
    document = described(replace(STOPPED, members=(Member(elsewhere, power().reading), speed())))
    assert values(document.triples, AIRCRAFT, ldp.contains) == {START}
    assert ask(document, f'?form hctl:hasTarget "{BASE}resources/cockpit/display"^^xsd:anyURI')


# A property and an action by themselves


def power_view(*, write: bool = False) -> PropertyView:
    member = power("off", write=write)
    return PropertyView(
        replace(member.affordance, title="Power"),
        member.reading,
        (SPACE.service("/aircraft/get_power"),),
        (SPACE.service("/aircraft/set_power"), SPACE.parameter("/aircraft/power")),
        AIRCRAFT.value,
    )


def test_a_property_has_its_value_its_sources_and_its_place() -> None:
    document = property_document(power_view(write=True), SPACE, LIFTING)
    triples = document.triples
    assert document.url == POWER.value
    assert values(triples, POWER, rdf.type) == {ros.Property, ldp.Resource, ldp.RDFSource}
    assert values(triples, POWER, rdf.value) == {Literal("off")}
    assert values(triples, POWER, ros.name) == {Literal("/aircraft/power")}
    assert values(triples, POWER, dcterms.title) == {Literal("Power")}
    assert values(triples, POWER, ros.readsFrom) == {NamedNode(SPACE.service("/aircraft/get_power"))}
    assert values(triples, POWER, ros.writesTo) == {
        NamedNode(SPACE.service("/aircraft/set_power")), NamedNode(SPACE.parameter("/aircraft/power"))
    }  # fmt: skip
    assert values(triples, POWER, dcterms.isPartOf) == {AIRCRAFT}
    assert ask(document, "<> td:hasPropertyAffordance <#property> . <#property> td:hasForm <#property/write> .")
    assert property_json(power_view(), LIFTING) == b'"off"'
    says_the_same_in_every_syntax(document)


def test_a_property_that_is_a_message_is_the_node_value() -> None:
    member = pose()
    view = PropertyView(member.affordance, member.reading, (SPACE.topic("/aircraft/pose"),), (), AIRCRAFT.value)
    document = property_document(view, SPACE, LIFTING)
    assert ask(document, f'<> rdf:value <#value> . <#value> <{POSITION}>/<{POINT}>/<{X}> "1.5"^^xsd:double')
    assert json.loads(property_json(view, LIFTING))["header"]["frame_id"] == "map"
    says_the_same_in_every_syntax(document)


def test_stamps_have_dates_unless_time_is_simulated() -> None:
    member = pose()
    view = PropertyView(member.affordance, member.reading, (), (), AIRCRAFT.value)
    real, simulated = (property_document(view, SPACE, LIFTING, simulated_time=each) for each in (False, True))
    assert ask(real, "?stamp ros:dateTime ?date")
    assert not ask(simulated, "?stamp ros:dateTime ?date")


def test_a_property_that_cannot_be_read_says_why_and_is_null() -> None:
    view = replace(power_view(), reading=Reading("/aircraft/power", None, "the getter is gone"))
    document = property_document(view, SPACE, LIFTING)
    assert values(document.triples, POWER, ros.unreadable) == {Literal("the getter is gone")}
    assert values(document.triples, POWER, rdf.value) == set()
    assert property_json(view, LIFTING) == b"null"


def test_an_action_names_the_service_behind_it_and_its_place() -> None:
    affordance = ActionAffordance("start", START.value, TRIGGER, av.start, "Start")
    view = ActionView(affordance, SPACE.service("/aircraft/start"), AIRCRAFT.value)
    document = action_document(view, SPACE, LIFTING)
    assert values(document.triples, START, rdf.type) == {ldp.Resource, ldp.RDFSource}
    assert values(document.triples, START, ros.name) == {Literal("/aircraft/start")}
    assert values(document.triples, START, ros.invokes) == {NamedNode(SPACE.service("/aircraft/start"))}
    assert values(document.triples, START, dcterms.isPartOf) == {AIRCRAFT}
    assert ask(
        document,
        f'<> td:hasActionAffordance <#action> . <#action> td:hasForm/hctl:hasTarget "{START.value}"^^xsd:anyURI .',
    )
    says_the_same_in_every_syntax(document)


# Hostile names


TEXTS = st.text(st.characters(exclude_categories=["Cs", "Cc"], exclude_characters="\ufffe\uffff"), max_size=8)
NAMES = TEXTS | st.sampled_from(['"', "a b", "<>", "ü", "💡", "#", "%2E", "a.b", ".", "properties/x", "@id", "{}", ""])


@settings(max_examples=60, deadline=None)
@given(NAMES, NAMES, TEXTS)
def test_no_name_and_no_string_breaks_a_description(one: str, other: str, words: str) -> None:
    members = tuple(
        replace(pose(), affordance=replace(pose().affordance, name=name, url=AIRCRAFT.value + str(number), title=words))
        for number, name in enumerate(dict.fromkeys((one, other)))
    )
    text = Member(
        PropertyAffordance("text", AIRCRAFT.value + "text", ON_OFF, av.power), reading("/t", STRING, data=words)
    )
    actions = (ActionAffordance(one, AIRCRAFT.value + "act", SET_BOOL, av.start, words),)
    view = replace(STARTED, members=(*members, text), actions=actions, title=words)
    document = described(view)
    says_the_same_in_every_syntax(document)
    assert json.loads(complex_json(view, LIFTING)).keys() == {one, other, "text"}
    names = values(document.all_triples(), NamedNode(AIRCRAFT.value + fragment_of("properties", one)), td.name)
    assert names == {Literal(one)}


def test_nodes_of_messages_and_of_affordances_never_meet() -> None:
    names = ["properties", "actions", "properties/pose", "pose", "pose.header", "pose/read"]
    members = tuple(
        replace(pose(), affordance=replace(pose().affordance, name=name, url=f"{AIRCRAFT.value}{number}"))
        for number, name in enumerate(names)
    )
    document = described(replace(STOPPED, members=members))
    described_nodes = {str(triple.subject) for triple in document.triples}
    for lifted in document.messages:
        own = {str(triple.subject) for triple in lifted.triples(document)}
        assert not own & described_nodes
    nodes = [triple.subject for lifted in document.messages for triple in lifted.triples(document)
             if triple.predicate == rdf.type]  # fmt: skip
    assert len(nodes) == len(set(nodes))


# What does not change is made once


def test_affordances_are_made_once_whatever_the_value() -> None:
    slow, fast = (described(replace(RUNNING, members=(speed(value),))).triples for value in (1.0, 2.0))
    shared = {id(triple) for triple in slow} & {id(triple) for triple in fast}
    assert len(shared) > 20


def test_affordances_of_messages_with_limits_are_made_once_too() -> None:
    shape = MessageShape(
        POSE, ("header", "pose"), {"pose.position.x": Bounds(minimum=Literal("0", datatype=xsd.double))}
    )
    member = replace(pose(), affordance=replace(pose().affordance, shape=shape))
    assert ask(described(replace(STOPPED, members=(member,))), "?shape sh:minInclusive ?least")
