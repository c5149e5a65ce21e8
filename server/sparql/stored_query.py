"""Stored queries: SPARQL with a purpose and parameters, declared in the leading comments of the text (`queries/`).

A parameter is bound as a term: wherever its variable is a token of the text, the term replaces it, escaped so that it
cannot be read as anything else. So parameters work everywhere, in subqueries and in HAVING too, and the needs of the
query (`needs.py`) follow from the constants.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from importlib.resources import files
from itertools import count

from msgspec import Struct
from pyoxigraph import BlankNode, Literal, NamedNode, Store, Triple, Variable

from rosld.ontology.coercion import Misfit
from rosld.ontology.describe_graph import SECTIONS
from rosld.ontology.lexical import NUMBERS
from rosld.ontology.lift import TYPES
from rosld.ontology.triples import double
from rosld.ontology.urls import Space, locate
from rosld.ontology.vocab import xsd
from rosld.server.dataset import QueryError
from rosld.server.http.problem import Problem
from rosld.server.sparql.analysis import Analyser, parse_problem
from rosld.server.sparql.syntax.lexer import (
    check_text,
    line_and_column,
    tokens,
    update_keyword,
)
from rosld.server.sparql.syntax.token import Kind

_SUFFIX = ".rq"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_PARAMETER = re.compile(r"@param\s+(?P<name>\S+)\s+(?P<type>\S+)(?:\s+(?P<default>.*?))??\s+--\s+(?P<about>\S.*)")
OTHER_SETTINGS = {
    "format": "the format of the results",
    "partial": "whether a partial result is accepted",
    "timeout": "the time limit of the query",
}
"""Other parameters in the URL of a query, whatever parameters it declares."""
_SURROGATE = re.compile("[\ud800-\udfff]")
_INT64 = range(-(2**63), 2**63)
_LONGEST_QUOTED = 200
_MAX_PARAMETERS = 50
_MAX_BOUND = 4 * 1024 * 1024
"""Maximum number of characters of a query with its parameters bound (one may occur in many places)."""
_LINE_END = re.compile(r"\r\n?|\n")
_PLACE = re.compile(r" at (\d+):\d+")


class ParameterType(Enum):
    """Type of a parameter."""

    IRI = "iri"
    STRING = "string"
    INTEGER = "integer"
    DOUBLE = "double"


class QueryParameterDeclaration(Struct, frozen=True):
    """A parameter; `name` is that of its variable, without the mark; `default` is text, None if it is required."""

    name: str
    type: ParameterType
    default: str | None
    about: str


class StoredQuery(Struct, frozen=True):
    """A stored query; `text` includes the comments."""

    name: str
    purpose: str
    parameters: tuple[QueryParameterDeclaration, ...]
    text: str


# Reading


def shipped_queries() -> Mapping[str, StoredQuery]:
    """Return the queries that rosld ships, by name in order; their SPARQL is not checked here."""
    found = (file for file in files("rosld.queries").iterdir() if file.name.endswith(_SUFFIX))
    ordered = sorted(found, key=lambda file: file.name)
    texts = {file.name.removesuffix(_SUFFIX): file.read_text("utf-8") for file in ordered}
    return {name: outline(name, text) for name, text in texts.items()}


def read_stored_query(name: str, text: str) -> StoredQuery:
    """Return the stored query in a text.

    Raises ValueError naming the query and the offending line or parameter.
    """
    query, lines = _outline(name, text)
    _check(query, lines)
    return query


def outline(name: str, text: str) -> StoredQuery:
    """Return the query that the leading comments declare, without checking the SPARQL below. Raises ValueError."""
    return _outline(name, text)[0]


def _outline(name: str, text: str) -> tuple[StoredQuery, Mapping[str, int]]:
    """Return the query, and the line of each parameter's declaration."""
    purpose: list[str] = []
    parameters: list[QueryParameterDeclaration] = []
    lines: dict[str, int] = {}
    for number, line in enumerate(_comments(text), 1):
        if line.startswith("@"):
            parameter = _parameter(line, f"{name}:{number}")
            if parameter.name in lines:
                raise ValueError(f"{name}:{number}: the parameter {parameter.name} is declared twice")
            parameters.append(parameter)
            lines[parameter.name] = number
        elif parameters and line:
            raise ValueError(f"{name}:{number}: {_brief(line)} must come before the parameters, with the purpose")
        elif line:
            purpose.append(line)
    if not purpose:
        raise ValueError(f"{name}:1: must begin with a comment that states its purpose")
    if len(parameters) > _MAX_PARAMETERS:
        raise ValueError(f"{name}:{number}: a query has at most {_MAX_PARAMETERS} parameters")
    return StoredQuery(name, " ".join(purpose), tuple(parameters), text), lines


