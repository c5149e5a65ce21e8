"""Problem details (RFC 9457): problems as responses, negotiated like any other representation."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence

import orjson
from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode
from starlette.responses import Response

from rosld.ontology.document import Document
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.triples import Statement, boolean, integer, statements, text, triples_about
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import rdf, rdfs, ros, sh
from rosld.server.http.fields import is_token, require_field_value
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import AGENT_SAID, ROBOT_SAID, Problem


def validation_report(url: str, violations: Sequence[Violation]) -> Document:
    """Return the validation report of a body sent to `url`: one result per violation.

    A violation of a shape has that shape, its constraint, focus node, path and value; any other concerns the node of
    the message. The path of a field is also given as text (`linear.x`), because it may lead through several nodes.
    """
    report = NamedNode(f"{url}#report")
    results = [NamedNode(f"{url}#result.{number}") for number in range(len(violations))]
    triples = triples_about(
        report, (rdf.type, sh.ValidationReport), (sh.conforms, boolean(not violations)), *statements(sh.result, results)
    )
    for result, violation in zip(results, violations, strict=True):
        triples += triples_about(
            result,
            (rdf.type, sh.ValidationResult),
            (sh.resultSeverity, violation.severity or sh.Violation),
            (sh.focusNode, violation.focus or NamedNode(f"{url}#message")),
            (ros.fieldPath, text(violation.path) if violation.path else None),
            (sh.resultMessage, text(violation.quote or violation.message)),
            *_source(violation),
        )
    return Document(url, tuple(triples))


def _source(violation: Violation) -> tuple[Statement, ...]:
    """Return the statements about the broken constraint."""
    return (
        (sh.resultPath, violation.predicate),
        (sh.value, violation.term if violation.term is not None else text(violation.value)),
        (sh.sourceConstraintComponent, violation.component or ros.FieldConstraintComponent),
        (sh.sourceShape, violation.shape),
    )


JSON = "application/problem+json"
_SYNTAXES: Mapping[str, Syntax] = {syntax.media_type: syntax for syntax in Syntax}
_OFFERS = (JSON, "application/json", "text/html", *_SYNTAXES)
_HYDRA = "http://www.w3.org/ns/hydra/core#"
_NOWHERE = "about:blank"
_MAX_QUOTED = 2000
"""Maximum number of characters of a value returned to its sender."""


class RenderedProblem(Struct, frozen=True):
    """A problem ready to be sent."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    def response(self, *, head: bool = False) -> Response:
        """Return the Starlette response; `head` omits the body but not its length."""
        headers = {**self.headers, "content-length": str(len(self.body))}
        return Response(b"" if head else self.body, self.status, headers)


def render(problem: Problem, accept: str | None = None, *, url: str = _NOWHERE) -> RenderedProblem:
    """Return the problem in the form that the client prefers, by default problem+json.

    `url` is the resource of the problem, and the subject of the RDF. Headers that cannot be sent safely are left out,
    so that a hostile name can never turn a refusal into a failure.
    """
    chosen = choose_offer(accept, _OFFERS) or JSON
    if chosen in _SYNTAXES:
        body = _rdf(problem, _SYNTAXES[chosen], url)
    elif chosen == "text/html":
        body = _page(problem).encode("utf-8", "replace")
    else:
        chosen, body = JSON, _json(problem)
    headers = {name.lower(): value for name, value in problem.headers.items() if _sendable(name, value)}
    content_type = f"{chosen}; charset=utf-8" if chosen.startswith("text/") else chosen
    return RenderedProblem(
        problem.status,
        {
            **headers,
            "content-type": content_type,
            "vary": headers.get("vary", "Accept"),
            "cache-control": "no-store",
            "x-content-type-options": "nosniff",
            "content-security-policy": "default-src 'none'; style-src 'unsafe-inline'",
        },
        body,
    )


