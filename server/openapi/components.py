"""What many operations share: parameters, headers, answers, the schema of problem details."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from http import HTTPStatus

from rosld.adapters.model import Sent
from rosld.server.events.condition import MAX_LENGTH
from rosld.server.events.query_params import (
    DEFAULT_RATE,
    EVENT_STREAM,
    MAX_RATE,
    MAX_TIMEOUT,
    MIN_RATE,
)
from rosld.server.http.problem import AGENT_SAID, ROBOT_SAID
from rosld.server.hypermedia.data_schema import Json
from rosld.server.hypermedia.json_schema import ANYTHING, JSON_LD, TEXT, URI, JsonSchema
from rosld.server.rest.formats import HTML, JSON, OFFERS, RDF_BODIES
from rosld.server.rest.path_item import OF_EVERY_WRITE

PROBLEM = "application/problem+json"
_PROBLEM_SCHEMA: JsonSchema = {
    "type": "object",
    "description": "Problem details (RFC 9457).",
    "properties": {
        "type": {"type": "string"},
        "title": {"type": "string"},
        "status": {"type": "integer", "minimum": 100, "maximum": 599},
        "detail": {"type": "string", "description": "What is wrong, and the next step."},
        "violations": {
            "type": "array",
            "description": "What does not fit, field by field.",
            "items": {
                "type": "object",
                "properties": {
                    "path": {"type": "string"},
                    "message": {"type": "string"},
                    "value": {"type": ["string", "null"]},
                    "said": {"type": "string", "description": "The message of the shape that was broken: data."},
                },
                "required": ["path", "message"],
            },
        },
        "call": {"type": "string", "description": "The URL of the call that failed."},
        ROBOT_SAID: {"type": "string", "description": "What the robot said: data, no instructions."},
        AGENT_SAID: {"type": "string", "description": "What another agent said, as why it stopped the robot: data."},
        "sent": {"description": "Whether the robot may have received it.", "enum": [one.value for one in Sent]},
    },
    "required": ["type", "title", "status", "detail"],
}

_URLS: JsonSchema = {"type": "array", "items": URI}
_PLAN_SCHEMA: JsonSchema = {
    "type": "object",
    "description": "The plan of a dry run: nothing was done.",
    "properties": {
        "dryRun": {"const": True},
        "method": TEXT,
        "url": URI,
        "steps": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {
                    "does": TEXT,
                    "url": URI,
                    "receivers": {**_URLS, "description": "The nodes that it would reach, as the graph has them."},
                },
                "required": ["does", "url", "receivers"],
            },
        },
        "limits": {**_URLS, "description": "The resources and types whose limits were checked."},
        "conditions": {**_URLS, "description": "The conditions of mappings that were checked."},
        "status": {"type": ["integer", "null"], "description": "The status of the real answer, where it is known."},
    },
    "required": ["dryRun", "method", "url", "steps", "limits", "conditions", "status"],
}

HEADERS: Mapping[str, tuple[str, JsonSchema]] = {
    "ETag": ("The entity tag of this representation (RFC 9110 8.8.3).", TEXT),
    "Link": ("The types of the resource (LDP 4.2.1.4), what describes it, what constrains it (RFC 8288).", TEXT),
    "Allow": ("The methods that the resource answers now.", TEXT),
    "Accept-Put": ("The media types that PUT takes.", TEXT),
    "Accept-Post": ("The media types that POST takes (LDP 7.1).", TEXT),
    "Accept-Patch": ("The media types that PATCH takes (RFC 5789 3.1).", TEXT),
    "Location": ("The URL of the resource.", {"type": "string", "format": "uri-reference"}),
    "Content-Location": ("The URL of what the body represents.", {"type": "string", "format": "uri-reference"}),
    "Age": ("The age of the newest sample, in seconds.", {"type": "integer", "minimum": 0}),
    "Retry-After": ("Seconds after which to try again.", {"type": "integer", "minimum": 0}),
    "Preference-Applied": ("The preferences that were honoured (RFC 7240 3).", TEXT),
}
PARAMETERS: Mapping[str, Json] = {
    **{
        each.name: {"name": each.name, "in": "query", "description": each.about, "schema": each.schema}
        for each in OF_EVERY_WRITE
    },
    "after": {
        "name": "after",
        "in": "query",
        "description": "The ETag of a state: wait until the resource is in another, or `timeout` is over (304).",
        "schema": TEXT,
    },
    "shape": {
        "name": "shape",
        "in": "query",
        "description": "Where it is there, whatever its value: the SHACL shape of the RDF that may be written here.",
        "schema": TEXT,
        "allowEmptyValue": True,
    },
    "until": {
        "name": "until",
        "in": "query",
        "description": "A condition on the value, such as `data >= 300 and status = 'on'`: wait until it holds, or "
        "`timeout` is over (204). An event stream ends with it.",
        "schema": {"type": "string", "maxLength": MAX_LENGTH},
    },
    "timeout": {
        "name": "timeout",
        "in": "query",
        "description": f"With `after` and `until`: the most seconds to wait; more than {MAX_TIMEOUT:g} are "
        f"{MAX_TIMEOUT:g}.",
        "schema": {"type": "number", "minimum": 0},
    },
    "rate": {
        "name": "rate",
        "in": "query",
        "description": f"Of an event stream: the most events a second, up to {MAX_RATE:g}; {DEFAULT_RATE:g} where it "
        "is missing. A comment `: skipped N` before an event tells how many messages were left out.",
        "schema": {"type": "number", "minimum": MIN_RATE},
    },
    "If-None-Match": {
        "name": "If-None-Match",
        "in": "header",
        "description": "ETags, or `*` (RFC 9110 13.1.2).",
        "schema": TEXT,
        "example": "*",
    },
    "If-Match": {
        "name": "If-Match",
        "in": "header",
        "description": "ETags of the state that is to be changed, or `*` (RFC 9110 13.1.1).",
        "schema": TEXT,
        "example": "*",
    },
    "page": {
        "name": "page",
        "in": "query",
        "description": "One of the pages that a large container comes in: follow the links from `?page=0`.",
        "schema": TEXT,
        "example": "0",
    },
    "Prefer.container": {
        "name": "Prefer",
        "in": "header",
        "description": "`return=representation`, with `max-member-count` for pages of so many members (LDP Paging), "
        "and with `include` or `omit` of what a container tells (LDP 7.2).",
        "schema": TEXT,
        "example": "return=representation; max-member-count=100",
    },
    "Prefer": {
        "name": "Prefer",
        "in": "header",
        "description": "`return=representation` or `return=minimal` (RFC 7240 4.2).",
        "schema": TEXT,
        "example": "return=minimal",
    },
}
_WORDS = {
    303: "What was asked for is shown elsewhere.",
    304: "It has not changed.",
    308: "It is at the URL in Location.",
    400: "The request, or its body, cannot be read.",
    404: "There is nothing here now.",
    405: "The resource does not answer this method now; Allow says which it answers.",
    406: "It cannot be had in a form that the request accepts.",
    409: "The request does not go with the state of the resource.",
    410: "It was here and is no more.",
    412: "A precondition does not hold.",
    413: "The body is too large.",
    415: "The body is of a media type, a coding or a charset that is not read here.",
    422: "The body is well-formed and does not fit; the violations say where.",
    423: "The robot is stopped: nothing is written to it.",
    426: "It is received by WebSocket.",
    428: "The request must state with If-Match what it changes.",
    429: "Too many requests, or too fast.",
    502: "The robot's answer cannot be read.",
    503: "The robot is not there, or everything is busy; try again later.",
    507: "There is no room for it.",
    504: "The robot did not answer in time; the outcome is not known.",
}
_TOLD: Mapping[int, tuple[str, ...]] = {
    303: ("Location",), 304: ("ETag",), 308: ("Location",), 405: ("Allow",), 409: ("Link",), 412: ("ETag",),
    415: ("Accept-Put", "Accept-Post", "Accept-Patch"), 422: ("Link",), 429: ("Retry-After",), 503: ("Retry-After",),
}  # fmt: skip
_EMPTY = frozenset({303, 304})
_CERTAIN = {(405, "Allow"), (308, "Location"), (303, "Location")}
READING = (304, 308, 400, 404, 406, 412, 502, 503, 504)
WRITING = (308, 400, 404, 405, 406, 409, 412, 413, 415, 422, 423, 428, 429, 502, 503, 504)
"""Statuses of refusals and failures: of GET and HEAD, of what writes. Some resources have more (`PathItem.also`)."""
ANY = (403, 408, 421, 429, 431, 500)
"""What any request may meet, before it comes to the resource or because the server fails: `default`."""
_STANDING = ("ETag", "Link", "Allow", "Accept-Put", "Accept-Post", "Accept-Patch")
_FURTHER = (303, 410, 426, 507)


def reference(kind: str, name: str) -> dict[str, Json]:
    """A reference to a component."""
    return {"$ref": f"#/components/{kind}/{name}"}


def refusals(statuses: Iterable[int], *, body: bool = True) -> dict[str, Json]:
    """The answers that refuse, by status; without `body` those to HEAD."""
    found: dict[str, Json] = {
        str(status): reference("responses", f"{status}" if body else f"{status}.head") for status in sorted({*statuses})
    }
    return {**found, "default": reference("responses", "default")}


def document() -> dict[str, Json]:
    """The answer with a resource that is RDF in every syntax, and nothing else."""
    return reference("responses", "document")


def representation(media_types: Iterable[str], plain: JsonSchema | None) -> dict[str, Json]:
    """The answer with a resource in these media types; `plain` as for `content`."""
    return {"description": "OK.", "headers": headers(*_STANDING, "Age"), "content": content(media_types, plain)}


def headers(*names: str, certain: Iterable[str] = ()) -> dict[str, Json]:
    """Header fields of an answer; those that are `certain` are in each."""
    sure = frozenset(certain)
    found: dict[str, Json] = {}
    for name in names:
        about, schema = HEADERS[name]
        found[name] = (
            {"description": about, "required": True, "schema": schema} if name in sure else reference("headers", name)
        )
    return found


def content(media_types: Iterable[str], plain: JsonSchema | None = None) -> dict[str, Json]:
    """The content of a body; `plain` is the schema of `application/json`, which is JSON-LD where there is none."""
    return {media_type: {"schema": schema_of(media_type, plain)} for media_type in media_types}


def or_plan(content: dict[str, Json]) -> dict[str, Json]:
    """The content of the answer to a write that is 200, or the plan of a dry run."""
    plan = reference("schemas", "DryRun")
    shown = content.get(JSON)
    either: Json = {"schema": {"anyOf": [shown["schema"], plan]} if isinstance(shown, dict) else plan}
    return {**content, JSON: either}


def schema_of(media_type: str, plain: JsonSchema | None = None) -> JsonSchema:
    """The schema of a body of a media type: text is one string."""
    if media_type == "application/json":
        return JSON_LD if plain is None else plain
    if media_type in ("application/ld+json", "application/td+json"):
        return JSON_LD
    if media_type in ("application/merge-patch+json", "application/sparql-results+json"):
        return ANYTHING if plain is None else plain
    if media_type.startswith("text/") or media_type in _TEXTS:
        return TEXT
    return ANYTHING


_TEXTS = frozenset(
    {
        "application/n-triples", "application/n-quads", "application/trig", "application/rdf+xml",
        "application/sparql-query", "application/sparql-update", "application/sparql-results+xml", "application/xml",
        "image/svg+xml",
    }
)  # fmt: skip


def components(schemas: Mapping[str, JsonSchema]) -> dict[str, Json]:
    """The Components Object (OpenAPI 3.1.1, 4.8.7)."""
    told: Json = content((*RDF_BODIES, HTML)) | {PROBLEM: {"schema": reference("schemas", "Problem")}}
    answers: dict[str, Json] = {
        "document": representation((*OFFERS, EVENT_STREAM), None),
        "head": {"description": "OK.", "headers": headers(*_STANDING, "Age")},
        "options": {"description": "What may be done.", "headers": headers(*_STANDING[1:], certain=["Allow"])},
        "204": {
            "description": "No Content. It was done.",
            "headers": headers("Link", "Content-Location", "Preference-Applied"),
        },
        "dry-run": {
            "description": "OK. The plan of a dry run: nothing was done.",
            "content": {"application/json": {"schema": reference("schemas", "DryRun")}},
        },
        "unmet": {
            "description": "No Content. The time is over, and what `until` says does not hold.",
            "headers": headers("ETag", "Link", "Allow", "Content-Location"),
        },
        "202": {
            "description": "Accepted. It was published, but no subscriber was there to get it.",
            "content": told,
        },
        "default": {
            "description": f"What any request may meet: {', '.join(map(str, ANY))}.",
            "content": told,
        },
    }
    for status in sorted({*READING, *WRITING, *_FURTHER}):
        bare: dict[str, Json] = {"description": f"{HTTPStatus(status).phrase}. {_WORDS[status]}"}
        names = _TOLD.get(status, ())
        if names:
            bare["headers"] = headers(*names, certain=[name for name in names if (status, name) in _CERTAIN])
        answers[f"{status}.head"] = bare
        answers[str(status)] = bare if status in _EMPTY else {**bare, "content": told}
    return {
        "schemas": {"Problem": _PROBLEM_SCHEMA, "DryRun": _PLAN_SCHEMA, **dict(sorted(schemas.items()))},
        "responses": answers,
        "parameters": dict(PARAMETERS),
        "headers": {name: {"description": about, "schema": schema} for name, (about, schema) in HEADERS.items()},
    }
