"""Refusals for lack of rights: 401 for anonymous clients, 403 and 404 for authenticated ones.

A resource that the agent may not know of gets the same bytes whether it exists or not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

from rosld.server.auth.rules import ANONYMOUS, Agent
from rosld.server.http.problem import Problem

_REALM = 'realm="rosld"'
_BASIC = f'Basic {_REALM}, charset="UTF-8"'
CHALLENGE = f"Bearer {_REALM}, {_BASIC}"
"""Accepted schemes of Authorization (RFC 6750 3, RFC 7617 2.1): the password of Basic is a token."""
NOT_VISIBLE_DETAIL = "Not found, or not visible to you."
GONE_DETAIL = "This resource is gone: it was deleted, or it has ended."
WITHHELD = "The reason mentions something that you may not read"
_DONE = frozenset({"sent", "members"})
"""Members of a problem about the outcome of a write: they only mention what the client requested."""


def invalid_token(why: str) -> Problem:
    """Return the 401 for invalid credentials (RFC 6750 3.1)."""
    challenge = f'Bearer {_REALM}, error="invalid_token", {_BASIC}'
    return Problem(401, f"{why} Ask the operator of this server for a token.", headers={"WWW-Authenticate": challenge})


def not_visible(agent: Agent) -> Problem:
    """Return the refusal for an agent that may not know whether the resource exists."""
    if agent == ANONYMOUS:
        return authentication_required()
    return not_found()


def authentication_required() -> Problem:
    """Return the 401 for a request that requires authentication (RFC 9110 15.5.2)."""
    sentence = "Authentication required: send a token as 'Authorization: Bearer TOKEN', or as the password of Basic."
    return Problem(401, sentence, headers={"WWW-Authenticate": CHALLENGE})


def not_found() -> Problem:
    """Return a 404 that reveals nothing about existing resources."""
    return Problem(404, NOT_VISIBLE_DETAIL)


def gone() -> Problem:
    """Return a 410 that reveals nothing about the former resource."""
    return Problem(410, GONE_DETAIL)


def withhold_reason(problem: Problem) -> Problem:
    """Remove the reason of a refusal if it mentions what the agent may not know."""
    extra = {name: problem.extra[name] for name in _DONE & problem.extra.keys()}
    if "members" in extra:
        found = cast("Sequence[Mapping[str, object]]", extra["members"])
        extra["members"] = [{name: each[name] for name in ("name", "status")} for each in found]
    return Problem(
        problem.status, f"{WITHHELD}.", title=problem.title, type=problem.type, headers=problem.headers, extra=extra
    )


def forbidden(agent: Agent, what: str) -> Problem:
    """Return the refusal for an agent that may know of the resource, but not do this."""
    if agent == ANONYMOUS:
        return authentication_required()
    return Problem(403, f"You, {agent.name}, may not {what}. Ask the operator of this server for permission.")