def members(problem: Problem) -> dict[str, object]:
    """Return the problem details object (RFC 9457 3)."""
    found: dict[str, object] = {
        **{name: value for name, value in problem.extra.items() if name not in ("type", "title", "status", "detail")},
        "type": problem.type,
        "title": problem.title,
        "status": problem.status,
        "detail": _clean(problem.detail),
    }
    if problem.violations:
        cleaned = map(_cleaned, problem.violations)
        found["violations"] = [
            {"path": one.path, "message": one.message, "value": one.value} | ({"said": one.quote} if one.quote else {})
            for one in cleaned
        ]
    if problem.near:
        found["near"] = list(problem.near)
    return found


def _json(problem: Problem) -> bytes:
    found = members(problem)
    try:
        return orjson.dumps(found, default=str, option=orjson.OPT_INDENT_2)
    except TypeError:  # a lone surrogate, or an integer beyond 64 bits
        return json.dumps(found, default=str, indent=2).encode("ascii")


def document(problem: Problem, url: str = _NOWHERE) -> Document:
    """Return a problem of the resource at `url`: a hydra:Error and, for violations, a sh:ValidationReport.

    Similar resources are linked by rdfs:seeAlso. Text of the robot is ros:words, that of another agent ros:reason.
    """
    node = NamedNode(f"{url}#problem")
    report = validation_report(url, [_cleaned(one) for one in problem.violations]) if problem.violations else None
    triples = triples_about(
        node,
        (rdf.type, NamedNode(f"{_HYDRA}Error")),
        (NamedNode(f"{_HYDRA}statusCode"), integer(problem.status)),
        (NamedNode(f"{_HYDRA}title"), text(_clean(problem.title))),
        (NamedNode(f"{_HYDRA}description"), text(_clean(problem.detail))),
        (ros.words, text(problem.quoted_members.get(ROBOT_SAID))),
        (ros.reason, text(problem.quoted_members.get(AGENT_SAID))),
        (rdfs.seeAlso, NamedNode(f"{url}#report") if report else None),
        *statements(rdfs.seeAlso, map(NamedNode, problem.near)),
    )
    return Document(url, (*triples, *(report.triples if report else ())))


def _cleaned(violation: Violation) -> Violation:
    value = None if violation.value is None else _clean(violation.value)
    return replace(violation, path=_clean(violation.path), message=_clean(violation.message), value=value)


def _rdf(problem: Problem, syntax: Syntax, url: str) -> bytes:
    try:
        return serialize(document(problem, url), syntax)
    except ValueError:  # the URL of the request is not an IRI
        return serialize(document(problem), syntax)


def _page(problem: Problem) -> str:
    title = html.escape(f"{problem.status} {problem.title}")
    rows = "".join(
        f"<tr><td><code>{html.escape(_clean(one.path))}</code></td><td>{html.escape(_clean(one.with_quote))}</td></tr>"
        for one in problem.violations
    )
    quotes = "".join(f"<p>{who}: <q>{html.escape(words)}</q></p>" for who, words in problem.quotes)
    table = f"<table><tr><th>Field</th><th>Problem</th></tr>{rows}</table>" if rows else ""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>body{{font:1rem/1.5 system-ui,sans-serif;max-width:45rem;margin:3rem auto;"
        "padding:0 1rem;color-scheme:light dark}td,th{text-align:left;padding:.2rem 1rem .2rem 0}</style></head>"
        f"<body><h1>{title}</h1><p>{html.escape(_clean(problem.detail))}</p>{quotes}{table}"
        '<p><a href="/">To the start</a></p></body></html>'
    )


def _clean(text: str) -> str:
    """Return text that every format can represent: truncated, without control characters and lone surrogates."""
    shown = text if len(text) <= _MAX_QUOTED else text[:_MAX_QUOTED] + "..."
    return "".join(char if char.isprintable() or char == "\n" else "\N{REPLACEMENT CHARACTER}" for char in shown)


def _sendable(name: str, value: str) -> bool:
    try:
        require_field_value(value)
    except ValueError:
        return False
    return is_token(name)
