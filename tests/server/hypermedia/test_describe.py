"""Views described: the paper's Listing 3 fact by fact, in every syntax, and what robots may do to it."""

from __future__ import annotations

import json
from collections.abc import Iterable
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
from rosld.ontology.vocab import PREFIXES, av, hctl, htv, ldp, rdf, td, xsd
from rosld.server.hypermedia.value import MessageValue, Reading
from rosld.server.hypermedia.view_documents import (
    complex_document,
    complex_json,
    fragment_of,
    property_document,
    property_json,
)
from rosld.server.hypermedia.views import (
    ActionAffordance,
    ComplexView,
    LinkAffordance,
    Member,
    PropertyAffordance,
    PropertyView,
)
from rosld.shapes.value import Bounds, Measure, MessageShape, ScalarShape

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


def says_the_same_in_every_syntax(document: Document) -> None:
    expected = canonical(document.all_triples())
    for syntax, form in FORMATS.items():
        quads = list(parse(serialize(document, syntax), form))
        assert canonical(quad.triple for quad in quads) == expected, syntax


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


def test_a_property_that_can_only_be_written_has_no_form_to_read_or_observe() -> None:
    affordance = PropertyAffordance("goal", AIRCRAFT.value + "goal", ON_OFF, read=False, write=True, observe=True)
    document = described(replace(STOPPED, members=(Member(affordance, Reading("/aircraft/goal", None)),)))
    assert ask(document, '?goal td:name "goal" ; td:isObservable false')
    assert not ask(document, '?any htv:methodName "GET"')


def test_all_syntaxes_say_the_same_and_every_form_has_one_target_method_and_operation() -> None:
    for view in (STOPPED, STARTED, RUNNING):
        says_the_same_in_every_syntax(described(view))
        triples = described(view).triples
        forms = {t.subject for t in triples if t.predicate == rdf.type and t.object == hctl.Form}
        assert forms == {t.object for t in triples if t.predicate == td.hasForm}
        for form in cast("set[NamedNode]", forms):
            for predicate in (hctl.hasTarget, htv.methodName, hctl.hasOperationType, hctl.forContentType):
                assert len(values(triples, form, predicate)) == 1


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


def test_one_field_of_a_message_may_be_a_property_and_is_a_failure_where_it_is_missing() -> None:
    east = NamedNode("http://example.org/east")
    affordance = PropertyAffordance("east", AIRCRAFT.value + "pose", ScalarShape(Primitive("float64")), east)
    there, missing = (
        replace(STOPPED, members=(Member(affordance, pose().reading, field),))
        for field in ("pose.position.x", "pose.attitude")
    )
    assert values(described(there).triples, AIRCRAFT, east) == {Literal("1.5", datatype=xsd.double)}
    assert described(there).messages == ()
    assert complex_json(there, LIFTING) == b'{"east":1.5}'
    assert ask(described(missing), '<pose> ros:unreadable ?why FILTER CONTAINS(?why, "attitude")')
    assert complex_json(missing, LIFTING) == b'{"east":null}'


def test_a_member_taken_from_elsewhere_is_used_but_not_contained() -> None:
    elsewhere = PropertyAffordance("display", BASE + "resources/cockpit/display", ON_OFF, av.power)
    document = described(replace(STOPPED, members=(Member(elsewhere, power().reading), speed())))
    assert values(document.triples, AIRCRAFT, ldp.contains) == {START}
    assert ask(document, f'?form hctl:hasTarget "{BASE}resources/cockpit/display"^^xsd:anyURI')


def test_a_property_that_is_a_message_is_the_node_value_with_dates_unless_time_is_simulated() -> None:
    view = PropertyView(pose().affordance, pose().reading, (SPACE.topic("/aircraft/pose"),), (), AIRCRAFT.value)
    real, simulated = (property_document(view, SPACE, LIFTING, simulated_time=each) for each in (False, True))
    assert ask(real, f'<> rdf:value <#value> . <#value> <{POSITION}>/<{POINT}>/<{X}> "1.5"^^xsd:double')
    assert json.loads(property_json(view, LIFTING))["header"]["frame_id"] == "map"
    says_the_same_in_every_syntax(real)
    assert ask(real, "?stamp ros:dateTime ?date")
    assert not ask(simulated, "?stamp ros:dateTime ?date")


TEXTS = st.text(st.characters(exclude_categories=["Cs", "Cc"], exclude_characters="\ufffe\uffff"), max_size=8)
NAMES = TEXTS | st.sampled_from(['"', "a b", "<>", "ü", "💡", "#", "%2E", "a.b", ".", "properties/x", "@id", "{}", ""])


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
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


def test_affordances_are_made_once_whatever_the_value() -> None:
    slow, fast = (described(replace(RUNNING, members=(speed(value),))).triples for value in (1.0, 2.0))
    shared = {id(triple) for triple in slow} & {id(triple) for triple in fast}
    assert len(shared) > 20