def _comments(text: str) -> Iterable[str]:
    """Yield the leading comment lines of the text, without their marks."""
    for line in _LINE_END.split(text):
        if not line.startswith("#"):
            return
        yield line[1:].strip()


def _parameter(line: str, where: str) -> QueryParameterDeclaration:
    match = _PARAMETER.fullmatch(line)
    if match is None:
        raise ValueError(f"{where}: {_brief(line)} must look like '@param seconds double 5 -- what it is'")
    name, kind, default = match["name"], match["type"], match["default"]
    if not _NAME.fullmatch(name):
        raise ValueError(f"{where}: the parameter {_brief(name)} must be named with ASCII letters, digits, underscores")
    if name in OTHER_SETTINGS:
        raise ValueError(f"{where}: a parameter cannot be named {name}, which is {OTHER_SETTINGS[name]}")
    if kind not in (one.value for one in ParameterType):
        raise ValueError(
            f"{where}: {_brief(kind)} is not a parameter type: choose from "
            f"{', '.join(one.value for one in ParameterType)}"
        )
    return QueryParameterDeclaration(name, ParameterType(kind), "" if default == '""' else default, match["about"])


def _check(query: StoredQuery, lines: Mapping[str, int]) -> None:
    """Check that defaults fit their types and that the query parses with parameters bound where terms may occur."""
    name = query.name
    for parameter in query.parameters:
        try:
            _bound_term(parameter, _SAMPLES[parameter.type] if parameter.default is None else None, _ANYWHERE)
        except ValueError as error:
            raise ValueError(f"{name}:{lines[parameter.name]}: the default of {parameter.name}: {error}") from error
    try:
        checked = check_text(query.text)
        if keyword := update_keyword(checked.tokens):
            word = next(token for token in checked.tokens if token.text.upper() == keyword)
            line = line_and_column(checked.text, word.start).partition(":")[0]
            raise ValueError(f"{name}:{line}: {keyword} is an update, but a stored query only reads")
        there = {token.text[1:] for token in checked.tokens if token.kind is Kind.VARIABLE}
        if unused := [one for one in lines if one not in there]:
            raise ValueError(f"{name}:{lines[unused[0]]}: the parameter ?{unused[0]} is not used in the query")
        samples = {one.name: _SAMPLES[one.type] for one in query.parameters if one.default is None}
        bound = bind_parameters(query, samples, _ANYWHERE)
    except Problem as problem:
        raise ValueError(f"{name}: {problem.detail}") from problem
    try:
        _parse(bound, next(f"nobodys{number}" for number in count() if f"nobodys{number}" not in there))
    except Problem as problem:
        found = _PLACE.search(problem.detail)
        where = f"{name}:{found[1]}" if found else name
        raise ValueError(
            f"{where}: it is not a valid query with its parameters bound. {problem.detail.removesuffix('.')}"
        ) from problem


def _parse(text: str, nobodys: str) -> None:
    """Parse a query without evaluating it; `nobodys` is a variable name that it does not use. Raises Problem 400."""
    analysis = Analyser(_ANYWHERE, TYPES).analyse(text)
    # A substitution for an unknown variable is rejected after the text was parsed, and before it is evaluated.
    values: dict[Variable, NamedNode | BlankNode | Literal | Triple] = {Variable(nobodys): Literal("")}
    try:
        Store().query(analysis.text, base_iri=_ANYWHERE, prefixes=dict(analysis.prefixes), substitutions=values)
    except SyntaxError as error:
        raise parse_problem(QueryError(str(error)), analysis.text) from error
    except RuntimeError:
        pass  # it parsed


# Binding


def bind_parameters(query: StoredQuery, given: Mapping[str, str], base: str) -> str:
    """Return the text of the query with its parameters bound to the given values or their defaults.

    `base` is the server's base URL (with its final slash): an `iri` may be given as a path below it (`/topics/x`). For
    all types but string, empty text (an empty form field) counts as absent. Raises Problem 400 for parameters that are
    unknown, missing or invalid; it names them all and lists the parameters.
    """
    known = {parameter.name for parameter in query.parameters}
    wrong = [f"there is no parameter {_brief(name)}" for name in given if name not in known]
    terms: dict[str, str] = {}
    for parameter in query.parameters:
        try:
            terms[parameter.name] = _bound_term(parameter, given.get(parameter.name), base)
        except ValueError as error:
            wrong.append(f"{parameter.name}: {error}")
    if wrong:
        raise _refusal(query, wrong)
    return "".join(_with_terms(query, terms))


