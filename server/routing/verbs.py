"""Methods that write (RFC 9110 9.3): which verb of a resource each calls, and what a request must be for it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping

from rosld.server.http.problem import Problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import Answer, Resource
from rosld.server.rest.resource_headers import ACCEPT_FIELDS

VERBS: Mapping[str, Callable[[Resource, Exchange], Awaitable[Answer]]] = {
    "PUT": lambda resource, exchange: resource.put(exchange),
    "POST": lambda resource, exchange: resource.post(exchange),
    "PATCH": lambda resource, exchange: resource.patch(exchange),
    "DELETE": lambda resource, exchange: resource.delete(exchange),
}
"""What carries out each method."""


def refuse_partial_put(exchange: Exchange) -> None:
    """Raise a 400 Problem for a PUT of a part (RFC 9110 14.5), which would replace the whole."""
    if exchange.method == "PUT" and exchange.header("content-range") is not None:
        raise Problem(400, "PUT replaces the whole, and Content-Range sends a part of it: send all, or PATCH.")


def check_media_type(exchange: Exchange, resource: Resource) -> None:
    """Raise a 415 Problem, with what is accepted (RFC 9110 12.5.1), for a body that the resource does not take."""
    accepted = resource.accepts.get(exchange.method)
    if accepted is None:
        return
    if exchange.header("content-type") is None and exchange.header("content-length") in (None, "0"):
        return
    if "*/*" in accepted and exchange.essence is not None:
        return
    if exchange.media_type not in accepted:
        headers = {ACCEPT_FIELDS[exchange.method]: ", ".join(accepted)}
        raise Problem(
            415, f"{exchange.method} takes {', '.join(accepted)} here, not {exchange.media_type}.", headers=headers
        )
