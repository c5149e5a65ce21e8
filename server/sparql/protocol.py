"""The SPARQL 1.1 Protocol for queries (its section 2.1): from a request to a `QueryRequest`. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from urllib.parse import parse_qsl

from pyoxigraph import NamedNode

from rosld.server.http import media
from rosld.server.http.problem import Problem

FORM = "application/x-www-form-urlencoded"
DIRECT = "application/sparql-query"
UPDATE = "application/sparql-update"
ACCEPT_POST = f"{DIRECT}, {FORM}"
_MOST_PARAMETERS = 1000
_LONGEST_CACHED = 4096


@dataclass(frozen=True, slots=True)
class QueryRequest:
    """A query and its dataset: the graphs to merge into the default graph, and those to be named graphs.

    Without either the dataset is all there is: every graph under its name, and their union as the default graph.
    """

    text: str
    default_graphs: tuple[str, ...] = ()
    named_graphs: tuple[str, ...] = ()


def query_request(method: str, query_string: bytes, content_type: str | None = None, body: bytes = b"") -> QueryRequest:
    """The query that a request asks for; parameters that the protocol does not know are passed over.

    `query_string` is as it stands in the URL, percent-encoded. Raises Problems: 400 for no query, several, an update,
    text that is not UTF-8 or graph names that are no IRIs; 415 for bodies of other media types.
    """
    if method in ("GET", "HEAD"):
        return _remembered(query_string) if len(query_string) <= _LONGEST_CACHED else _from_url(query_string)
    in_url = _parameters(query_string, "query string")
    essence = _essence(content_type)
    if essence == FORM:
        if any(name == "query" for name, _ in in_url):
            raise Problem(400, "The query stands in the URL and the form: send it in one of them.")
        return _request([*in_url, *_parameters(body, "form")])
    if essence == DIRECT:
        return _request([*in_url, ("query", _decoded(body))])
    if essence == UPDATE:
        raise Problem(415, "Updates are not taken here; this is the endpoint for queries.", headers=_ACCEPTED)
    raise Problem(415, f"A query comes as {DIRECT} or as a form ({FORM}), not as {content_type}.", headers=_ACCEPTED)


def _from_url(query_string: bytes) -> QueryRequest:
    return _request(_parameters(query_string, "query string"))


# Dashboards ask the same again and again.
_remembered = lru_cache(maxsize=256)(_from_url)

_ACCEPTED = {"Accept-Post": ACCEPT_POST}


def _essence(content_type: str | None) -> str:
    if content_type is None:
        raise Problem(415, f"The request has no Content-Type; a query comes as {DIRECT}.", headers=_ACCEPTED)
    try:
        found = media.parse(content_type)
    except ValueError as error:
        raise Problem(415, f"{error}.", headers=_ACCEPTED) from error
    charset = found.parameter("charset")
    if charset not in (None, "utf-8", "utf8"):
        raise Problem(415, f"A query is in UTF-8, not in {charset} (SPARQL 1.1 Protocol 2.1.3).", headers=_ACCEPTED)
    return found.essence


def _decoded(body: bytes) -> str:
    try:
        return body.decode("utf-8")
    except UnicodeDecodeError as error:
        raise Problem(400, f"The query is not UTF-8: {error.reason} at byte {error.start}.") from error


def _parameters(raw: bytes, where: str) -> list[tuple[str, str]]:
    try:
        return parse_qsl(raw.decode("ascii"), keep_blank_values=True, errors="strict", max_num_fields=_MOST_PARAMETERS)
    except UnicodeError as error:
        raise Problem(400, f"The {where} is not percent-encoded UTF-8: {error}.") from error
    except ValueError as error:
        raise Problem(400, f"The {where} has more than {_MOST_PARAMETERS} parameters.") from error


def _request(parameters: list[tuple[str, str]]) -> QueryRequest:
    queries = [value for name, value in parameters if name == "query"]
    if not queries and any(name == "update" for name, _ in parameters):
        raise Problem(400, "There is an update and no query; updates are not taken here.")
    if not queries:
        raise Problem(400, "There is no query: give one as ?query= (SPARQL 1.1 Protocol 2.1).")
    if len(queries) > 1:
        raise Problem(400, f"There are {len(queries)} queries in one request; send one.")
    default, named = (_graphs(parameters, name) for name in ("default-graph-uri", "named-graph-uri"))
    return QueryRequest(queries[0], default, named)


def _graphs(parameters: list[tuple[str, str]], name: str) -> tuple[str, ...]:
    graphs = tuple(dict.fromkeys(value for given, value in parameters if given == name))
    for graph in graphs:
        try:
            NamedNode(graph)
        except ValueError as error:
            raise Problem(400, f"{name}={graph!r} is no absolute IRI: {error}.") from error
    return graphs
