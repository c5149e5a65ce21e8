"""Methods of resources, the query parameters they accept, and the refusal of others."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from difflib import get_close_matches

from rosld.adapters.model import RosError
from rosld.ontology.body import BodyError
from rosld.ontology.lift import LiftSettings
from rosld.ontology.violations import LoweringError
from rosld.server.http.fields import Link, render_links
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import MessageSchemas
from rosld.server.rest.exchange import Exchange, query_pairs
from rosld.server.rest.path_item import FORMAT, OF_EVERY_WRITE, PathItem
from rosld.server.rest.resource import LDP, Answer, Resource
from rosld.server.rest.responses import ACCEPT_FIELDS
from rosld.server.rest.ros_problems import problem_of, problem_of_body

VERBS: Mapping[str, Callable[[Resource, Exchange], Awaitable[Answer]]] = {
    "PUT": lambda resource, exchange: resource.put(exchange),
    "POST": lambda resource, exchange: resource.post(exchange),
    "PATCH": lambda resource, exchange: resource.patch(exchange),
    "DELETE": lambda resource, exchange: resource.delete(exchange),
}
"""Function of each method."""


def refuse_partial_put(exchange: Exchange) -> None:
    """Raise a 400 Problem for a PUT of a part (RFC 9110 14.5), which would replace the whole."""
    if exchange.method == "PUT" and exchange.header("content-range") is not None:
        raise Problem(400, "PUT replaces the whole, and Content-Range sends a part of it: send all, or PATCH.")


def check_media_type(exchange: Exchange, resource: Resource) -> None:
    """Raise a 415 Problem with the accepted media types (RFC 9110 12.5.1) for the body of a request."""
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


_REFUSED_BODIES = frozenset({400, 409, 415, 422})


def problem_of_error(error: BodyError | LoweringError | RosError | Problem) -> Problem:
    """Return the problem details (RFC 9457) of an error that a resource raises."""
    if isinstance(error, Problem):
        return error
    return problem_of(error) if isinstance(error, RosError) else problem_of_body(error)


def with_constraint_link(resource: Resource, error: BodyError | LoweringError | Problem) -> Problem:
    """Return the refusal of a body with a link to its constraints (LDP 4.2.1.6)."""
    problem = error if isinstance(error, Problem) else problem_of_body(error)
    if problem.status in _REFUSED_BODIES and resource.constrained_by is not None:
        problem.headers["Link"] = render_links([Link(resource.constrained_by, f"{LDP}constrainedBy")])
    return problem


def with_type_links(resource: Resource, problem: Problem) -> Problem:
    """Return a refusal with links to the types of the resource; a missing resource has none."""
    if problem.status not in (404, 410) and resource.links:
        there = problem.headers.get("Link")
        problem.headers["Link"] = ", ".join([render_links(resource.links), *([there] if there else ())])
    return problem


_LONGEST = 100
"""Maximum number of characters of a parameter that are repeated in the refusal."""
_RECEIPT = "receipt"
"""Parameter of the page after a form."""
_UNTIL = "until"
"""Accepted here even without a value that a condition could concern: it is refused elsewhere, with a better message."""
_MAX_REMEMBERED = 4096
"""Maximum number of cached requests: finding the parameters of a path item takes 50 to 100 us, a third of a read."""


class KnownParameters:
    """Check that refuses undeclared query parameters, and repeated ones that are not lists."""

    def __init__(self, lifting: LiftSettings) -> None:
        self._schemas = MessageSchemas(lambda ref: None, lifting)
        self._accepted: set[tuple[str, bool, str, str, tuple[str, ...]]] = set()

    def require(
        self, method: str, query_string: bytes, asked: Resource, resource: Resource, *, is_form: bool = False
    ) -> None:
        """Raise a 400 Problem for a parameter that neither resource declares for the method of a request.

        `asked` is the resource at the path, `resource` its variant that answers: a method that it does not have is a
        404 or 405 regardless of the parameters. A form is sent to the URL of its page, and may have the parameters of
        that.
        """
        if method in resource.passes_unknown_parameters or method in asked.passes_unknown_parameters:
            return
        names = _names(query_string)
        request = (method, is_form, asked.url, resource.url, names)
        if request in self._accepted or method not in resource.methods():
            return
        is_read = method in ("GET", "HEAD")
        known = dict.fromkeys((each.name for each in ((FORMAT,) if is_read else OF_EVERY_WRITE)), False)
        for item in (each.path_item(self._schemas) for each in dict.fromkeys((asked, resource))):
            known |= {each.name: each.is_list for each in item.write(method).query}
            if is_form or is_read:
                known |= _of_page(item)
        _require(method, names, known)
        if len(self._accepted) >= _MAX_REMEMBERED:
            self._accepted.clear()
        self._accepted.add(request)


def _names(query_string: bytes) -> tuple[str, ...]:
    """Return the names of the parameters of a query string. Raises a 400 Problem."""
    return tuple(name for name, _ in query_pairs(query_string))


def _of_page(item: PathItem) -> dict[str, bool]:
    """Return the parameters of GET, and whether each may be repeated."""
    anywhere = dict.fromkeys((_RECEIPT, _UNTIL, *item.shared_query), False)
    return {**anywhere, **{each.name: each.is_list for each in item.query}}


def _require(method: str, names: Sequence[str], known: Mapping[str, bool]) -> None:
    """Raise a 400 Problem for a parameter that is unknown, or repeated without being a list."""
    for place, name in enumerate(names):
        shown = name[:_LONGEST]
        if name not in known:
            nearest = get_close_matches(shown, known, n=1, cutoff=0.0)[0]
            there = ", ".join(f"?{each}" for each in sorted(known))
            words = f"{method} has no parameter ?{shown} here; the nearest is ?{nearest}. There are {there}."
            raise Problem(400, words)
        if name in names[:place] and not known[name]:
            raise Problem(400, f"?{shown} is there more than once, and only one would count: leave out the others.")
