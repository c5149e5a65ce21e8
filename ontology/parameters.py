"""Parameter values to RDF and to plain JSON, and back.

A scalar is its XSD literal. A list (and a dict within a list) is one rdf:JSON literal. A dict is a container whose
members are parameters. A value without a JSON form (NaN, octets, a date, an integer beyond 2^53) is an object
`{"@value": "NaN", "@type": "xsd:double"}`; a dict that could be mistaken for one is written `{"@value": {...}, "@type":
"@json"}`, as JSON-LD would.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from typing import TypeAlias

import orjson
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import ParameterValue
from rosld.ontology.body import BodyError, RdfBody, Term, parse_json
from rosld.ontology.coercion import Misfit, base64_octets
from rosld.ontology.document import Document
from rosld.ontology.lexical import NUMBERS, parse_boolean
from rosld.ontology.literals import base64_text
from rosld.ontology.triples import CONTAINER, RDF_SOURCE, double, integer, labelled, text, triples_about
from rosld.ontology.triples import boolean as boolean_literal
from rosld.ontology.urls import Space, decode_segment, encode_segment
from rosld.ontology.violations import LoweringError, Violation
from rosld.ontology.vocab import dcterms, ldp, rdf, rdfs, ros, xsd

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"

SAFE = 2**53
MAX_DEPTH = 64
"""Maximum depth of nested lists and dicts."""

_TYPED = frozenset({"@value", "@type"})
_DATE_TIME = re.compile(
    r"(\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2})(?:\.(\d{1,6})0*)?(Z|[+-]\d{2}:\d{2})?", re.ASCII
)  # fmt: skip


# Into RDF


def parameter_document(name: str, value: ParameterValue, space: Space) -> Document:
    """Return a parameter and its value; a dict includes all of its members, under the container of this name."""
    if isinstance(value, dict):
        return parameter_container_document(tuple(name[1:].split("/")), value, space)
    url = space.parameter(name)
    return Document(url, tuple(parameter_triples(url, name, value)))


Outline: TypeAlias = "dict[str, Outline | None]"
"""The members of a tree of parameters without their values."""
Tree: TypeAlias = "Mapping[str, ParameterValue] | Outline"


def parameter_container_document(
    namespace: tuple[str, ...],
    tree: Tree,
    space: Space,
    limit: int | None = None,
    *,
    whole: str | None = None,
) -> Document:
    """Return a tree of parameters as a container with all its members and their values.

    Nested trees with more than `limit` members are listed without their members. `whole` is the URL that includes
    hidden members, if there are any. A value of None is omitted.
    """
    url = space.container("parameters", namespace)
    title = f"Parameters in /{'/'.join(namespace)}" if namespace else "Parameters"
    triples = triples_about(
        NamedNode(url), *labelled(dcterms.title, title), (rdfs.seeAlso, NamedNode(whole) if whole is not None else None)
    )
    return Document(url, (*_tree(url, "/" + "/".join(namespace), tree, 0, limit), *triples))


def parameter_triples(url: str, name: str, value: ParameterValue | None = None) -> list[Triple]:
    """Return a parameter that is not a tree, without its value if that is None."""
    literal = None if value is None else parameter_literal(value)
    return triples_about(
        NamedNode(url), (rdf.type, ros.Parameter), *RDF_SOURCE, *labelled(ros.name, name), (ros.value, literal)
    )


def _tree(url: str, name: str, tree: Tree, depth: int, limit: int | None) -> list[Triple]:
    if depth > MAX_DEPTH:
        raise ValueError(f"{name} lies deeper than {MAX_DEPTH} levels, which is more than rosld shows")
    subject = NamedNode(url)
    label = f"Parameters in {name}" if depth else None
    triples = triples_about(
        subject, (rdf.type, ros.Parameter), *CONTAINER, (ros.name, text(name)), (rdfs.label, text(label))
    )
    if depth and limit is not None and len(tree) > limit:
        return triples
    for key, value in tree.items():
        member, inner = url + encode_segment(key), f"{name.rstrip('/')}/{key}"
        if isinstance(value, dict):
            triples.append(Triple(subject, ldp.contains, NamedNode(member + "/")))
            triples += _tree(member + "/", inner, value, depth + 1, limit)
        else:
            triples.append(Triple(subject, ldp.contains, NamedNode(member)))
            triples += parameter_triples(member, inner, value)
    return triples


def parameter_literal(value: ParameterValue) -> Literal | None:
    """Return the literal of a value that is no dict. Raises ValueError for a dict."""
    match value:
        case bool():
            return boolean_literal(value)
        case int():
            return integer(value)
        case float():
            return double(value)
        case str():
            return text(value)
        case bytes():
            return Literal(base64_text(value), datatype=xsd.base64Binary)
        case datetime():
            return Literal(_date_time(value), datatype=xsd.dateTime)
        case list():
            return Literal(parameter_json(value).decode(), datatype=rdf.JSON)
        case dict():
            raise ValueError("a dict is a container of parameters, not a literal")


def _date_time(value: datetime) -> str:
    """Return the xsd:dateTime, without a zone if the value has none; UTC is `Z`."""
    written = value.isoformat()
    return written.removesuffix("+00:00") + "Z" if written.endswith("+00:00") else written


# Into plain JSON


def parameter_json(value: ParameterValue) -> bytes:
    """Return the value as plain JSON."""
    return orjson.dumps(plain_value(value))


def plain_value(value: ParameterValue) -> Json:
    """Return the value as JSON can represent it. Raises ValueError if it is nested too deeply."""
    return _plain(value, 0)


def _plain(value: ParameterValue, depth: int) -> Json:
    if depth > MAX_DEPTH:
        raise ValueError(f"the value is nested deeper than {MAX_DEPTH} levels")
    match value:
        case bool() | str():
            return value
        case int() if abs(value) <= SAFE:
            return value
        case float() if math.isfinite(value):
            return value
        case list():
            return [_plain(element, depth + 1) for element in value]
        case dict():
            members: dict[str, Json] = {key: _plain(element, depth + 1) for key, element in value.items()}
            return {"@value": members, "@type": "@json"} if members.keys() == _TYPED else members
        case _:
            written = parameter_literal(value)
            assert written is not None
            return {"@value": written.value, "@type": "xsd:" + written.datatype.value.removeprefix(xsd.iri)}


# Out of RDF


def lower_parameter(body: RdfBody, url: str) -> ParameterValue:
    """Return the value that a body states for the parameter at `url` (for a tree with or without its slash).

    Also found: the only subject of type ros:Parameter, or the only one with an ros:value, that nothing links to.
    Raises LoweringError with the path of the invalid value.
    """
    return _lower(body, _subject(body, url), "", 0)


def _subject(body: RdfBody, url: str) -> NamedNode:
    bare = url.rstrip("/")
    for candidate in (url, bare, bare + "/"):
        if body.properties(node := NamedNode(candidate)):
            return node
    roots = [
        subject
        for subject in body.roots()
        if isinstance(subject, NamedNode)
        and (ros.Parameter in body.objects(subject, rdf.type) or body.objects(subject, ros.value))
    ]
    if len(roots) != 1:
        raise _error("", f"expected one parameter: <{url}> ros:value and its value", None)
    return roots[0]


def _lower(body: RdfBody, subject: NamedNode, path: str, depth: int) -> ParameterValue:
    values = body.objects(subject, ros.value)
    kinds = body.objects(subject, rdf.type)
    members = body.objects(subject, ldp.contains)
    if len(values) > 1:
        raise _error(path, f"expected one ros:value, not {len(values)}", None)
    if values and members:
        raise _error(path, "a parameter has a value or members, not both", None)
    if values:
        return lower_term(values[0], path)
    if members or ldp.BasicContainer in kinds or ldp.Container in kinds:
        if depth > MAX_DEPTH:
            raise _error(path, f"nested deeper than {MAX_DEPTH} levels", None)
        return {_key(member, subject, path): _member(body, member, subject, path, depth) for member in members}
    raise _error(path, "expected an ros:value (or, for a tree, ldp:contains and the type ldp:BasicContainer)", None)


def _key(member: Term, container: NamedNode, path: str) -> str:
    """Return the key of a member: the last segment of its URL, which is directly below the container's."""
    base = container.value.rstrip("/") + "/"
    value = member.value if isinstance(member, NamedNode) else ""
    segment = value.removeprefix(base).removesuffix("/")
    if not value.startswith(base) or not segment or "/" in segment:
        raise _error(path, f"expected members that lie directly in <{base}>", str(member))
    try:
        return decode_segment(segment)
    except ValueError as error:
        raise _error(path, str(error), value) from error


