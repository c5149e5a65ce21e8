"""A gallery of pages made from hand-written documents: what the tests look at, and what people can look at.

python tests/server/html/gallery.py                 serves the pages at http://127.0.0.1:8090/
python tests/server/html/gallery.py --shoot DIR     photographs them with chromium: wide, as on a phone, dark
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.adapters.model import Message, MessageSchema, Primitive, ServiceSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import TYPES, LiftSettings, lifter
from rosld.ontology.lower import Violation, lowerer
from rosld.ontology.urls import Space
from rosld.ontology.vocab import av, ldp, prov, rdf, rdfs, ros, xsd
from rosld.server.html import (
    HEADERS,
    ICON,
    STYLESHEET,
    DeleteForm,
    EntryCount,
    EntryPage,
    MemberColumns,
    MessageForm,
    Notice,
    Page,
    PageResults,
    ParameterForm,
    ProblemPage,
    QueryPage,
    SequenceLink,
    Site,
    SparqlPage,
    StoredQueryLink,
    StoredQueryParameter,
    ValueForm,
    forms_of,
    render_entry,
    render_page,
    render_problem,
    render_query,
    render_sparql,
)
from rosld.server.html.page import NoticeLevel, Offer
from rosld.server.hypermedia.value import MessageValue, Reading, StoredValue, Value
from rosld.server.hypermedia.view_documents import action_document, complex_document, property_document
from rosld.server.hypermedia.views import (
    ActionAffordance,
    ActionView,
    ComplexView,
    LinkAffordance,
    Member,
    PropertyAffordance,
    PropertyView,
)
from rosld.shapes.value import Bounds, Measure, MessageShape, OpenShape, ScalarShape, ValueShape

BASE = "http://127.0.0.1:8080/"
SITE = Site(BASE, "aircraft", system="The paper's aircraft")
NOW = 1_795_225_901_123_456_789
LIBRARY = TypeLibrary(ros_version=1)
HOSTILE = '<script>alert("x")</script>\'\u202e&amp;\x00'


def token(action: str) -> str:
    """The token of every form, whatever it posts to."""
    return "token"


def schema(name: str) -> MessageSchema:
    """The schema of a message type, or of one half of a service."""
    found = LIBRARY.find(TypeRef(name))
    assert isinstance(found, MessageSchema)
    return found


def message(kind: MessageSchema, value: object) -> Message:
    """A message from plain JSON; what is left out has ROS's defaults."""
    return lowerer(kind).from_json(value, defaults=True)


def lifted(node: str, kind: MessageSchema, value: object, publisher: str | None = "nodes/aircraft") -> LiftedMessage:
    """A message of a document, as it would come from a robot."""
    envelope = Envelope(NOW, 4217, f"{BASE}{publisher}" if publisher else None)
    return LiftedMessage(node, lifter(kind), message(kind, value), envelope)


def said(url: str, *pairs: tuple[NamedNode, object]) -> Iterator[Triple]:
    """Triples about a URL; texts beginning with the base are IRIs."""
    for predicate, value in pairs:
        yield Triple(NamedNode(url), predicate, term(value))


def term(value: object) -> NamedNode | BlankNode | Literal:
    """A value as a term."""
    if isinstance(value, NamedNode | BlankNode | Literal):
        return value
    if isinstance(value, str) and value.startswith((BASE, TYPES)):
        return NamedNode(value)
    assert isinstance(value, str | int | float)
    return Literal(value)


def topic(path: str, kind: str, *more: tuple[NamedNode, object]) -> tuple[str, Iterator[Triple]]:
    """The description of a topic."""
    url = f"{BASE}topics/{path}"
    return url, said(
        url,
        (rdf.type, ros.Topic),
        (rdf.type, ldp.Resource),
        (rdf.type, ldp.RDFSource),
        (ros.name, f"/{path}"),
        (ros.hasMessageType, TYPES + kind),
        (ros.rate, Literal("10.0", datatype=xsd.double)),
        *more,
    )


def speed() -> Page:
    """A topic with one number."""
    url, triples = topic(
        "aircraft/engine/speed",
        "std_msgs/msg/Float64",
        (ros.publishedBy, f"{BASE}nodes/aircraft"),
        (ros.latest, f"{BASE}topics/aircraft/engine/speed#message"),
    )
    messages = (lifted("#message", schema("std_msgs/msg/Float64"), {"data": 700.0}),)
    return Page(SITE, "Topic", "/aircraft/engine/speed", Document(url, tuple(triples), messages))


