"""Offers: what can be read and done at a URL, as one small JSON object for agents (`URL?offer`).

An offer is written from what the resource says of itself elsewhere: its path item (as OpenAPI does), its forms (as its
page does) and its state. So it is of the current moment, and within the permissions of the agent.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import cast

import orjson
from starlette.responses import Response

from rosld.adapters.model import TypeRef, halves_of
from rosld.ontology.units import unit_symbols
from rosld.ontology.vocab import ldp
from rosld.server.auth import enforcement
from rosld.server.html.cockpit_form import Method
from rosld.server.html.forms import DeleteForm, Form, HoldForm, ValueForm
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import Json, JsonSchema, MessageSchemas, value_schema
from rosld.server.hypermedia.views import ComplexView
from rosld.server.resources.limit_checks import STRICTNESS
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, MERGE_PATCH, OFFER_TYPE, OFFERS
from rosld.server.rest.path_item import OF_EVERY_WRITE, PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import Resource
from rosld.server.rest.responses import bytes_response, offer_url, resource_headers
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.routing.representations import redacted_state
from rosld.server.routing.write_answers import OFFER
from rosld.shapes.value import MessageShape

MAX_VALUE = 300
"""Maximum number of bytes of a value that an offer contains."""
MAX_MEMBERS = 3000
"""Maximum number of bytes of the members of a container in an offer."""
_SHORT = 40
"""Minimum number of bytes of a schema that others refer to."""
_MAX_INPUT = 1500
"""Maximum number of bytes of a schema; deeper objects of larger ones are left open."""
_MAX_WITH_UNITS, _MAX_UNITS = 1_024, 12
"""Maximum number of bytes of an offer that names units, and of the units in it."""
_DEPTHS = (99, 6, 4, 3, 2, 1)
"""Numbers of levels that a schema keeps, tried until it is small enough."""
_WRITES: tuple[Method, ...] = ("PUT", "POST", "PATCH", "DELETE")
_UNMENTIONED = frozenset({"format", "latch", *(each.name for each in (*OF_EVERY_WRITE, *STRICTNESS))})
_PAST = frozenset({"series", "at"})
_OTHER_READS = frozenset({"field", "width", "below"}) | _PAST
"""Parameters of GET for a part of the value, a smaller picture, or the recorded past."""
_WIDE = 1_000_000
"""Bounds from here on belong to the type rather than to the value."""


def wants_offer(exchange: Exchange) -> bool:
    """Whether a request asks for the offer of a resource: by `?offer`, or by a media type that it prefers."""
    if exchange.method not in ("GET", "HEAD"):
        return False
    if b"offer" in exchange.request.scope["query_string"] and exchange.query_flag(OFFER):
        return True
    accept = exchange.accept
    return accept is not None and OFFER_TYPE in accept and choose_offer(accept, (*OFFERS, OFFER_TYPE)) == OFFER_TYPE


class Offers:
    """Writer of the offers of one robot's resources."""

    def __init__(self, session: Session) -> None:
        self._session = session

    async def answer(self, exchange: Exchange, resource: Resource) -> Response:
        """Answer a GET with the offer of a resource. Raises as `offer`."""
        data = await self.offer(exchange, resource)
        return bytes_response(
            exchange, data, OFFER_TYPE, ETag(digest(data), "offer"), resource_headers(resource).items()
        )

    async def offer(self, exchange: Exchange, resource: Resource) -> bytes:
        """Return the offer of a resource for the agent. Raises the Problems of its state, and RosError."""
        state = await _state(exchange, resource)
        schemas = MessageSchemas(self._session.schemas.find_similar, self._session.lifting)
        item = resource.path_item(schemas)
        place = enforcement.location_of(exchange.request.scope, self._session.space)
        methods = resource.methods() - resource.withheld
        if place is not None:
            methods &= enforcement.allowed_methods(exchange.permissions, place, resource)
        forms = {form.method: form for form in await resource.forms() if not form.action}
        written = {
            "url": resource.url,
            "is": item.summary,
            **_type(state, forms.values()),
            **_read(resource, item, state),
            **self._writes(resource, state, item, methods, forms, schemas),
            **_refusal(exchange, resource, item, methods),
            **_contents(resource, state),
            **self._links(exchange, resource),
        }
        with_units = orjson.dumps({**written, **self._units(written.get("type"), forms.values())})
        return with_units if len(with_units) <= _MAX_WITH_UNITS else orjson.dumps(written)

    def _units(self, name: Json, forms: Iterable[Form]) -> Mapping[str, Json]:
        """Return the unit of a value, or the units of the fields of a message, a request or a goal by path."""
        for form in forms:
            if isinstance(form, ValueForm) and form.shape is not None and form.shape.quantity.symbol:
                return {"unit": form.shape.quantity.symbol}
        schema = self._session.schemas.find_similar(TypeRef(name)) if isinstance(name, str) else None
        symbols = {} if schema is None else unit_symbols(halves_of(schema)[0], _MAX_UNITS)
        return {"units": cast(Json, symbols)} if symbols else {}

    def _links(self, exchange: Exchange, resource: Resource) -> Mapping[str, Json]:
        """Return the links of the entry point to the search, the guide and the stop."""
        links = {link.rel: link.target for link in resource.links if link.rel in ("search", "help")}
        if resource.url == self._session.space.base:
            links["stop"] = self._session.space.stop
        return {rel: url for rel, url in links.items() if exchange.permissions.may_read(url)}

    def _writes(
        self,
        resource: Resource,
        state: State | None,
        item: PathItem,
        methods: frozenset[str],
        forms: Mapping[Method, Form],
        schemas: MessageSchemas,
    ) -> Mapping[str, Json]:
        """Return what can be done: the input that most methods take, an example of it, and each method."""
        asked = [each for each in _WRITES if each in methods and not (each == "PATCH" and "PUT" in methods)]
        is_complex = state is not None and isinstance(state.view, ComplexView)
        done: list[Json] = []
        shared: JsonSchema | None = None
        members: dict[str, Json] = {}
        for method in asked:
            form, write = forms.get(method), item.write(method)
            schema = None if is_complex else self._input(form, write, schemas)
            operation = _operation(method, form, write)
            accepted = write.accepts or resource.accepts.get(method, ())
            if accepted and JSON not in accepted:
                operation["contentType"] = MERGE_PATCH if MERGE_PATCH in accepted else accepted[0]
            if schema is not None and shared is None:
                shared = schema
                members = {"input": schema, "example": example(schema) if (now := _current(form)) is None else now}
            elif schema is not None and schema != shared:
                operation |= {"input": schema, "example": example(schema)}
            done.append(operation)
        if not done:
            return {}
        return {**members, "do": done, "dryRun": "?dry-run=true"}

    def _input(self, form: Form | None, write: WriteMethod, schemas: MessageSchemas) -> JsonSchema | None:
        """Return the compact schema of a body, None without one."""
        sent = write.sends
        if isinstance(form, ValueForm) and (sent is None or "$ref" in sent or not isinstance(form.shape, MessageShape)):
            return compact(value_schema(form.shape, self._session.lifting, read=False, sent=True))  # it has the limits
        return None if sent is None else compact(_resolved(sent, schemas.by_key))