def _with_terms(query: StoredQuery, terms: Mapping[str, str]) -> Iterator[str]:
    size = 0
    for token in tokens(query.text):
        # Blanks on either side separate the term from its neighbours.
        is_bound = token.kind is Kind.VARIABLE and token.text[1:] in terms
        text = f" {terms[token.text[1:]]} " if is_bound else token.text
        size += len(text)
        if size > _MAX_BOUND:
            raise Problem(413, f"With these values the query {query.name} is too long: use shorter ones.")
        yield text


def _bound_term(parameter: QueryParameterDeclaration, given: str | None, base: str) -> str:
    """Return the SPARQL term of a parameter. Raises ValueError (a Misfit, or with its own message)."""
    if given is None or (not given and parameter.type is not ParameterType.STRING):
        given = parameter.default
    if given is None:
        raise ValueError(f"a value is required: {parameter.about}")
    if _SURROGATE.search(given):
        raise ValueError(f"{_brief(given)} contains a lone surrogate, which is not a character")
    return _TERMS[parameter.type](given, base)


def _refusal(query: StoredQuery, wrong: list[str]) -> Problem:
    return Problem(
        400,
        f"Invalid parameters of the query {query.name}: {'; '.join(wrong)}. {_offer(query.parameters)}",
        extra={
            "parameters": [
                {"name": one.name, "type": one.type.value, "default": one.default, "about": one.about}
                for one in query.parameters
            ]
        },
    )


def _offer(parameters: tuple[QueryParameterDeclaration, ...]) -> str:
    if not parameters:
        return "This query has no parameters."
    return f"Its parameters: {', '.join(f'{one.name} ({one.type.value})' for one in parameters)}."


def _brief(value: str) -> str:
    return repr(value if len(value) <= _LONGEST_QUOTED else value[:_LONGEST_QUOTED] + "...")


# Terms as SPARQL writes them


def _string(value: str, base: str = "") -> str:
    r"""Return a string literal that is safe whenever codepoint escapes are replaced (SPARQL 1.1, 19.2).

    A backslash that would begin an escape if escapes are replaced before parsing is followed by the escape of its `u`.
    """
    return f'"{_SPECIAL.sub(lambda match: _ESCAPES[match[0]], value)}"'


_ESCAPES = {
    '"': r"\"", "\n": r"\n", "\r": r"\r", "\\": r"\\", r"\u": r"\\\u0075", r"\U": r"\\\u0055",
}  # fmt: skip
_SPECIAL = re.compile(r'\\[uU]|["\n\r\\]')


def _integer(value: str, base: str = "") -> str:
    try:
        number = int(NUMBERS[xsd.integer](value))
    except Misfit as error:
        raise ValueError(f"{_brief(value)} is not an integer such as 42") from error
    if number not in _INT64:
        raise ValueError(f"{_brief(value)} exceeds 64 bits")
    return f'"{number}"^^<{xsd.integer.value}>'


def _double(value: str, base: str = "") -> str:
    try:
        return str(double(float(NUMBERS[xsd.double](value))))
    except Misfit as error:
        raise ValueError(f"{_brief(value)} is not a number such as 2.5") from error


def _iri(value: str, base: str) -> str:
    written = _url(value, base) if value.startswith("/") else value
    try:
        node = NamedNode(written)
    except ValueError as error:
        raise ValueError(
            f"{_brief(value)} is neither an absolute IRI nor a path such as /topics/x ({error})"
        ) from error  # fmt: skip
    return f"<{node.value}>"


def _url(path: str, base: str) -> str:
    """Return the URL of a path on this server, with its segments encoded as in all its URLs."""
    match = re.fullmatch(r"([^?#]*)(.*)", path, re.DOTALL)
    assert match is not None
    location = locate(match[1])
    space = Space(base)
    if location.kind not in SECTIONS and path != "/":
        raise ValueError(f"{_brief(path)} is not a path of this server such as /topics/x or /nodes/x")
    if not location.kind:
        return base
    written = space.url(location.kind, location.segments)
    return f"{written}{'/' if location.is_container else ''}{match[2]}"


_TERMS: Mapping[ParameterType, Callable[[str, str], str]] = {
    ParameterType.IRI: _iri,
    ParameterType.STRING: _string,
    ParameterType.INTEGER: _integer,
    ParameterType.DOUBLE: _double,
}
_ANYWHERE = "http://localhost/"
_SAMPLES: Mapping[ParameterType, str] = {
    ParameterType.IRI: "/",
    ParameterType.STRING: "",
    ParameterType.INTEGER: "0",
    ParameterType.DOUBLE: "0",
}