def display() -> Page:
    """A topic that can be written."""
    kind = schema("std_msgs/msg/String")
    url, triples = topic(
        "cockpit/display", kind.ref.name, (ros.subscribedBy, f"{BASE}nodes/cockpit"), (ros.writable, Literal(True))
    )
    form = MessageForm(kind, value={"data": "Cleared for take-off"}, about="Everybody who subscribes will receive it.")
    allow = ("GET", "HEAD", "OPTIONS", "PATCH", "PUT")
    return Page(SITE, "Topic", "/cockpit/display", Document(url, tuple(triples)), allow, (form,), csrf=token)


def odometry() -> Page:
    """Nested messages, times, arrays of numbers."""
    kind = schema("nav_msgs/msg/Odometry")
    value = {
        "header": {"seq": 3, "stamp": {"sec": 1795225901, "nanosec": 101000000}, "frame_id": "odom"},
        "child_frame_id": "base_link",
        "pose": {"pose": {"position": {"x": 1.25, "y": -0.5}, "orientation": {"w": 1.0}}, "covariance": [0.1] * 36},
    }
    url, triples = topic(
        "odom",
        kind.ref.name,
        (ros.publishedBy, f"{BASE}nodes/base"),
        (ros.publishedBy, f"{BASE}nodes/ekf"),
        (ros.latest, f"{BASE}topics/odom#message"),
        (ros.latestFrom, f"{BASE}topics/odom#from/base"),
        (ros.latestFrom, f"{BASE}topics/odom#from/ekf"),
    )
    messages = (
        lifted("#message", kind, value, "nodes/base"),
        lifted("#from/base", kind, value, "nodes/base"),
        lifted("#from/ekf", kind, {}, "nodes/ekf"),
    )
    return Page(SITE, "Topic", "/odom", Document(url, tuple(triples), messages))


def twist(refused: bool = False) -> Page:
    """A nested form, perhaps as the answer to one that did not fit."""
    kind = schema("geometry_msgs/msg/TwistStamped")
    url, triples = topic("cmd_vel", kind.ref.name, (ros.subscribedBy, f"{BASE}nodes/base"))
    form = MessageForm(kind, value={"twist": {"linear": {"x": 0.2}}})
    notices: tuple[Notice, ...] = ()
    if refused:
        typed = [("header.frame_id", "base"), ("twist.linear.x", "fast"), ("header.stamp.nanosec", "-1")]
        wrong = (
            Violation("twist.linear.x", "must be a number (NaN, INF and -INF are numbers too)", "fast"),
            Violation("header.stamp.nanosec", "expected an uint32 (an integer from 0 to 4294967295)", "-1"),
        )
        form = form.with_submitted(typed, wrong)
        notices = (Notice("Nothing was published: two fields do not fit.", NoticeLevel.ERROR, wrong),)
    return Page(
        SITE,
        "Topic",
        "/cmd_vel",
        Document(url, tuple(triples)),
        ("GET", "PUT"),
        (form,),
        csrf=token,
        notices=notices,
    )


def image() -> Page:
    """A topic that cannot be inlined, with what is wrong with it."""
    kind = schema("sensor_msgs/msg/Image")
    value = {"height": 480, "width": 640, "encoding": "rgb8", "step": 1920, "data": "AAECAwQFBgcICQoLDA0ODxAREhM="}
    url, triples = topic(
        "camera/image_raw",
        kind.ref.name,
        (ros.publishedBy, f"{BASE}nodes/camera"),
        (ros.unreachable, "the publisher /camera at http://camera:41231/ does not answer: host name unknown"),
        (ros.namespace, f"{BASE}topics/camera/image_raw/"),
        (ros.latest, f"{BASE}topics/camera/image_raw#message"),
    )
    messages = (lifted("#message", kind, value, "nodes/camera"),)
    return Page(SITE, "Topic", "/camera/image_raw", Document(url, tuple(triples), messages))


def scan() -> Page:
    """A message of a recording: a laser's."""
    kind = schema("sensor_msgs/msg/LaserScan")
    ranges = [round(1 + 0.5 * float(np.sin(step / 40)), 4) for step in range(360)]
    value = {"header": {"frame_id": "laser", "stamp": {"sec": 12}}, "angle_max": 6.28, "ranges": [*ranges, "INF"]}
    url = f"{BASE}bags/turtlebot.bag/messages/41"
    triples = said(
        url,
        (rdf.type, ros.Message),
        (ros.onTopic, f"{BASE}topics/scan"),
        (ros.recordedIn, f"{BASE}bags/turtlebot.bag/"),
        (ros.index, 41),
        (ros.recordedMessage, f"{url}#message"),
    )
    steps = tuple(
        SequenceLink(rel, f"{BASE}bags/turtlebot.bag/messages/{index}")
        for rel, index in (("first", 0), ("prev", 40), ("next", 42), ("last", 899))
    )
    document = Document(url, tuple(triples), (lifted("#message", kind, value, None),), simulated_time=True)
    return Page(SITE, "Message", "turtlebot.bag, message 41", document, steps=steps)


