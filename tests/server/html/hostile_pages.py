"""Pages with everything that a robot names, with malicious names: more than any one robot could have."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec.structs import replace
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Primitive
from rosld.ontology.document import Document
from rosld.ontology.lift import LiftSettings
from rosld.ontology.units import Quantity
from rosld.ontology.urls import Space
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import av, ldp, rdf, rdfs, ros
from rosld.server.html.forms import DeleteForm, ValueForm, message_form
from rosld.server.html.offer import forms_of
from rosld.server.html.page import MemberColumns, Notice, NoticeLevel, Page
from rosld.server.html.site import Site
from rosld.server.hypermedia.value import MessageValue, Reading, StoredValue
from rosld.server.hypermedia.view_documents import complex_document
from rosld.server.hypermedia.views import ActionAffordance, ComplexView, LinkAffordance, Member, PropertyAffordance
from rosld.shapes.value import Bounds, OpenShape, ScalarShape
from tests.server.html.messages import BASE, NOW, lifted, message, schema

HOSTILE = '<script>alert("x")</script>\'\u202e&amp;\x00'
RESOURCES = f"{BASE}resources"


def said(url: str, *pairs: tuple[NamedNode, object]) -> Iterator[Triple]:
    """Yield triples about a URL; texts that begin with the base are IRIs."""
    for predicate, value in pairs:
        yield Triple(NamedNode(url), predicate, term(value))


def term(value: object) -> NamedNode | Literal:
    """Return a value as a term."""
    if isinstance(value, NamedNode | Literal):
        return value
    assert isinstance(value, str)
    return NamedNode(value) if value.startswith(BASE) else Literal(value)


def hostile_page() -> Page:
    """Return a page with malicious names in every place."""
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
    form = replace(
        message_form(kind, title=HOSTILE, button=HOSTILE, value={"data": HOSTILE}, about=HOSTILE),
        submitted=(("data", HOSTILE),),
        violations=(Violation("data", HOSTILE, HOSTILE), Violation(HOSTILE, HOSTILE, HOSTILE)),
    )
    return Page(
        Site(BASE, HOSTILE, system=HOSTILE, stale=HOSTILE),
        HOSTILE,
        HOSTILE,
        Document(url, tuple(triples), messages),
        ("GET", "PUT", "DELETE"),
        (form, ValueForm(OpenShape(), value=HOSTILE), DeleteForm(HOSTILE, HOSTILE, HOSTILE)),
        csrf=lambda _: '"><script>',
        notices=(Notice(HOSTILE, NoticeLevel.ERROR, (Violation(HOSTILE, HOSTILE, HOSTILE),)),),
        listing=MemberColumns((HOSTILE,), {f"{url}/%22onload%3D%22": (HOSTILE,)}),
        summary=HOSTILE,
    )


def hostile_offer() -> Page:
    """Return resources with malicious names."""
    text, odd = HOSTILE.replace("\x00", ""), f"{RESOURCES}/%3Cscript%3E"
    strange = Bounds(choices=(Literal(text),), pattern=HOSTILE)
    stranger = Bounds(pattern='"><script>', minimum=Literal(text), min_length=3)
    quantity = Quantity("javascript:alert(1)", "javascript:alert(1)")
    kind = schema("std_msgs/msg/String")
    told = MessageValue(kind, message(kind, {"data": text}), kind.type.fields, f"{BASE}topics/x")
    view = ComplexView(
        f"{odd}/",
        f"/{text}/",
        (
            Member(
                PropertyAffordance(text, f"{odd}/a", ScalarShape(Primitive("string"), strange), title=text, write=True),
                Reading(text, told, None, NOW),
            ),
            Member(
                PropertyAffordance(text, f"{odd}/b", ScalarShape(Primitive("float64"), stranger, quantity), write=True),
                Reading(text, None, HOSTILE),
            ),
            Member(
                PropertyAffordance(text, f"{odd}/c", OpenShape(stranger, quantity), NamedNode("javascript:alert(1)")),
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
    document = complex_document(view, Space(BASE), LiftSettings())
    site = Site(BASE, "aircraft", system="The paper's aircraft")
    return Page(site, HOSTILE, HOSTILE, document, ("GET", "PATCH"), forms_of(view), lambda _: "token", offer=view)
