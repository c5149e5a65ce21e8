"""Strictness: whether what JSON leaves out is refused or has its default. RDF says all of a message, or is refused."""

from __future__ import annotations

from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import BOOLEAN
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import QueryParameter

STRICTNESS = (
    QueryParameter(
        "strict", "Whether fields that JSON leaves out are refused; otherwise they have their defaults.", BOOLEAN
    ),
    QueryParameter("defaults", "The opposite of `strict`, as it was once called.", BOOLEAN),
)


def is_strict(exchange: Exchange) -> bool:
    """Whether a message in JSON must have all its fields: `?strict=true`, or `?defaults=false`, as it was once called.

    Raises a 400 Problem where the two contradict each other.
    """
    strict = exchange.query_flag("strict")
    if "defaults" not in exchange.query:
        return strict
    if "strict" in exchange.query and exchange.query_flag("defaults") == strict:
        raise Problem(400, "?strict and ?defaults contradict each other: leave ?defaults out.")
    return not exchange.query_flag("defaults")