def transforms() -> Page:
    """An array of messages."""
    kind = schema("tf2_msgs/msg/TFMessage")
    frames = ["base_link", "laser", "camera", "left_wheel", "right_wheel", "arm", "gripper"]
    value = {
        "transforms": [
            {"header": {"frame_id": "odom", "stamp": {"sec": 1795225901}}, "child_frame_id": frame} for frame in frames
        ]
    }
    url, triples = topic("tf", kind.ref.name, (ros.latest, f"{BASE}topics/tf#message"))
    return Page(SITE, "Topic", "/tf", Document(url, tuple(triples), (lifted("#message", kind, value),)))


def topics() -> Page:
    """A container with namespaces."""
    url = f"{BASE}topics/"
    members = {
        "chatter": ("std_msgs/msg/String", 1.0),
        "cmd_vel": ("geometry_msgs/msg/Twist", 0.0),
        "front_laser_scan": ("sensor_msgs/msg/LaserScan", 40.0),
        "image_raw": ("sensor_msgs/msg/Image", 29.97),
        "joint_states": ("sensor_msgs/msg/JointState", 125.0),
        "rosout": ("rcl_interfaces/msg/Log", 0.0),
    }
    names = [*members, "aircraft/", "cockpit/", "image_raw/", "move_base/"]
    triples = said(
        url,
        (rdf.type, ldp.BasicContainer),
        (rdf.type, ldp.Container),
        (rdfs.label, "topics"),
        *((ldp.contains, url + name) for name in names),
    )
    cells = {
        url + name: (NamedNode(TYPES + kind), Literal(str(rate), datatype=xsd.double))
        for name, (kind, rate) in members.items()
    }
    listing = MemberColumns(("message type", "rate"), cells)
    return Page(SITE, "Container", "topics", Document(url, tuple(triples)), listing=listing)


def parameter() -> Page:
    """A parameter with both of its forms."""
    url = f"{BASE}parameters/aircraft/gains"
    value = Literal('{"p":1.5,"i":[1,2,3]}', datatype=rdf.JSON)
    triples = said(url, (rdf.type, ros.Parameter), (ros.name, "/aircraft/gains"), (ros.value, value))
    forms = (
        ParameterForm({"p": 1.5, "i": [1, 2, 3]}),
        DeleteForm("Delete the parameter", about="It cannot be undone."),
    )
    allow = ("GET", "PUT", "DELETE")
    return Page(SITE, "Parameter", "/aircraft/gains", Document(url, tuple(triples)), allow, forms, csrf=token)


def service() -> Page:
    """A service with a form to call it."""
    url = f"{BASE}services/aircraft/engine/set_speed"
    triples = said(
        url,
        (rdf.type, ros.Service),
        (ros.name, "/aircraft/engine/set_speed"),
        (ros.hasServiceType, f"{TYPES}rosld_aircraft/srv/SetNumber"),
        (ros.provider, f"{BASE}nodes/aircraft"),
        (ros.requestShape, f"{BASE}shapes/rosld_aircraft/srv/SetNumber_Request"),
    )
    kind = schema("rosld_aircraft/srv/SetNumber_Request")
    form = MessageForm(kind, "POST", "Call the service", "Call")
    title = "/aircraft/engine/set_speed"
    return Page(SITE, "Service", title, Document(url, tuple(triples)), ("GET", "POST"), (form,), csrf=token)


def call() -> Page:
    """A call: its request and its response."""
    url = f"{BASE}calls/7f3a"
    triples = said(
        url,
        (rdf.type, ros.Call),
        (ros.isCallOf, f"{BASE}services/aircraft/engine/set_speed"),
        (ros.state, ros.Failed),
        (prov.startedAtTime, Literal("2026-11-21T01:31:41.123456789Z", datatype=xsd.dateTime)),
        (ros.request, f"{url}#request"),
        (ros.response, f"{url}#response"),
    )
    half = "rosld_aircraft/srv/SetNumber"
    messages = (
        lifted("#request", schema(f"{half}_Request"), {"data": 1200.0}, None),
        lifted("#response", schema(f"{half}_Response"), {"success": False, "message": "1200 is out of range"}, None),
    )
    return Page(SITE, "Call", "Call 7f3a", Document(url, tuple(triples), messages))


