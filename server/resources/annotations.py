"""Tags and events of recordings in patches: JSON merge patches, and patches of the RDF of a recording."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from functools import cache
from typing import NamedTuple

import orjson
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.catalogue import Event
from rosld.adapters.model import MessageSchema
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.literals import date_time, date_time_nanoseconds
from rosld.ontology.vocab import dcat, prov, rdf, rdfs, ros
from rosld.server.html.forms import ValueForm
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import TEXT, JsonSchema, json_object
from rosld.server.patches.patch import merge_patch
from rosld.server.patches.single_change import patched
from rosld.server.resources.memento import read_time
from rosld.server.rest.formats import SPARQL_UPDATE
from rosld.shapes.value import MessageShape

_TIME: JsonSchema = {"type": "string", "format": "date-time"}
_EVENT = json_object({"name": TEXT}, {"at": _TIME, "from": _TIME, "to": _TIME})
ANNOTATIONS: JsonSchema = json_object(
    {}, {"tags": {"type": "array", "items": TEXT}, "events": {"type": "array", "items": _EVENT}}
)
_LONGEST = 200
_MOST = 10_000
_WORDS = 'A recording takes tags and events: send {"tags": ["rain"], "events": [{"name": "fault", "at": TIME}]}'
_RDF_WORDS = (
    "Of a recording, only tags (dcat:keyword) and events (ros:hasEvent, each a ros:RecordedEvent with rdfs:label, "
    "prov:startedAtTime and prov:endedAtTime) can be changed."
)


_FIELDS = "string tags\nstring event\nstring at\nstring until\n"
_ABOUT = (
    "Tags: words with commas between them. Event: the name of one to add, with its time, such as "
    "2030-01-31T12:00:00Z, and its end if it is a span."
)


@cache
def _form_schema() -> MessageSchema:
    return TypeLibrary(ros_version=2, folders=()).learn_message("rosld/msg/Annotations", _FIELDS)


class Annotations(NamedTuple):
    """Tags and events of a recording."""

    tags: Sequence[str]
    events: Sequence[Event]


def read_patch(data: bytes, media_type: str, url: str, triples: Iterable[Triple], before: Annotations) -> Annotations:
    """Return the annotations of the recording at `url`, with these `triples`, after a patch.

    Raises Problems: 400 for an unreadable patch, 409 for an N3 patch that does not match, 422 for any other change.
    """
    if media_type in (SPARQL_UPDATE, "text/n3"):
        return _of_rdf(*patched(data, media_type, url, triples), NamedNode(url))
    try:
        patch: object = orjson.loads(data)
    except orjson.JSONDecodeError as error:
        raise Problem(400, f"The body is not JSON: {error}.") from error
    events = [_json_event(each) for each in before.events]
    merged = merge_patch({"tags": list(before.tags), "events": events}, patch)
    if not isinstance(merged, dict) or merged.keys() - {"tags", "events"}:
        raise Problem(422, f"{_WORDS}.")
    tags, found = merged.get("tags", []), merged.get("events", [])
    if not isinstance(tags, list) or not isinstance(found, list):
        raise Problem(422, f"{_WORDS}.")
    return _checked([_tag(each) for each in tags], [_event_of_json(each) for each in found])


def annotations_form(tags: Sequence[str]) -> ValueForm:
    """Return the form for the tags of a recording, and for an event to add."""
    schema = _form_schema()
    return ValueForm(
        MessageShape(schema, schema.type.fields),
        method="PATCH",
        title="Tags and events",
        button="Save",
        value={"tags": ", ".join(tags)},
        about=_ABOUT,
        folded=frozenset({"event", "at", "until"}),
    )


def patch_of_form(data: bytes, before: Annotations) -> bytes:
    """Return the merge patch that a submitted form stands for."""
    members = {name: str(value).strip() for name, value in orjson.loads(data).items()}
    patch: dict[str, object] = {"tags": [each for each in map(str.strip, members.get("tags", "").split(",")) if each]}
    if members.get("event"):
        at, until = members.get("at", ""), members.get("until", "")
        times = {"from": at, "to": until} if until else {"at": at}
        patch["events"] = [*map(_json_event, before.events), {"name": members["event"], **times}]
    return orjson.dumps(patch)


def _json_event(event: Event) -> dict[str, str]:
    if event.end_ns is None:
        return {"name": event.name, "at": date_time(0, event.start_ns)}
    return {"name": event.name, "from": date_time(0, event.start_ns), "to": date_time(0, event.end_ns)}


def _event_of_json(value: object) -> Event:
    if not isinstance(value, dict) or value.keys() not in ({"name", "at"}, {"name", "from", "to"}):
        raise Problem(422, f"{_WORDS}, or with from and to for a span.")
    name = _text("name", value["name"])
    times = [read_time(_text(key, value[key]), 0) for key in ("at", "from", "to") if key in value]
    return _event(name, times[0], times[-1])


def _of_rdf(before: set[Triple], after: set[Triple], url: NamedNode) -> Annotations:
    events = {each.object for each in after if each.subject == url and each.predicate == ros.hasEvent}
    former = {each.object for each in before if each.subject == url and each.predicate == ros.hasEvent}
    if {each for each in before if not _is_own(each, url, former)} != {
        each for each in after if not _is_own(each, url, events)
    }:
        raise Problem(422, _RDF_WORDS)
    tags = [_tag(each.object.value) for each in after if _is_tag(each, url) and isinstance(each.object, Literal)]
    return _checked(sorted(tags), [_event_of_rdf(after, node) for node in events])


def _is_tag(triple: Triple, url: NamedNode) -> bool:
    is_topic = isinstance(triple.object, Literal) and triple.object.value.startswith("/")
    return triple.subject == url and triple.predicate == dcat.keyword and not is_topic


def _is_own(triple: Triple, url: NamedNode, events: Collection[object]) -> bool:
    """Whether a triple is about a tag or an event."""
    is_link = triple.subject == url and triple.predicate == ros.hasEvent
    return is_link or triple.subject in events or _is_tag(triple, url)


def _event_of_rdf(triples: Iterable[Triple], node: object) -> Event:
    found = [each for each in triples if each.subject == node]
    values = {each.predicate: each.object for each in found if each.predicate != rdf.type}
    kinds = {each.object for each in found if each.predicate == rdf.type}
    names = {rdfs.label, prov.startedAtTime, prov.endedAtTime}
    if kinds - {ros.RecordedEvent, prov.Activity} or values.keys() - names or len(values) + len(kinds) != len(found):
        raise Problem(422, _RDF_WORDS)
    label, start = values.get(rdfs.label), _time(values.get(prov.startedAtTime))
    end = _time(values[prov.endedAtTime]) if prov.endedAtTime in values else start
    return _event(_text("rdfs:label", label.value if isinstance(label, Literal) else None), start, end)


def _time(term: object) -> int:
    found = date_time_nanoseconds(term.value) if isinstance(term, Literal) else None
    if found is None:
        raise Problem(422, "prov:startedAtTime and prov:endedAtTime must be of type xsd:dateTime.")
    return found


def _event(name: str, start: int, end: int) -> Event:
    if end < start or not 0 <= start <= end < 1 << 63:
        raise Problem(422, f"The event {name} ends before it begins, or before 1970.")
    return Event(name, start, None if end == start else end)


def _tag(value: object) -> str:
    tag = _text("A tag", value)
    if tag.startswith(("/", "*")):
        raise Problem(422, f"The tag {tag} must not begin with / or *, as names of topics do.")
    return tag


def _text(what: str, value: object) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST or not value.isprintable():
        raise Problem(
            422, f"{what} must be a string of 1 to {_LONGEST} printable characters, not {str(value)[:100]!r}."
        )
    return value


def _checked(tags: Sequence[str], events: Sequence[Event]) -> Annotations:
    if len(tags) > _MOST or len(events) > _MOST:
        raise Problem(422, f"A recording has at most {_MOST} tags and events.")
    return Annotations(tags, events)