def _current(form: Form | None) -> Json:
    """Return the current value in a form, None if there is none or it is large."""
    value = cast(Json, form.value) if isinstance(form, ValueForm) else None
    return value if len(orjson.dumps(value)) <= MAX_VALUE else None


async def _state(exchange: Exchange, resource: Resource) -> State | None:
    """Return what the agent may read of the state of a resource, None for a file."""
    if type(resource).state is Resource.state:
        return None
    return redacted_state(resource, await resource.state(), exchange.permissions)


def _type(state: State | None, forms: Iterable[Form]) -> Mapping[str, Json]:
    """Return the ROS type of the value, if it has one."""
    sent = (form.type for form in forms if isinstance(form, ValueForm) and form.type)
    read = ("/".join(url.split("/")[-3:]) for url in (() if state is None else state.shapes))
    name = next(chain(sent, read), None)
    return {} if name is None else {"type": name.removesuffix("_Goal").removesuffix("_Request")}


def _read(resource: Resource, item: PathItem, state: State | None) -> Mapping[str, Json]:
    """Return what reading gives: the value if it is small, else its size, and the other media types."""
    if state is None:
        return {"read": {"types": list[Json](item.reads)}}
    if state.plain is None:
        return {}
    try:
        data = state.plain()
    except Problem as problem:
        return {"read": {"unreadable": problem.detail}}
    if data == b"null":
        return {"read": {"value": None}}
    read: dict[str, Json] = {"bytes": len(data)}
    value: Json = orjson.loads(data)
    if len(data) <= MAX_VALUE:
        read["value"] = value
    others = [each for each in item.reads if each not in OFFERS and each.startswith("image/")]
    if others:
        read["types"] = cast(Json, others)
    has_past = any("timegate" in link.rel for link in resource.links)
    known = _OTHER_READS if has_past else _OTHER_READS - _PAST
    if names := [f"?{each.name}=" for each in item.query if each.name in known]:
        read["also"] = cast(Json, names)
    if item.has_value:
        read["wait"] = f"?until={_condition(value)}&timeout=60"
    return {"read": read}