def message_type() -> Page:
    """A message type: fields, hash and definition."""
    kind = schema("geometry_msgs/msg/PoseStamped")
    url, iri = f"{BASE}types/geometry_msgs/msg/PoseStamped", f"{TYPES}geometry_msgs/msg/PoseStamped"
    triples = [
        *said(iri, (rdf.type, ros.MessageType), (ros.name, kind.ref.name), (ros.md5, kind.ref.hash or "")),
        *said(iri, (ros.definition, kind.definition), (ros.hasField, f"{iri}#header"), (ros.hasField, f"{iri}#pose")),
    ]
    for position, name in enumerate(("header", "pose")):
        triples += said(f"{iri}#{name}", (rdf.type, ros.Field), (ros.fieldName, name), (ros.position, position))
    return Page(SITE, "Message type", kind.ref.name, Document(url, tuple(triples)))


def hostile() -> Page:
    """Everything a robot names, named by somebody who means harm."""
    kind = schema("std_msgs/msg/String")
    url = f"{BASE}topics/%3Cscript%3Ealert(1)%3C%2Fscript%3E"
    triples = said(
        url,
        (rdf.type, ros.Topic),
        (ros.name, HOSTILE),
        (rdfs.seeAlso, NamedNode("javascript:alert(1)")),
        (rdfs.seeAlso, NamedNode("data:text/html,<script>alert(1)</script>".replace("<", "%3C").replace(">", "%3E"))),
        (rdfs.comment, Literal(HOSTILE, language="en")),
        (ros.unreadable, HOSTILE),
        (NamedNode("javascript:predicate"), HOSTILE),
        (ros.latest, f"{url}#message"),
        (ldp.contains, f"{url}/%22onload%3D%22"),
    )
    messages = (lifted("#message", kind, {"data": HOSTILE.replace("\x00", "")}, "nodes/%3Cb%3E"),)
    form = MessageForm(kind, title=HOSTILE, button=HOSTILE, value={"data": HOSTILE}, about=HOSTILE).with_submitted(
        [("data", HOSTILE)], [Violation("data", HOSTILE, HOSTILE), Violation(HOSTILE, HOSTILE, HOSTILE)]
    )
    return Page(
        Site(BASE, HOSTILE, system=HOSTILE, stale=HOSTILE),
        HOSTILE,
        HOSTILE,
        Document(url, tuple(triples), messages),
        ("GET", "PUT", "DELETE"),
        (form, ParameterForm(HOSTILE), DeleteForm(HOSTILE, HOSTILE, HOSTILE)),
        csrf=lambda _: '"><script>',
        notices=(Notice(HOSTILE, NoticeLevel.ERROR, (Violation(HOSTILE, HOSTILE, HOSTILE),)),),
        listing=MemberColumns((HOSTILE,), {f"{url}/%22onload%3D%22": (HOSTILE,)}),
        summary=HOSTILE,
    )


# What is on offer below /resources/

SPACE = Space(BASE)
RESOURCES = f"{BASE}resources"
POWER = ScalarShape(Primitive("string"), Bounds(choices=(Literal("on"), Literal("off"))))
SPEED = ScalarShape(
    Primitive("float64"),
    Bounds(minimum=Literal(0), maximum=Literal(1000)),
    Measure(
        NamedNode("http://qudt.org/vocab/unit/REV-PER-MIN"),
        NamedNode("http://qudt.org/vocab/quantitykind/RotationalVelocity"),
    ),
)
DIRECTION = ScalarShape(
    Primitive("float64"),
    Bounds(minimum=Literal(0), exclusive_maximum=Literal(360)),
    Measure(NamedNode("http://qudt.org/vocab/unit/DEG")),
)


def offered(offer: Offer, kind: str, title: str, allow: tuple[str, ...], notices: tuple[Notice, ...] = ()) -> Page:
    """The page of something on offer, with its own forms."""
    match offer:
        case ComplexView():
            document = complex_document(offer, SPACE, LiftSettings())
        case PropertyView():
            document = property_document(offer, SPACE, LiftSettings())
        case ActionView():
            document = action_document(offer, SPACE, LiftSettings())
    return Page(SITE, kind, title, document, allow, forms_of(offer), token, notices, offer=offer)