def _member(body: RdfBody, member: Term, container: NamedNode, path: str, depth: int) -> ParameterValue:
    assert isinstance(member, NamedNode)
    key = _key(member, container, path)
    return _lower(body, member, f"{path}/{key}" if path else key, depth + 1)


def lower_term(term: Term, path: str = "") -> ParameterValue:
    """Return the value of an RDF term. Raises LoweringError with the `path` for an invalid term."""
    if not isinstance(term, Literal):
        raise _error(path, "expected a literal as ros:value", str(term))
    if term.language is not None:
        raise _error(path, "ROS has no languages: omit the language tag", term.value)
    try:
        if term.datatype == rdf.JSON:
            value = lower_json(parse_json(term.value.encode()))
            if isinstance(value, dict):
                raise Misfit("a dict is written as a container with members, not as rdf:JSON", term.value)
            if not isinstance(value, list):
                raise Misfit("a scalar is written with its XSD datatype, not as rdf:JSON", term.value)
            return value
        return _scalar(term.datatype, term.value)
    except BodyError as error:
        raise _error(path, f"this rdf:JSON cannot be read: {error}", term.value) from error
    except Misfit as error:
        raise _error(path, error.words, term.value) from error


def _scalar(datatype: NamedNode, lexical: str) -> ParameterValue:
    """Return the value of a literal. Raises Misfit."""
    if datatype == xsd.string:
        return lexical
    if datatype == xsd.boolean:
        return parse_boolean(lexical)
    if datatype in _FLOATS:
        return float(NUMBERS[datatype](lexical))
    if (number := NUMBERS.get(datatype)) is not None:
        return int(number(lexical))
    read = _OTHERS.get(datatype)
    if read is None:
        raise Misfit(f"no parameter has the datatype <{datatype.value}>", lexical)
    return read(lexical)


