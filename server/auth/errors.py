"""Refusals for lack of rights: 401 to anonymous clients, 403 and 404 to authenticated ones.

What an agent may not know of is refused in the same bytes whether it is there or not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

from rosld.server.auth.agent import ANONYMOUS, Agent
from rosld.server.http.problem import Problem

_REALM = 'realm="rosld"'
_BASIC = f'Basic {_REALM}, charset="UTF-8"'
CHALLENGE = f"Bearer {_REALM}, {_BASIC}"
"""What may be sent in Authorization (RFC 6750 3, RFC 7617 2.1): the password of Basic is a token."""
NOT_VISIBLE_DETAIL = "There is nothing here that you may know of."
GONE_DETAIL = "What was here is gone: it was deleted, or it has ended."
WITHHELD = "The reason speaks of what you may not read"
_DONE = frozenset({"sent", "members"})
"""The members of a problem that say what became of a write: they name nothing but what the client asked for."""


def invalid_token(why: str) -> Problem:
    """401: what was sent proves nothing (RFC 6750 3.1)."""
    challenge = f'Bearer {_REALM}, error="invalid_token", {_BASIC}'
    return Problem(401, f"{why} Ask whoever runs this server for a token.", headers={"WWW-Authenticate": challenge})


def not_visible(agent: Agent) -> Problem:
    """To one who may not know whether there is anything."""
    if agent == ANONYMOUS:
        return authentication_required()
    return not_found()


def authentication_required() -> Problem:
    """401: it takes somebody who is known (RFC 9110 15.5.2)."""
    sentence = "Say who you are: send a token, as 'Authorization: Bearer TOKEN' or as the password of Basic."
    return Problem(401, sentence, headers={"WWW-Authenticate": CHALLENGE})


def not_found() -> Problem:
    """404 without a word about what is there."""
    return Problem(404, NOT_VISIBLE_DETAIL)


def gone() -> Problem:
    """410 without a word about what was there."""
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
    """To one who may know of it, and may not do this."""
    if agent == ANONYMOUS:
        return authentication_required()
    return Problem(403, f"You, {agent.name}, may not {what}. Rights are given by whoever runs this server.")