def of(kind: str, value: object, source: str, *names: str) -> MessageValue:
    """A value that is a message, or some of its fields."""
    found = schema(kind)
    fields = tuple(each for each in found.type.fields if not names or each.name in names)
    return MessageValue(found, message(found, value), fields, f"{BASE}topics{source}")


def data(kind: str, value: object) -> MessageValue:
    """A value that is the `data` of a message."""
    return of(f"std_msgs/msg/{kind}", {"data": value}, "/x")


def member(
    name: str,
    shape: ValueShape,
    value: Value | None,
    predicate: NamedNode | None = None,
    *,
    failure: str | None = None,
    field: str | None = None,
    write: bool = True,
    read: bool = True,
) -> Member:
    """A property by its full name, as it was read."""
    short = name.rpartition("/")[2]
    affordance = PropertyAffordance(short, f"{RESOURCES}{name}", shape, predicate, read=read, write=write)
    return Member(affordance, Reading(name, value, failure, NOW if value or failure else None), field)


def power(value: str) -> Member:
    """Whether the aircraft is started."""
    return member("/aircraft/power", POWER, data("String", value), av.power)


def action(name: str, service: str, relation: NamedNode | None = None) -> ActionAffordance:
    """An action by its full name and the type of its service."""
    found = LIBRARY.find(TypeRef(service))
    assert isinstance(found, ServiceSchema)
    return ActionAffordance(name.rpartition("/")[2], f"{RESOURCES}{name}", found.request, relation)


def aircraft_stopped() -> Page:
    """The paper's aircraft before it is started."""
    view = ComplexView(
        f"{RESOURCES}/aircraft/",
        "/aircraft/",
        (power("off"),),
        (action("/aircraft/start", "std_srvs/srv/Trigger", av.start),),
        parent=f"{RESOURCES}/",
        mapping=f"{BASE}mappings/aircraft#aircraft",
    )
    return offered(view, "Complex resource", "/aircraft/", ("GET", "PATCH"))


def aircraft_started() -> Page:
    """The paper's aircraft once it is started: other links, another action."""
    view = ComplexView(
        f"{RESOURCES}/aircraft/",
        "/aircraft/",
        (power("on"),),
        (action("/aircraft/stop", "std_srvs/srv/Trigger", av.stop),),
        (LinkAffordance(av.engine, f"{RESOURCES}/aircraft/engine/"),),
        (f"{RESOURCES}/aircraft/engine/",),
        f"{RESOURCES}/",
        mapping=f"{BASE}mappings/aircraft#aircraft",
    )
    return offered(view, "Complex resource", "/aircraft/", ("GET", "PATCH"))


def engine() -> Page:
    """Numbers with units."""
    view = ComplexView(
        f"{RESOURCES}/aircraft/engine/",
        "/aircraft/engine/",
        (
            member("/aircraft/engine/speed", SPEED, data("Float64", 500.0), av.speed),
            member("/aircraft/engine/direction", DIRECTION, data("Float64", 270.0), av.direction),
        ),
        links=(LinkAffordance(av.aircraft, f"{RESOURCES}/aircraft/"),),
        parent=f"{RESOURCES}/aircraft/",
        mapping=f"{BASE}mappings/aircraft#engine",
    )
    return offered(view, "Complex resource", "/aircraft/engine/", ("GET", "PATCH"))


def property_view(one: Member, readers: Sequence[str], writers: Sequence[str]) -> PropertyView:
    """A property by itself, with what is behind it."""
    above = one.affordance.url.rpartition("/")[0] + "/"
    return PropertyView(
        one.affordance, one.reading, tuple(BASE + way for way in readers), tuple(BASE + way for way in writers), above
    )


def select() -> Page:
    """A property that has one of two values."""
    view = property_view(power("off"), ["services/aircraft/get_power"], ["services/aircraft/set_power"])
    return offered(view, "Property", "/aircraft/power", ("GET", "PUT"))


def speed_of(failure: str | None = None) -> PropertyView:
    """The speed of the engine."""
    value = data("Float64", 500.0) if failure is None else None
    one = member("/aircraft/engine/speed", SPEED, value, av.speed, failure=failure)
    ways = ["topics/aircraft/engine/speed", "services/aircraft/engine/get_speed"]
    return property_view(one, ways, ["services/aircraft/engine/set_speed"])


def number() -> Page:
    """A property that is a number with a unit and bounds."""
    return offered(speed_of(), "Property", "/aircraft/engine/speed", ("GET", "PUT"))


