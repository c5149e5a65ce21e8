"""Problems: every refusal and failure that the web sees (RFC 9457), negotiated like any other representation.

`Problem` is raised; `render` turns it into a status, headers and a body. A body says what the client sent and what to
do next, and never how the server is made: no traceback, no path of a file, no class.
"""

from __future__ import annotations

import html
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import TYPE_CHECKING

import orjson
from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, Triple, serialize
from starlette.responses import Response

from rosld.server.http import field, negotiation

if TYPE_CHECKING:
    from rosld.ontology.lower import Violation

JSON = "application/problem+json"
_SYNTAXES: Mapping[str, RdfFormat] = {
    "text/turtle": RdfFormat.TURTLE,
    "application/ld+json": RdfFormat.JSON_LD,
    "application/n-triples": RdfFormat.N_TRIPLES,
    "application/rdf+xml": RdfFormat.RDF_XML,
}
_OFFERS = (JSON, "application/json", "text/html", *_SYNTAXES)
_HYDRA = "http://www.w3.org/ns/hydra/core#"
_SH = "http://www.w3.org/ns/shacl#"
_RDF_TYPE = NamedNode("http://www.w3.org/1999/02/22-rdf-syntax-ns#type")
_LONGEST = 2000
"""Characters of a value that are told back to whoever sent it."""


class Problem(Exception):
    """Ends a request with a status of 400 or more.

    `detail` names the value and the next step; `title` is the status's phrase where none is given; `headers` go into
    the response; `extra` holds further members (RFC 9457 3.2); `violations` say field by field what does not fit.
    """

    def __init__(
        self,
        status: int,
        detail: str,
        *,
        title: str | None = None,
        type: str = "about:blank",
        headers: Mapping[str, str] = {},
        extra: Mapping[str, object] = {},
        violations: Sequence[Violation] = (),
    ) -> None:
        super().__init__(f"{status} {detail}")
        self.status = status
        self.detail = detail
        self.title = title or phrase(status)
        self.type = type
        self.headers = dict(headers)
        self.extra = dict(extra)
        self.violations = tuple(violations)


@dataclass(frozen=True, slots=True)
class Rendered:
    """A problem ready to be sent."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    def response(self, *, head: bool = False) -> Response:
        """The Starlette response; `head` leaves the body out and its length in."""
        headers = {**self.headers, "content-length": str(len(self.body))}
        return Response(b"" if head else self.body, self.status, headers)


def phrase(status: int) -> str:
    """The reason phrase of a status, such as "Not Found"."""
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return f"Status {status}"


def render(problem: Problem, accept: str | None = None) -> Rendered:
    """The problem in the form the client prefers: problem+json by default and whenever nothing else is acceptable.

    Headers that could not be sent safely are left out, so that a hostile name can never turn a refusal into a failure.
    """
    chosen = negotiation.choose(accept, _OFFERS) or JSON
    if chosen in _SYNTAXES:
        body = _rdf(problem, _SYNTAXES[chosen])
    elif chosen == "text/html":
        body = _page(problem).encode("utf-8", "replace")
    else:
        chosen, body = JSON, _json(problem)
    headers = {name.lower(): value for name, value in problem.headers.items() if _sendable(name, value)}
    content_type = f"{chosen}; charset=utf-8" if chosen.startswith("text/") else chosen
    return Rendered(
        problem.status,
        {
            **headers,
            "content-type": content_type,
            "vary": "Accept",
            "cache-control": "no-store",
            "x-content-type-options": "nosniff",
            "content-security-policy": "default-src 'none'; style-src 'unsafe-inline'",
        },
        body,
    )


def members(problem: Problem) -> dict[str, object]:
    """The problem details object (RFC 9457 3)."""
    found: dict[str, object] = {
        **{name: value for name, value in problem.extra.items() if name not in ("type", "title", "status", "detail")},
        "type": problem.type,
        "title": problem.title,
        "status": problem.status,
        "detail": _clean(problem.detail),
    }
    if problem.violations:
        found["violations"] = [_members_of(violation) for violation in problem.violations]
    return found


def _members_of(violation: Violation) -> dict[str, str | None]:
    value = None if violation.value is None else _clean(violation.value)
    return {"path": _clean(violation.path), "message": _clean(violation.message), "value": value}


def _json(problem: Problem) -> bytes:
    found = members(problem)
    try:
        return orjson.dumps(found, default=str, option=orjson.OPT_INDENT_2)
    except TypeError:  # a lone surrogate, or an integer beyond 64 bits
        return json.dumps(found, default=str, indent=2).encode("ascii")


def triples(problem: Problem) -> Iterator[Triple]:
    """The problem as a hydra:Error and, where fields do not fit, a sh:ValidationReport."""
    node = BlankNode()
    yield Triple(node, _RDF_TYPE, NamedNode(f"{_HYDRA}Error"))
    yield Triple(node, NamedNode(f"{_HYDRA}statusCode"), Literal(problem.status))
    yield Triple(node, NamedNode(f"{_HYDRA}title"), Literal(_clean(problem.title)))
    yield Triple(node, NamedNode(f"{_HYDRA}description"), Literal(_clean(problem.detail)))
    if problem.violations:
        yield from _report(problem.violations)


def _report(violations: Sequence[Violation]) -> Iterator[Triple]:
    report = BlankNode()
    yield Triple(report, _RDF_TYPE, NamedNode(f"{_SH}ValidationReport"))
    yield Triple(report, NamedNode(f"{_SH}conforms"), Literal(False))
    for violation in violations:
        result = BlankNode()
        yield Triple(report, NamedNode(f"{_SH}result"), result)
        yield Triple(result, _RDF_TYPE, NamedNode(f"{_SH}ValidationResult"))
        yield Triple(result, NamedNode(f"{_SH}resultSeverity"), NamedNode(f"{_SH}Violation"))
        yield Triple(
            result, NamedNode(f"{_SH}resultMessage"), Literal(_clean(f"{violation.path}: {violation.message}"))
        )
        if violation.value is not None:
            yield Triple(result, NamedNode(f"{_SH}value"), Literal(_clean(violation.value)))


def _rdf(problem: Problem, syntax: RdfFormat) -> bytes:
    prefixes = {"hydra": _HYDRA, "sh": _SH}
    written = serialize(triples(problem), format=syntax, prefixes=prefixes)
    assert written is not None
    return written


def _page(problem: Problem) -> str:
    title = html.escape(f"{problem.status} {problem.title}")
    rows = "".join(
        f"<tr><td><code>{html.escape(_clean(one.path))}</code></td><td>{html.escape(_clean(one.message))}</td></tr>"
        for one in problem.violations
    )
    table = f"<table><tr><th>Field</th><th>What does not fit</th></tr>{rows}</table>" if rows else ""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>body{{font:1rem/1.5 system-ui,sans-serif;max-width:45rem;margin:3rem auto;"
        "padding:0 1rem;color-scheme:light dark}td,th{text-align:left;padding:.2rem 1rem .2rem 0}</style></head>"
        f"<body><h1>{title}</h1><p>{html.escape(_clean(problem.detail))}</p>{table}"
        '<p><a href="/">To the start</a></p></body></html>'
    )


def _clean(text: str) -> str:
    """Text that every form can carry: no control characters, no lone surrogates, not endless."""
    shown = text if len(text) <= _LONGEST else text[:_LONGEST] + "..."
    return "".join(char if char.isprintable() or char == "\n" else "\N{REPLACEMENT CHARACTER}" for char in shown)


def _sendable(name: str, value: str) -> bool:
    try:
        field.safe(value)
    except ValueError:
        return False
    return field.is_token(name)
