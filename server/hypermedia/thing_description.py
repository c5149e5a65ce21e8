"""Thing Descriptions (WoT TD 1.1) of complex resources, or of the whole robot, as JSON and as RDF. Pure.

Clients store them, so they list all affordances, including those not on offer now; the RDF of the resources has the
current ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TypeAlias, TypeVar

import orjson
from msgspec import Struct
from pyoxigraph import BlankNode, RdfFormat, Triple, parse

from rosld.ontology.describe_holds import CONFIRM, CONFIRM_PARAMETER, HOLD, MAX_LEASE, MAX_RATE, MEANINGS, PARAMETERS
from rosld.ontology.document import Document
from rosld.ontology.lift import LiftSettings
from rosld.ontology.vocab import hctl, htv, js, mapping, qudt, ros, td, wotsec, xsd
from rosld.server.hypermedia.json_schema import (
    OBJECT,
    TEXT,
    JsonSchema,
    json_object,
    message_schema,
    value_schema,
    without_none,
)
from rosld.server.hypermedia.views import ActionAffordance, PropertyAffordance

MEDIA_TYPE = "application/td+json"

Members: TypeAlias = "dict[str, object]"

_JSON = "application/json"
_OBSERVE = ("observeproperty", "unobserveproperty")
_SUBSCRIBE = ("subscribeevent", "unsubscribeevent")
_ANY: tuple[JsonSchema, ...] = tuple({"type": name} for name in ("boolean", "number", "string", "array", "object"))
_CONTEXT = (
    "https://www.w3.org/2022/wot/td/v1.1",
    {"ros": ros.iri, "map": mapping.iri, "qudt": qudt.iri},
)
_SECURITY: Members = {"nosec_sc": {"scheme": "nosec"}}
"""Security schemes by name; a client needs all of them (WoT TD 1.1, 5.3.3)."""

CHANGED = "changed"
"""Name of the event of a thing that a member has changed."""
STOP = "stopRobot"
"""Name of the action that stops the whole robot in every Thing Description."""

_SETTINGS = LiftSettings()
_POSITIVE: Members = {"type": "number", "exclusiveMinimum": 0}
_HOLD_VARIABLES: Members = {
    "rate": {"description": MEANINGS["rate"], **_POSITIVE, "maximum": MAX_RATE},
    "lease": {"description": MEANINGS["lease"], **_POSITIVE, "maximum": MAX_LEASE},
    "for": {"description": MEANINGS["for"], **_POSITIVE},
    "then": {"description": MEANINGS["then"], "type": "string"},
}


class ThingLink(Struct, frozen=True):
    """A link of a thing: `relation` is a registered one (`item`, `collection`, `type`) or an IRI."""

    relation: str
    target: str
    media_type: str | None = MEDIA_TYPE


def thing_description(
    title: str,
    url: str,
    properties: Sequence[PropertyAffordance],
    actions: Iterable[ActionAffordance],
    *,
    links: Sequence[ThingLink] = (),
    description: str | None = None,
    whole: bool = False,
    stop: str | None = None,
    diagnostics: str | None = None,
    lifting: LiftSettings = _SETTINGS,
) -> bytes:
    """Return the Thing Description of the thing at `url` in JSON-LD, with affordances by name.

    `whole`: GET of `url` reads all these properties at once. `stop` is the URL that stops the whole robot,
    `diagnostics` that of its diagnostics. Affordances without forms, which can never be used, are omitted.
    """
    actions = [one for one in actions if one.request is not None]
    thing: Members = {
        "@context": _CONTEXT,
        "@type": "Thing",
        "id": url,
        "title": title,
        **without_none(description=description),
        "securityDefinitions": _SECURITY,
        "security": list(_SECURITY),
        "properties": {one.name: _property(one, lifting) for one in properties if one.read or one.write},
        "actions": {
            **{one.name: _action(one, lifting) for one in actions},
            **{f"{one.name}/hold": _hold(one, lifting) for one in properties if one.hold is not None},
            **({} if stop is None else {STOP: _stop(stop)}),
        },
        "events": {
            **({CHANGED: _event("A member has changed.", url, OBJECT)} if whole else {}),
            **({} if diagnostics is None else {"diagnostics": _event("A diagnosis has changed.", diagnostics, OBJECT)}),
            **dict(_feedback(actions, lifting)),
        },
        "links": [_link(link) for link in links],
    }
    if whole:
        thing["forms"] = [_form(url, "readallproperties", "GET")]
    return orjson.dumps(thing)


@lru_cache(maxsize=4096)
def _property(one: PropertyAffordance, lifting: LiftSettings) -> orjson.Fragment:
    """Return a property (5.3.1.3): the data schema of its value, and a form for each operation."""
    observable = one.read and one.observe
    forms = [
        *([_form(one.url, "readproperty", "GET")] if one.read else ()),
        *([_form(one.url, "writeproperty", "PUT")] if one.write else ()),
        # The content type is that of the data in each event.
        *([_form(one.url, _OBSERVE, "GET", subprotocol="sse")] if observable else ()),
    ]
    return _fragment(
        {
            **without_none(title=one.title, description=one.description),
            **_data_schema(value_schema(one.shape, lifting, read=one.read, sent=one.write), nullable=observable),
            "readOnly": not one.write,
            "writeOnly": not one.read,
            "observable": observable,
            **_led_to("map:predicate", one.predicate and one.predicate.value),
            **_led_to("qudt:hasUnit", one.shape.quantity.unit),
            **_led_to("qudt:hasQuantityKind", one.shape.quantity.kind),
            "forms": forms,
        }
    )


def _data_schema(schema: JsonSchema, *, nullable: bool) -> JsonSchema:
    """Return a schema with a `type` or `oneOf`, as clients demand; a nullable one accepts null, too.

    Keywords other than `type` stay where clients look for them: they do not concern null.
    """
    if not schema.keys() & {"type", "oneOf", "enum"}:
        return {**schema, "oneOf": [*_ANY]}
    if not nullable:
        return schema
    rest = {name: value for name, value in schema.items() if name not in ("type", "oneOf", "enum")}
    if isinstance(choices := schema.get("enum"), list):
        return {**rest, "enum": [*choices, None]}
    present = schema.get("oneOf")
    alternatives = present if isinstance(present, list) else [{"type": schema["type"]}]
    return {**rest, "oneOf": [*alternatives, {"type": "null"}]}


@lru_cache(maxsize=4096)
def _action(one: ActionAffordance, lifting: LiftSettings) -> orjson.Fragment:
    """Return an action (5.3.1.4) with its input, if any.

    Its output is the state of its complex resource or, if it sends goals, the goal, which can be queried and canceled:
    feedback and result are properties.
    """
    assert one.request is not None
    has_input = bool(one.request.type.fields)
    schema = message_schema(one.request, lifting, read=False, sent=True) if has_input else None
    forms = [_form(one.url, "invokeaction", "POST"), *_goal_forms(one)]
    members = _action_members(schema, forms, synchronous=one.goals is None)
    return _fragment(
        {**without_none(title=one.title), **members, **_led_to("map:relation", one.relation and one.relation.value)}
    )


def _action_members(
    schema: JsonSchema | None, forms: Sequence[Members], *, synchronous: bool, idempotent: bool = False
) -> Members:
    """Return the members of an action with the input `schema`, or without input."""
    return {
        **without_none(input=schema),
        "output": OBJECT,
        "safe": False,
        "idempotent": idempotent,
        "synchronous": synchronous,
        "forms": forms,
    }


def _hold(one: PropertyAffordance, lifting: LiftSettings) -> Members:
    """Return the action that holds the topic behind a property while the client renews the hold."""
    schema = value_schema(one.shape, lifting, read=False, sent=True)
    members = _action_members(schema, [_form(f"{one.hold}{PARAMETERS}", "invokeaction", "POST")], synchronous=False)
    return {"title": f"Hold {one.name}", "description": HOLD, "uriVariables": _HOLD_VARIABLES, **members}


def _goal_forms(one: ActionAffordance) -> Iterator[Members]:
    if one.goals is not None and one.goals.status is not None:
        yield _form(one.goals.status, "queryaction", "GET")
    if one.goals is not None and one.goals.can_cancel:
        yield _form(one.url, "cancelaction", "DELETE")


def _feedback(actions: Iterable[ActionAffordance], lifting: LiftSettings) -> Iterator[tuple[str, Members]]:
    """Yield the event of each action that reports on its goals."""
    for one in actions:
        if one.goals is not None and one.goals.status is not None and one.goals.feedback is not None:
            data = message_schema(one.goals.feedback, lifting)
            yield (
                f"{one.name}/feedback",
                _event(f"Feedback on a goal of {one.name}.", f"{one.goals.status}feedback", data),
            )


def _event(about: str, url: str, data: JsonSchema) -> Members:
    """Return an event (5.3.1.5), which is an event stream of the resource at `url`."""
    return {"description": about, "data": data, "forms": [_form(url, _SUBSCRIBE, "GET", subprotocol="sse")]}


def _stop(url: str) -> Members:
    """Return the action that stops the whole robot; querying it returns the stop, canceling it releases the robot."""
    forms = [
        _form(url, "invokeaction", "POST"),
        _form(url, "queryaction", "GET"),
        _form(f"{url}{CONFIRM_PARAMETER}", "cancelaction", "DELETE"),
    ]
    members = _action_members(
        json_object(optional={"reason": {**TEXT, "maxLength": 500}}), forms, synchronous=True, idempotent=True
    )
    variables = {"confirm": {"description": CONFIRM, **TEXT}}
    return {"title": "Stop the whole robot", "uriVariables": variables, **members}


def _form(url: str, operation: str | Sequence[str], method: str, **more: str) -> Members:
    """Return a form (5.3.4.2)."""
    return {"href": url, "op": operation, "htv:methodName": method, "contentType": _JSON, **more}


def _link(link: ThingLink) -> Members:
    """Return a link (5.3.4.1)."""
    return {"rel": link.relation, "href": link.target, **without_none(type=link.media_type)}


def _led_to(term: str, iri: str | None) -> Members:
    """Return a member with a term of a vocabulary of the context as an IRI; empty for None."""
    return {} if iri is None else {term: {"@id": iri}}


def _fragment(members: Members) -> orjson.Fragment:
    return orjson.Fragment(orjson.dumps(members))


_T = TypeVar("_T")

_OPERATIONS = (
    *("readProperty", "writeProperty", "observeProperty", "unobserveProperty", "readAllProperties"),
    *("invokeAction", "queryAction", "cancelAction", "subscribeEvent", "unsubscribeEvent"),
)
_TEXT = {"@language": "en"}


def _named(predicate: str, name: str, context: Mapping[str, object]) -> dict[str, object]:
    """Return the term of a member whose value maps names to objects; each gets its name as a property."""
    return {"@id": predicate, "@container": "@index", "@index": name, "@context": context}


_SCHEMA: dict[str, object] = {
    "@vocab": js.iri,
    **{
        name: f"js:{name.capitalize()}Schema"
        for name in ("object", "array", "boolean", "string", "number", "integer", "null")
    },
    "type": "@type",
    "unit": {"@id": "http://schema.org/unitCode", "@type": "@vocab"},
    "properties": {"@id": "js:properties", "@container": "@index", "@index": "js:propertyName"},
}
_HYPERMEDIA = {
    **{name.lower(): f"td:{name}" for name in _OPERATIONS},
    "op": {"@id": "hctl:hasOperationType", "@type": "@vocab"},
    "href": {"@id": "hctl:hasTarget", "@type": xsd.anyURI.value},
    "contentType": "hctl:forContentType",
    "subprotocol": "hctl:forSubProtocol",
    "rel": "hctl:hasRelationType",
    "type": "hctl:hintsAtMediaType",
}
_RDF_SECURITY = {
    "@vocab": wotsec.iri,
    "scheme": "@type",
    **{name: f"wotsec:{name.capitalize()}SecurityScheme" for name in ("combo", "bearer", "basic")},
    "nosec": "wotsec:NoSecurityScheme",
}
_RDF_CONTEXT: Mapping[str, object] = {
    "@version": 1.1,
    "@vocab": td.iri,
    "td": td.iri,
    "js": js.iri,
    "hctl": hctl.iri,
    "htv": htv.iri,
    "wotsec": wotsec.iri,
    "id": "@id",
    "title": {"@id": "td:title", **_TEXT},
    "description": {"@id": "td:description", **_TEXT},
    # The outermost members of a property's value are called by td:name, all others by js:propertyName.
    "properties": _named(
        "td:hasPropertyAffordance",
        "td:name",
        {**_SCHEMA, "properties": _named("js:properties", "td:name", {"properties": _SCHEMA["properties"]})},
    ),
    "actions": _named("td:hasActionAffordance", "td:name", {}),
    "events": _named("td:hasEventAffordance", "td:name", {}),
    "uriVariables": _named("td:hasUriTemplateSchema", "td:name", {}),
    "input": {"@id": "td:hasInputSchema", "@context": _SCHEMA},
    "output": {"@id": "td:hasOutputSchema", "@context": _SCHEMA},
    "data": {"@id": "td:hasNotificationSchema", "@context": _SCHEMA},
    "observable": "td:isObservable",
    "safe": "td:isSafe",
    "idempotent": "td:isIdempotent",
    "synchronous": "td:isSynchronous",
    "forms": {"@id": "td:hasForm", "@context": _HYPERMEDIA},
    "links": {"@id": "td:hasLink", "@context": _HYPERMEDIA},
    "security": "td:hasSecurityConfiguration",
    "securityDefinitions": _named("td:definesSecurityScheme", "td:hasInstanceConfiguration", _RDF_SECURITY),
    "td:hasInstanceConfiguration": {"@type": "@id"},
}


def thing_document(data: bytes, url: str) -> Document:
    """Return a Thing Description, which is JSON, as the document at its URL."""
    thing = orjson.loads(data)
    thing["@context"] = [each if isinstance(each, dict) else _RDF_CONTEXT for each in thing["@context"]]
    quads = parse(orjson.dumps(thing), RdfFormat.JSON_LD, base_iri=url)
    return Document(url, tuple(dict.fromkeys(_numbered(quad.triple for quad in quads))))


def _numbered(triples: Iterable[Triple]) -> Iterable[Triple]:
    """Yield triples whose blank nodes have numbers, so that a description is written the same each time."""
    known: dict[object, BlankNode] = {}

    def rename(term: _T) -> _T | BlankNode:
        return known.setdefault(term, BlankNode(f"n{len(known) + 1}")) if isinstance(term, BlankNode) else term

    for triple in triples:
        yield Triple(rename(triple.subject), triple.predicate, rename(triple.object))