def limited() -> Page:
    """A value beyond its bounds, refused."""
    page = offered(speed_of(), "Property", "/aircraft/engine/speed", ("GET", "PUT"))
    wrong = (Violation("", "must be at most 1000", "1200.0"),)
    (form,) = page.forms
    assert isinstance(form, ValueForm)
    notice = Notice("Nothing was sent: 1 field does not fit.", NoticeLevel.ERROR, wrong)
    return replace(page, forms=(form.with_submitted([("value", "1200")], wrong),), notices=(notice,))


def unreadable() -> Page:
    """A property that cannot be read now."""
    view = speed_of("/aircraft/engine/get_speed has not answered within 1 s")
    return offered(view, "Property", "/aircraft/engine/speed", ("GET", "PUT"))


def pose() -> Page:
    """A property that is a message, some of whose fields have bounds."""
    kind = schema("geometry_msgs/msg/PoseStamped")
    shape = MessageShape(
        kind, ("header", "pose"), {"pose.position.z": Bounds(minimum=Literal(0)), "header.frame_id": POWER.bounds}
    )
    value = of("geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 1.5}}}, "/arm/goal")
    view = property_view(member("/arm/goal", shape, value), ["topics/arm/goal"], ["topics/arm/goal"])
    return offered(view, "Property", "/arm/goal", ("GET", "PUT"))


def unmapped() -> Page:
    """A namespace that no mapping arranges, with everything that may lie in one."""
    turtle, pen = "turtlesim/msg/Pose", "turtlesim/srv/SetPen"
    pose, place = schema(turtle), ("x", "y", "theta")
    one_of = Bounds(choices=(Literal(1), Literal(2)))
    view = ComplexView(
        f"{RESOURCES}/turtle1/",
        "/turtle1/",
        (
            member("/turtle1/pose", MessageShape(pose, place), of(turtle, {"x": 5.5}, "/p", *place), write=False),
            member("/turtle1/name", OpenShape(), StoredValue("Leonardo")),
            member("/turtle1/limits", OpenShape(), StoredValue([0.5, 1.0, 1.5])),
            member("/turtle1/awake", ScalarShape(Primitive("bool")), data("Bool", True)),
            member("/turtle1/gear", ScalarShape(Primitive("int8"), one_of), data("Int8", 3)),
            member("/turtle1/height", ScalarShape(Primitive("float32")), of(turtle, {}, "/p"), field="y"),
            member("/turtle1/lamp", ScalarShape(Primitive("bool")), None, read=False),
            member("/turtle1/battery", OpenShape(), None, failure="/get_battery is gone", write=False),
            member("/turtle1/distance", ScalarShape(Primitive("float64")), None, write=False),
        ),
        (
            action("/turtle1/reset", "std_srvs/srv/Empty"),
            action("/turtle1/center_the_view", "std_srvs/srv/Trigger"),
            action("/turtle1/set_pen", pen),
            ActionAffordance("dance", f"{RESOURCES}/turtle1/dance", None),
        ),
        children=(f"{RESOURCES}/turtle1/left%20arm/", f"{RESOURCES}/turtle1/camera/"),
        parent=f"{RESOURCES}/",
    )
    return offered(view, "Complex resource", "/turtle1/", ("GET", "PATCH"))


def press() -> Page:
    """An action that takes nothing."""
    one = action("/aircraft/start", "std_srvs/srv/Trigger", av.start)
    view = ActionView(one, f"{BASE}services/aircraft/start", f"{RESOURCES}/aircraft/")
    return offered(view, "Action", "/aircraft/start", ("GET", "POST"))


def declined() -> Page:
    """An action that was declined."""
    view = ActionView(
        action("/turtle1/set_pen", "turtlesim/srv/SetPen"),
        f"{BASE}services/turtle1/set_pen",
        f"{RESOURCES}/turtle1/",
    )
    notices = (Notice("/turtle1/set_pen declined: there is no ink.", NoticeLevel.ERROR),)
    return offered(view, "Action", "/turtle1/set_pen", ("GET", "POST"), notices)


def hostile_offer() -> Page:
    """Resources named by somebody who means harm."""
    text, odd = HOSTILE.replace("\x00", ""), f"{RESOURCES}/%3Cscript%3E"
    strange = Bounds(choices=(Literal(text),), pattern=HOSTILE)
    stranger = Bounds(pattern='"><script>', minimum=Literal(text), min_length=3)
    told = Measure(NamedNode("javascript:alert(1)"), NamedNode("javascript:alert(1)"))
    view = ComplexView(
        f"{odd}/",
        f"/{text}/",
        (
            Member(
                PropertyAffordance(text, f"{odd}/a", ScalarShape(Primitive("string"), strange), title=text, write=True),
                Reading(text, data("String", text), None, NOW),
            ),
            Member(
                PropertyAffordance(text, f"{odd}/b", ScalarShape(Primitive("float64"), stranger, told), write=True),
                Reading(text, None, HOSTILE),
            ),
            Member(
                PropertyAffordance(text, f"{odd}/c", OpenShape(stranger, told), NamedNode("javascript:alert(1)")),
                Reading(text, StoredValue({"a": [text]})),
            ),
            Member(
                PropertyAffordance(text, "javascript:alert(1)", ScalarShape(Primitive("string"), stranger), write=True),
                Reading(text, StoredValue(text)),
                text,
            ),
        ),
        (
            ActionAffordance(
                text, "https://elsewhere.example/", schema("std_msgs/msg/Empty"), NamedNode("javascript:alert(1)"), text
            ),
            ActionAffordance(text, f"{odd}/d", schema("std_msgs/msg/Empty"), title=text),
            ActionAffordance(text, f"{odd}/e", schema("std_msgs/msg/String"), title=text),
        ),
        (LinkAffordance(NamedNode("javascript:alert(1)"), "javascript:alert(1)"), LinkAffordance(av.engine, odd)),
        (f"{odd}/%22onload%3D%22/", "javascript:alert(1)"),
        "javascript:alert(1)",
        text,
        "javascript:alert(1)",
    )
    return offered(view, HOSTILE, HOSTILE, ("GET", "PATCH"))


QUERIES = (
    StoredQueryLink(
        f"{BASE}queries/silent-sensors", "silent-sensors", "Which topics have not spoken for a while?", "SELECT"
    ),
    StoredQueryLink(f"{BASE}queries/who-publishes", "who-publishes", "Who publishes messages of which type?", "SELECT"),
)
ROWS = [
    (
        NamedNode(f"{BASE}topics/aircraft/engine/speed"),
        NamedNode(f"{TYPES}std_msgs/msg/Float64"),
        Literal("10.0", datatype=xsd.double),
    ),
    (
        NamedNode(f"{BASE}topics/front_laser_scan"),
        NamedNode(f"{TYPES}sensor_msgs/msg/LaserScan"),
        Literal("40.0", datatype=xsd.double),
    ),
    (NamedNode(f"{BASE}topics/odd"), None, Literal(HOSTILE)),
]


def sparql() -> bytes:
    """The page of the endpoint with results."""
    return render_sparql(SparqlPage(SITE, examples=QUERIES, results=PageResults(("topic", "type", "rate"), ROWS)))


def query() -> bytes:
    """A stored query with a parameter, its results cut."""
    text = "SELECT ?topic WHERE {\n  ?topic a <https://w3id.org/rosld#Topic> .\n}"
    stored = StoredQueryLink(f"{BASE}queries/silent-sensors", "silent-sensors", QUERIES[0].purpose, text)
    parameters = (StoredQueryParameter("seconds", "how long a topic may be silent", "5"),)
    results = PageResults(("topic", "type", "rate"), ROWS, limit=2)
    return render_query(QueryPage(SITE, stored, parameters, results))


def entry(stale: bool = False) -> bytes:
    """The entry page."""
    triples = said(
        BASE,
        (rdf.type, ros.Graph),
        (ros.state, ros.Stale if stale else ros.Live),
        (ros.hasMaster, f"{BASE}#master"),
    )
    master = said(f"{BASE}#master", (rdf.type, ros.Master), (ros.uri, "http://localhost:11311/"))
    counts = (
        EntryCount(
            "resources", None, f"{BASE}resources/", "What the robot is like now, and what it can do.", first=True
        ),
        EntryCount("nodes", 2, f"{BASE}nodes/", "Who takes part, and with what."),
        EntryCount("topics", 14, f"{BASE}topics/", "What is published, by whom, how often."),
        EntryCount("services", 9, f"{BASE}services/", "What can be called."),
        EntryCount("parameters", 5, f"{BASE}parameters/", "What can be set."),
        EntryCount("types", 11, f"{BASE}types/", "What messages are made of."),
        EntryCount("queries", 8, f"{BASE}queries/", "Questions to start from."),
        EntryCount("SPARQL", None, f"{BASE}sparql", "Ask the whole robot at once."),
        EntryCount("vocabulary", None, f"{BASE}ontology", "What the words mean."),
    )
    site = Site(BASE, "aircraft", "The paper's aircraft", "no answer since 01:31:41 UTC." if stale else None)
    document = Document(BASE, (*triples, *master))
    return render_entry(EntryPage(site, document, counts, f"{BASE}topics/aircraft/engine/speed"))


def problem() -> bytes:
    """A refusal."""
    wrong = (Violation("linear.x", "missing: expected a float64"), Violation("angular", "expected a Vector3", "12"))
    detail = "The body is no geometry_msgs/msg/Twist: two fields do not fit. Nothing was published."
    return render_problem(
        ProblemPage(SITE, 422, "Unprocessable Content", detail, f"{BASE}topics/cmd_vel", violations=wrong)
    )


def gallery() -> Mapping[str, bytes]:
    """All pages by name."""
    pages = (
        speed, display, odometry, twist, image, scan, transforms, topics, parameter, service, call, message_type,
        aircraft_stopped, aircraft_started, engine, select, number, limited, unreadable, pose, unmapped, press,
        declined, hostile_offer,
    )  # fmt: skip
    drawn = {page.__name__: render_page(page()) for page in pages}
    return {
        "entry": entry(),
        "stale": entry(stale=True),
        **drawn,
        "refused": render_page(twist(refused=True)),
        "hostile": render_page(hostile()),
        "sparql": sparql(),
        "query": query(),
        "problem": problem(),
    }


def handler(pages: Mapping[str, bytes], extra: Mapping[str, bytes]) -> type[BaseHTTPRequestHandler]:
    """Serves pages by name, and `extra` without the policy (it may hold a script that measures)."""
    files = {"style.css": (STYLESHEET, "text/css"), "icon.svg": (ICON, "image/svg+xml")}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            name = urlsplit(self.path).path.strip("/") or next(iter(pages))
            body, kind = files.get(name) or (pages.get(name) or extra.get(name), "text/html; charset=utf-8")
            self.send_response(200 if body else 404)
            self.send_header("Content-Type", kind)
            for key, value in HEADERS.items() if name not in extra else ():
                self.send_header(key, value.replace("frame-ancestors 'none'", "frame-ancestors 'self'"))
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, format: str, *args: object) -> None:
            pass

    return Handler


