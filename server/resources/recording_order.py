"""Orders of recordings in bodies, and their form on the page `/bags/`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import cast

import orjson
from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import MessageSchema
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.body import MEDIA_TYPES as RDF_TYPES
from rosld.ontology.body import RdfBody, Subject, parse_body
from rosld.ontology.vocab import ros
from rosld.server.history.recording_orders import RecordingOrder, Trigger
from rosld.server.html.forms import NameChoices, ValueForm
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import TEXT, JsonSchema, json_object
from rosld.server.rest.formats import JSON
from rosld.shapes.value import MessageShape

_FIELDS = """string name
float64 duration
string topics
float64 before
string trigger_resource
string trigger_condition
uint8 trigger_limit
string of
string from
string to
string around
float64 after
"""
_OF_CUTS = ("of", "from", "to", "around", "after")
_FOLDED = frozenset({"topics", "before", "trigger_resource", "trigger_condition", "trigger_limit", *_OF_CUTS})
_ABOUT_CUTS = (
    "Of: the recording to cut. From and to: a date, seconds after its start (60), or before its end (-60). Around: an "
    "event instead, or several: a time, a condition such as battery_state.percentage < 0.2, or a SPARQL query for "
    "times; before and after are the seconds around each."
)
_ABOUT = (
    "Topics: the ones you tick, or all if you tick none. Duration: seconds, or 0 until you end it. More: globs of "
    "topics separated by spaces, such as /odom /camera/*; seconds from the history before; a condition such as "
    "percentage < 0.2 on the value at a URL, which starts the recording when it becomes true. To cut a stored "
    f"recording instead: {_ABOUT_CUTS[0].lower()}{_ABOUT_CUTS[1:]}"
)


@cache
def _schema() -> MessageSchema:
    return TypeLibrary(ros_version=2, folders=()).learn_message("rosld/msg/Recording", _FIELDS)


def recording_form(topics: Mapping[str, str], *, only_cuts: bool) -> ValueForm:
    """Return the form for orders, or for cuts only; `topics` maps the current topics to their URLs."""
    schema = _schema()
    fields = [
        each for each in schema.type.fields if not only_cuts or each.name in (*_OF_CUTS, "name", "topics", "before")
    ]
    verb = "Cut" if only_cuts else "Record"
    return ValueForm(
        MessageShape(schema, tuple(fields)),
        method="POST",
        title=verb,
        button=verb,
        value={"before": 5, "after": 5} if only_cuts else {"trigger_limit": 1},
        about=_ABOUT_CUTS if only_cuts else _ABOUT,
        choices=NameChoices("topics", "Topics", topics),
        folded=frozenset({"topics"}) if only_cuts else _FOLDED,
    )


def order_of_form(members: Mapping[str, object]) -> dict[str, object]:
    """Return the order in a form; empty inputs are omitted."""
    if members.get("of"):
        found = {key: members[key] for key in (*_OF_CUTS, "name", "before") if members.get(key)}
        return found | ({"topics": str(members["topics"]).split()} if members.get("topics") else {})
    found = {key: members[key] for key in ("name", "before", "duration") if members.get(key)}
    found["topics"] = str(members.get("topics", "")).split() or ["*"]
    if members.get("trigger_condition") or members.get("trigger_resource"):
        limit = members.get("trigger_limit") or 1
        trigger: dict[str, object] = {"condition": members.get("trigger_condition"), "limit": limit}
        resource = members.get("trigger_resource")
        found["trigger"] = {**trigger, "resource": resource} if resource else trigger
    return found


MEDIA_TYPES = (JSON, *RDF_TYPES)
MAX_TOPICS = 1000
_MAX_NAME = 1000
_MAX_SECONDS = 30 * 86400.0
MAX_TRIGGERED = 100
_SECONDS: JsonSchema = {"type": "number", "minimum": 0, "maximum": _MAX_SECONDS}
_TRIGGER: JsonSchema = {
    "type": "object",
    "description": "It starts when a condition becomes true.",
    "properties": {
        "resource": {**TEXT, "description": "The URL of the value to watch."},
        "condition": {**TEXT, "description": "A condition as in ?until=, or the IRI of a mapping's condition."},
        "limit": {
            "type": "integer",
            "minimum": 1,
            "maximum": MAX_TRIGGERED,
            "description": "The number of recordings that it may start, one after another. Default: 1.",
        },
    },
    "required": ["condition"],
}
_TIME = "seconds after the start of that recording, or before its end (-60)"
SCHEMA: JsonSchema = json_object(
    optional={
        "topics": {
            "type": "array",
            "items": TEXT,
            "minItems": 1,
            "description": "Names of topics, or globs such as /camera/*.",
        },
        "name": {**TEXT, "description": "The name, for /bags/NAME/; default: the start time."},
        "before": {**_SECONDS, "description": "Seconds of the history to include at the start."},
        "duration": {**_SECONDS, "description": "Seconds after which it ends; otherwise it ends by PATCH."},
        "trigger": _TRIGGER,
        "of": {**TEXT, "description": "The name of the recording to cut."},
        "from": {"type": ["string", "number"], "description": f"The first time of a cut: xsd:dateTime, {_TIME}."},
        "to": {"type": ["string", "number"], "description": "The last time of a cut, in the same form."},
        "around": {
            "anyOf": [TEXT, {"type": "array", "items": TEXT}],
            "description": "Cuts around events: a time, a condition such as battery_state.percentage < 0.2, or a "
            "SPARQL query whose results have times; one recording (NAME-1, NAME-2 ...) each.",
        },
        "after": {**_SECONDS, "description": "Seconds after an event; those before it are `before`. Default: 5."},
    },
) | {"anyOf": [{"required": ["topics"]}, {"required": ["of"]}]}


def read_members(data: bytes, media_type: str, url: str, *, is_form: bool = False) -> Mapping[str, object]:
    """Return the members of an order in a body that was sent to `url`. Raises BodyError, and 400 and 422 Problems."""
    members = _of_json(data) if media_type == JSON else _of_rdf(parse_body(data, media_type, url))
    return order_of_form(members) if is_form else members


def order_of(members: Mapping[str, object]) -> RecordingOrder:
    """Return the order with these members. Raises a 422 Problem that names the invalid member."""
    unknown = members.keys() - {"name", "topics", "before", "duration", "trigger"}
    if unknown:
        known = "name, topics, before, duration, trigger"
        raise Problem(422, f"{', '.join(sorted(unknown))[:200]} is unknown; choose from {known}.")
    name = members.get("name")
    if name is not None and not isinstance(name, str):
        raise Problem(422, f"name is {str(name)[:100]!r}, not a string.")
    before = read_seconds(members, "before")
    duration, trigger = read_seconds(members, "duration"), _trigger(members.get("trigger"))
    if trigger is not None and trigger.limit > 1 and duration is None:
        raise Problem(422, "A recording that a trigger starts repeatedly needs a duration.")
    return RecordingOrder(_topics(members.get("topics")), name, before or 0.0, duration, trigger)


def _of_json(data: bytes) -> dict[str, object]:
    try:
        members: object = orjson.loads(data)
    except orjson.JSONDecodeError as error:
        raise Problem(400, f"The body is not JSON: {error}.") from error
    if not isinstance(members, dict):
        raise Problem(422, 'A recording order must be an object such as {"topics": ["/odom"], "duration": 10}.')
    return cast("dict[str, object]", members)


def _of_rdf(body: RdfBody) -> dict[str, object]:
    found = [subject for subject, members in body.subjects.items() if ros.recordsTopic in members]
    if len(found) != 1:
        raise Problem(422, f"Exactly one node must have ros:recordsTopic, not {len(found)}.")
    (subject,) = found
    topics = [one.value for one in body.objects(subject, ros.recordsTopic) if isinstance(one, Literal)]
    terms = {"name": ros.name, "before": ros.secondsBefore, "duration": ros.secondsLong}
    members = {key: _literal(body, subject, term) for key, term in terms.items()}
    numbers = {key: _number(key, members[key]) for key in ("before", "duration")}
    given = {"name": members["name"], **numbers, "trigger": _trigger_of_rdf(body, subject)}
    return {"topics": topics, **{key: value for key, value in given.items() if value is not None}}


def _trigger(value: object) -> Trigger | None:
    if value is None:
        return None
    if not isinstance(value, dict) or value.keys() - {"resource", "condition", "limit"}:
        raise Problem(422, 'trigger must be an object such as {"resource": "/topics/odom", "condition": "x > 1"}.')
    condition, resource, limit = value.get("condition"), value.get("resource"), value.get("limit", 1)
    if not isinstance(condition, str) or not condition or not isinstance(resource, str | None):
        raise Problem(422, "trigger needs a condition, a string, and a resource, the URL that it is about.")
    if not isinstance(limit, int) or isinstance(limit, bool) or not 1 <= limit <= MAX_TRIGGERED:
        raise Problem(422, f"limit must be from 1 to {MAX_TRIGGERED} recordings, not {str(limit)[:50]}.")
    return Trigger(condition, resource, limit)


def _trigger_of_rdf(body: RdfBody, subject: Subject) -> dict[str, object] | None:
    condition, limit = _literal(body, subject, ros.triggerCondition), _literal(body, subject, ros.triggerLimit)
    named = [each.value for each in body.objects(subject, ros.triggerResource) if isinstance(each, NamedNode)]
    shapes = [each.value for each in body.objects(subject, ros.triggerShape) if isinstance(each, NamedNode)]
    if condition is None and not shapes:
        return None
    found: dict[str, object] = {"condition": condition or shapes[0]}
    if limit is not None:
        found["limit"] = int(limit) if limit.isascii() and limit.isdecimal() and len(limit) < 9 else limit
    return found | ({"resource": named[0]} if named else {})


def _literal(body: RdfBody, subject: Subject, term: NamedNode) -> str | None:
    found = body.objects(subject, term)
    if len(found) > 1 or not all(isinstance(one, Literal) for one in found):
        raise Problem(422, f"{term.value} must be one literal.")
    return cast("Literal", found[0]).value if found else None


def _number(key: str, value: str | None) -> float | None:
    if value is None:
        return None
    try:
        return float(value)
    except ValueError as error:
        raise Problem(422, f"{key} is {value[:100]!r}, not a number of seconds.") from error


def _topics(value: object) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(one, str) for one in value):
        raise Problem(422, 'topics must be a list of names or globs, such as ["/odom", "/camera/*"].')
    topics = tuple(dict.fromkeys(cast("list[str]", value)))
    if len(topics) > MAX_TOPICS:
        raise Problem(422, f"{len(topics)} topics exceed the limit of {MAX_TOPICS}: use globs.")
    for one in topics:
        if not one.startswith(("/", "*")) or len(one) > _MAX_NAME:
            raise Problem(422, f"{one[:100]!r} is not a topic name or glob: it must begin with a slash or a star.")
    return topics


def read_seconds(members: Mapping[str, object], key: str) -> float | None:
    """Return the number of seconds of a member, or None without it. Raises a 422 Problem."""
    value = members.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise Problem(422, f"{key} is {str(value)[:100]!r}, not a number of seconds.")
    if not 0 <= value <= _MAX_SECONDS:
        raise Problem(422, f"{key} must be from 0 to {_MAX_SECONDS:.0f} s, not {value:g} s.")
    return float(value)