def _moment(lexical: str) -> datetime:
    """Return a date to the microsecond, the precision of ROS parameters."""
    match = _DATE_TIME.fullmatch(lexical.strip())
    if match is None:
        raise Misfit("expected an xsd:dateTime to the microsecond, such as 2026-01-31T12:00:00.5Z", lexical)
    zone = (match[3] or "").replace("Z", "+00:00")
    try:
        return datetime.fromisoformat(f"{match[1]}.{(match[2] or '0').ljust(6, '0')}{zone}")
    except ValueError as error:
        raise Misfit(f"expected an xsd:dateTime ({error})", lexical) from error


_FLOATS = frozenset({xsd.double, xsd.float, xsd.decimal})
_OTHERS: Mapping[NamedNode, Callable[[str], ParameterValue]] = {xsd.base64Binary: base64_octets, xsd.dateTime: _moment}


# Out of plain JSON


def lower_json(value: object) -> ParameterValue:
    """Return the value of parsed JSON. Raises LoweringError with the path of a null or of an invalid typed value."""
    return _from_json(value, "", 0)


def _from_json(value: object, path: str, depth: int) -> ParameterValue:
    if depth > MAX_DEPTH:
        raise _error(path, f"nested deeper than {MAX_DEPTH} levels", None)
    match value:
        case bool() | int() | float():
            return value
        case str():
            return _text(value, path)
        case list():
            return [_from_json(each, f"{path}.{index}".lstrip("."), depth + 1) for index, each in enumerate(value)]
        case {"@value": inner, "@type": str(kind), **rest} if not rest:
            return _typed_value(inner, kind, path, depth)
        case dict():
            return _members(value.items(), path, depth)
        case _:
            raise _error(path, "ROS parameters cannot be null", "null")


def _members(items: Iterable[tuple[object, object]], path: str, depth: int) -> dict[str, ParameterValue]:
    return {_text(str(key), path): _from_json(each, f"{path}.{key}".lstrip("."), depth + 1) for key, each in items}


def _text(value: str, path: str) -> str:
    """Return a string of JSON, which may contain escapes of invalid characters."""
    if any("\ud800" <= character <= "\udfff" for character in value):
        raise _error(path, "expected a string of Unicode characters, without lone surrogates", ascii(value))
    return value


def _typed_value(inner: object, kind: str, path: str, depth: int) -> ParameterValue:
    if kind == "@json" and isinstance(inner, dict):
        return _members(inner.items(), path, depth)
    if not isinstance(inner, str):
        raise _error(path, 'expected "@value" to be a string beside its "@type"', str(inner)[:80])
    try:
        return _scalar(NamedNode(xsd.iri + kind.removeprefix("xsd:") if kind.startswith("xsd:") else kind), inner)
    except (Misfit, ValueError) as error:
        raise _error(path, str(error), inner) from error


def _error(path: str, words: str, value: str | None) -> LoweringError:
    return LoweringError(Violation(path, words, None if value is None else value[:120]))
