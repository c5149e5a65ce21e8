"""The SPARQL 1.1 Protocol (its section 2): from a request to a `QueryRequest` or an `UpdateRequest`. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from math import inf
from urllib.parse import parse_qsl

from msgspec import Struct
from pyoxigraph import NamedNode

from rosld.ontology.charsets import UTF_8
from rosld.server.http.body import FORM, codec_for, to_utf8
from rosld.server.http.fields import parse_decimal
from rosld.server.http.negotiation import MediaType, parse_media_type
from rosld.server.http.problem import Problem
from rosld.server.sparql.syntax.lexer import line_and_column, tokens
from rosld.server.sparql.syntax.token import Kind

QUERY_MEDIA_TYPE = "application/sparql-query"
UPDATE_MEDIA_TYPE = "application/sparql-update"
ACCEPT_POST = f"{QUERY_MEDIA_TYPE}, {UPDATE_MEDIA_TYPE}, {FORM}"
_MAX_PARAMETERS = 1000
_LONGEST_CACHED = 4096


class QueryRequest(Struct, frozen=True):
    """A query and its dataset: the graphs to merge into the default graph, and the named graphs.

    Without either, the dataset is complete: every graph under its name, and their union as the default graph. `timeout`
    is the client's limit in seconds (`?timeout=`). `quads`: solutions of graph, subject, predicate and object are
    written as a dataset. `partial`: the client accepts an answer without values that cannot be read.
    """

    text: str
    default_graphs: tuple[str, ...] = ()
    named_graphs: tuple[str, ...] = ()
    timeout: float | None = None
    quads: bool = False
    partial: bool = False


class UpdateRequest(Struct, frozen=True):
    """An update and the dataset of its WHERE: the graphs to merge into the default graph, and the named graphs.

    Without either, the USING clauses of each operation apply, or else the dataset of a query that names none.
    """

    text: str
    using_graphs: tuple[str, ...] = ()
    using_named_graphs: tuple[str, ...] = ()


def query_request(query_string: bytes) -> QueryRequest:
    """Return the query of a GET; parameters unknown to the protocol are ignored.

    `query_string` is percent-encoded, as in the URL. Raises Problem 400 for no query, several, an update, text that is
    not UTF-8 or invalid graph names.
    """
    return _remembered(query_string) if len(query_string) <= _LONGEST_CACHED else _from_url(query_string)


def posted_request(query_string: bytes, content_type: str | None, body: bytes) -> QueryRequest | UpdateRequest:
    """Return the query or the update of a POST (SPARQL 1.1 Protocol 2.1, 2.2).

    Raises Problems as `query_request` does: 400 for none, several, text that is not UTF-8, invalid graph names, and for
    graphs in parameters of an update that names its own (USING, WITH); 415 for bodies of other media types.
    """
    in_url = _parameters(query_string, "query string")
    if any(name == "update" for name, _ in in_url):
        raise Problem(400, "An update must be in the body of a POST, not in the URL (SPARQL 1.1 Protocol 2.2).")
    stated = _media_type(content_type)
    essence = stated.essence
    if essence == FORM:
        in_form = _parameters(body, "form", codec_for(stated))
        if any(name == "update" for name, _ in in_form):
            return _update([*in_url, *in_form])
        if any(name == "query" for name, _ in in_url):
            raise Problem(400, "The query is in both the URL and the form: send it in one of them.")
        return _request([*in_url, *in_form])
    if essence == QUERY_MEDIA_TYPE:
        return _request([*in_url, ("query", _decode(body, "query", stated))])
    if essence == UPDATE_MEDIA_TYPE:
        return _update([*in_url, ("update", _decode(body, "update", stated))])
    raise Problem(
        415,
        f"Send a query as {QUERY_MEDIA_TYPE}, an update as {UPDATE_MEDIA_TYPE}, or either as a form ({FORM}), "
        f"not as {content_type}.",
        headers=_ACCEPTED,
    )


def _from_url(query_string: bytes) -> QueryRequest:
    return _request(_parameters(query_string, "query string"))


# Dashboards repeat the same queries.
_remembered = lru_cache(maxsize=256)(_from_url)

_ACCEPTED = {"Accept-Post": ACCEPT_POST}


def _media_type(content_type: str | None) -> MediaType:
    if content_type is None:
        raise Problem(
            415,
            f"The request has no Content-Type; send a query as {QUERY_MEDIA_TYPE}, an update as {UPDATE_MEDIA_TYPE}.",
            headers=_ACCEPTED,
        )
    try:
        found = parse_media_type(content_type)
    except ValueError as error:
        raise Problem(415, f"{error}.", headers=_ACCEPTED) from error
    if codec_for(found).startswith("utf-16"):
        sentence = (
            f"Queries and updates must be in UTF-8, not {found.parameter('charset')} (SPARQL 1.1 Protocol 2.1.3)."
        )
        raise Problem(415, sentence, headers=_ACCEPTED)
    return found


def _decode(body: bytes, what: str, media_type: MediaType) -> str:
    try:
        return to_utf8(body, media_type).decode("utf-8")
    except UnicodeDecodeError as error:
        raise Problem(400, f"The {what} is not UTF-8: {error.reason} at byte {error.start}.") from error


def _parameters(raw: bytes, where: str, codec: str = UTF_8) -> list[tuple[str, str]]:
    try:
        return parse_qsl(raw.decode("ascii"), True, encoding=codec, errors="strict", max_num_fields=_MAX_PARAMETERS)
    except UnicodeError as error:
        raise Problem(400, f"The {where} is not percent-encoded {codec.upper()}: {error}.") from error
    except ValueError as error:
        raise Problem(400, f"The {where} has more than {_MAX_PARAMETERS} parameters.") from error


def _request(parameters: list[tuple[str, str]]) -> QueryRequest:
    queries = [value for name, value in parameters if name == "query"]
    if any(name == "update" for name, _ in parameters):
        raise Problem(400, "An update must be in the body of a POST, not in the URL (SPARQL 1.1 Protocol 2.2).")
    if not queries:
        raise Problem(400, "The request has no query: send one as ?query= (SPARQL 1.1 Protocol 2.1).")
    if len(queries) > 1:
        raise Problem(400, f"The request has {len(queries)} queries; send one.")
    _refuse(parameters, _USING, "are for updates; a query has default-graph-uri and named-graph-uri")
    default, named = (_graphs(parameters, name) for name in _DATASET)
    return QueryRequest(
        queries[0], default, named, requested_timeout(parameters), partial=requested_partial(parameters)
    )


def requested_timeout(parameters: Iterable[tuple[str, str]]) -> float | None:
    """Return the seconds of `?timeout=`, None if absent. Raises a 400 Problem for an invalid number."""
    given = [value for name, value in parameters if name == "timeout"]
    if not given:
        return None
    seconds = parse_decimal(given[0])
    if len(given) > 1 or seconds is None or not 0 < seconds < inf:
        raise Problem(400, f"timeout={given[0]} must be a number of seconds above 0, such as 2.5, given once.")
    return seconds


def requested_partial(parameters: Iterable[tuple[str, str]]) -> bool:
    """Return `?partial=`, False if absent. Raises a 400 Problem for a value other than true and false."""
    given = [value for name, value in parameters if name == "partial"]
    if given not in ([], ["true"], ["false"]):
        raise Problem(400, f"partial={given[0]} must be true or false, given once.")
    return given == ["true"]


def _update(parameters: list[tuple[str, str]]) -> UpdateRequest:
    updates = [value for name, value in parameters if name == "update"]
    if any(name == "query" for name, _ in parameters):
        raise Problem(400, "The request has both a query and an update; send one of them.")
    if len(updates) > 1:
        raise Problem(400, f"The request has {len(updates)} updates; send one, with its operations joined by ';'.")
    _refuse(parameters, _DATASET, "are for queries; an update has using-graph-uri and using-named-graph-uri")
    using, named = (_graphs(parameters, name) for name in _USING)
    if using or named:
        _refuse_own_dataset(updates[0])
    return UpdateRequest(updates[0], using, named)


_DATASET = ("default-graph-uri", "named-graph-uri")
_USING = ("using-graph-uri", "using-named-graph-uri")


def _refuse(parameters: list[tuple[str, str]], names: tuple[str, str], why: str) -> None:
    if any(name in names for name, _ in parameters):
        raise Problem(400, f"{' and '.join(names)} {why}.")


def _refuse_own_dataset(text: str) -> None:
    """Raise a 400 Problem for an update that names the graphs it reads itself (SPARQL 1.1 Protocol 2.2.3)."""
    for token in tokens(text):
        if token.is_word("WITH") or (token.kind is Kind.WORD and token.text.upper().startswith("USING")):
            where = line_and_column(text, token.start)
            raise Problem(
                400, f"{token.text} at {where}: the graphs are already given outside the update; name them once."
            )


def _graphs(parameters: list[tuple[str, str]], name: str) -> tuple[str, ...]:
    graphs = tuple(dict.fromkeys(value for given, value in parameters if given == name))
    for graph in graphs:
        try:
            NamedNode(graph)
        except ValueError as error:
            raise Problem(400, f"{name}={graph!r} is not an absolute IRI: {error}.") from error
    return graphs