def _condition(value: Json) -> str:
    """Return an example of a condition on a value."""
    path = list[str]()
    while isinstance(value, dict):
        name, value = next(((name, each) for name, each in value.items() if name != "header"), ("FIELD", None))
        path.append(name)
    place = ".".join(path) or "value"
    if isinstance(value, bool):
        return f"{place} = true"
    return f"{place} > 0" if isinstance(value, int | float) else f"{place} = 'TEXT'"


def _operation(method: str, form: Form | None, write: WriteMethod) -> dict[str, Json]:
    """Return one operation: what it does, how it ends, and its parameters."""
    title = form.title if isinstance(form, ValueForm | DeleteForm) else ""
    operation: dict[str, Json] = {"method": method}
    if does := write.note or title:
        operation["does"] = does
    if write.ends is not None:
        operation["ends"] = write.ends
    query = {each.name: _about(each, form) for each in write.query if each.name not in _UNMENTIONED}
    if query:
        operation["query"] = cast(Json, query)
    return operation


def _about(parameter: QueryParameter, form: Form | None) -> str:
    """Return the description of a parameter, with its maximum."""
    most = parameter.schema.get("maximum")
    if parameter.name == "rate" and isinstance(form, HoldForm):
        most = form.terms.max_rate
    return parameter.about if most is None else f"{parameter.about.rstrip('.')}, at most {most:g}."


def _refusal(exchange: Exchange, resource: Resource, item: PathItem, methods: frozenset[str]) -> Mapping[str, Json]:
    """Return why nothing can be written here, although such resources often can be."""
    usual = next((each for each in _WRITES if each in item.writes), None)
    if usual is None or methods & {*_WRITES}:
        return {}
    if resource.withheld:
        return {"refuses": "The robot is stopped."}
    about = [each for each in resource.deny_about if not exchange.permissions.may_read(each)]
    return {} if about or usual in resource.methods() else {"refuses": resource.deny_reason(usual)}


def _contents(resource: Resource, state: State | None) -> Mapping[str, Json]:
    """Return the parts of a complex resource, or the members of a container, by their offers."""
    if state is None:
        return {}
    if isinstance(state.view, ComplexView):
        writable = [each.affordance.url for each in state.view.members if each.affordance.write]
        invocable = [each.url for each in state.view.actions if each.request is not None]
        parts: dict[str, Sequence[str]] = {"PUT": writable, "POST": invocable, "GET": state.view.children}
        return {"offers": {method: [offer_url(url) for url in urls] for method, urls in parts.items() if urls}}
    if state.is_large or not resource.url.partition("?")[0].endswith("/"):
        return {}
    members = list[Json]()
    size = 0
    for triple in state.document.triples:
        if triple.predicate == ldp.contains:
            name = str(triple.object).strip("<>").removeprefix(resource.url)
            size += len(name) + 3
            if size > MAX_MEMBERS:
                return {"members": members, "more": f"{resource.url}?page=0"}
            members.append(name)
    return {"members": members} if members else {}


# Schemas


def compact(schema: JsonSchema) -> JsonSchema:
    """Return a shorter schema that accepts the same values or, if it is large, more: repeated objects are shared.

    Time stamps, defaults that are zero, empty or false, and the bounds of wide types are left out.
    """
    found: JsonSchema = {}
    for depth in _DEPTHS:
        found = _shared(cast(JsonSchema, _plain(schema, depth)))
        if len(orjson.dumps(found)) <= _MAX_INPUT:
            break
    return found