@contextmanager
def served(pages: Mapping[str, bytes], extra: Mapping[str, bytes] | None = None, port: int = 0) -> Iterator[str]:
    """The pages on a loopback port; yields the URL."""
    server = ThreadingHTTPServer(("127.0.0.1", port), handler(pages, extra or {}))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()


def chromium(*arguments: str) -> str:
    """Run the browser without a window, in a profile of its own; returns what it prints."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        raise FileNotFoundError("chromium is not installed; tests/debian-browser.txt lists what is needed")
    with tempfile.TemporaryDirectory() as profile:
        quiet = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking"
        command = [program, *quiet.split(), "--disable-component-update", "--disable-sync", "--hide-scrollbars"]
        done = subprocess.run(
            [*command, f"--user-data-dir={profile}", *arguments], capture_output=True, timeout=120, check=True
        )
    return done.stdout.decode("utf-8", "replace")


def phone(name: str, width: int = 390, height: int = 844) -> bytes:
    """A page holding another in a frame as wide as a phone."""
    frame = f'<iframe src="/{name}" width="{width}" height="{height}" style="border:0"></iframe>'
    return f'<!doctype html><body style="margin:0">{frame}'.encode()


def shoot(folder: Path, names: Sequence[str]) -> None:
    """Photograph pages: wide, wide and dark, and on a phone."""
    pages = {name: body for name, body in gallery().items() if not names or name in names}
    frames = {f"phone-{name}": phone(name, height=1500) for name in pages}
    with served(pages, frames) as url:
        for name in pages:
            chromium(f"--screenshot={folder / name}.png", "--window-size=1200,1300", url + name)
            dark = "--blink-settings=preferredColorScheme=0"
            chromium(dark, f"--screenshot={folder / name}-dark.png", "--window-size=1200,1300", url + name)
            chromium(f"--screenshot={folder / name}-phone.png", "--window-size=500,1500", f"{url}phone-{name}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shoot", type=Path, metavar="DIR")
    parser.add_argument("names", nargs="*")
    options = parser.parse_args()
    if options.shoot:
        options.shoot.mkdir(parents=True, exist_ok=True)
        shoot(options.shoot, options.names)
        return
    with served(gallery(), port=8090) as url:
        print("\n".join(url + name for name in gallery()), flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)