def _plain(schema: Json, depth: int) -> Json:
    if not isinstance(schema, dict):
        return schema
    alternatives = schema.get("oneOf")  # the others are spellings of special numbers and of elided arrays
    if isinstance(alternatives, list) and alternatives:
        return _plain(alternatives[0], depth)
    kept: dict[str, Json] = {}
    for name, value in schema.items():
        if name == "properties" and isinstance(value, dict):
            if depth > 0:
                kept[name] = {key: _plain(each, depth - 1) for key, each in value.items() if key != "stamp"}
        elif name == "items":
            kept[name] = _plain(value, depth)
        elif name not in ("unit", "x-unit") and not _is_usual(name, value):
            kept[name] = value
    return kept


def _is_usual(name: str, value: Json) -> bool:
    """Whether a keyword says nothing that its type does not."""
    if name == "default":
        return not value
    if name in ("minimum", "maximum"):
        return isinstance(value, int | float) and abs(value) >= _WIDE
    return name == "additionalProperties"


def _shared(schema: JsonSchema) -> JsonSchema:
    """Return the schema with each long part that occurs more than once in `$defs`."""
    counts: dict[bytes, int] = {}
    for each in _parts(schema):
        key = orjson.dumps(each)
        counts[key] = counts.get(key, 0) + 1
    names: dict[bytes, str] = {}
    definitions: dict[str, Json] = {}

    def shared(one: Json, *, is_root: bool = False) -> Json:
        if not isinstance(one, dict):
            return one
        key = orjson.dumps(one)
        written = {name: _each(name, value) for name, value in one.items()}
        if is_root or counts.get(key, 0) < 2 or len(key) < _SHORT:
            return written
        if key not in names:
            names[key] = f"d{len(names) + 1}"
            definitions[names[key]] = written
        return {"$ref": f"#/$defs/{names[key]}"}

    def _each(name: str, value: Json) -> Json:
        if name == "properties" and isinstance(value, dict):
            return {key: shared(each) for key, each in value.items()}
        return shared(value) if name == "items" else value

    whole = cast(JsonSchema, shared(schema, is_root=True))
    return {**whole, "$defs": definitions} if definitions else whole


def _parts(schema: Json) -> Iterator[Json]:
    """Yield a schema and those within it; what is within equal ones, once."""
    seen: set[bytes] = set()

    def parts(one: Json) -> Iterator[Json]:
        if not isinstance(one, dict):
            return
        yield one
        key = orjson.dumps(one)
        if key in seen:
            return
        seen.add(key)
        properties = one.get("properties")
        for each in properties.values() if isinstance(properties, dict) else ():
            yield from parts(each)
        yield from parts(one.get("items"))

    return parts(schema)


def _resolved(schema: JsonSchema, by_key: Mapping[str, JsonSchema]) -> JsonSchema:
    """Return a schema, or the one that it refers to."""
    reference = schema.get("$ref")
    return by_key.get(reference.rpartition("/")[2], {}) if isinstance(reference, str) else schema


def example(schema: JsonSchema) -> Json:
    """Return a value that a compact schema accepts: zeros as far as possible, and the identity as rotation."""
    definitions = cast("Mapping[str, Json]", schema.get("$defs", {}))
    return _example(schema, definitions)


def _example(schema: Json, definitions: Mapping[str, Json], name: str = "") -> Json:
    if not isinstance(schema, dict):
        return None
    if isinstance(reference := schema.get("$ref"), str):
        return _example(definitions[reference.rpartition("/")[2]], definitions, name)
    if isinstance(choices := schema.get("enum"), list) and choices:
        return choices[0]
    if isinstance(alternatives := schema.get("anyOf"), list) and alternatives:
        return _example(alternatives[0], definitions, name)
    if "default" in schema:
        return schema["default"]
    match schema.get("type"):
        case "object":
            properties = cast("Mapping[str, Json]", schema.get("properties", {}))
            if {*properties} == {"x", "y", "z", "w"}:
                return {"w": 1.0}
            made = {key: _example(each, definitions, key) for key, each in properties.items()}
            made = {key: each for key, each in made.items() if each not in ({}, [], "")}
            return made if any(made.values()) else dict(islice(made.items(), 1))
        case "array":
            least = schema.get("minItems", 0)
            return [_example(schema.get("items"), definitions)] * (least if isinstance(least, int) else 0)
        case "boolean":
            return True
        case "integer" | "number":
            least, most = schema.get("minimum", 0), schema.get("maximum", 0)
            if isinstance(least, int | float) and isinstance(most, int | float):
                return least if least > 0 else most if most < 0 else 0
            return 0
        case "string":
            return "map" if name == "frame_id" else ""
    return None
