"""Answers to writes of mappings: what one names that is not there, or cannot be offered, is told at once."""

from __future__ import annotations

from rosld.server.http.fields import to_uri
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.policies.stored_mappings import ROUTE
from rosld.server.resources.ldp.documents import Documents
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import Answer, CreatedAnswer


async def with_warnings(documents: Documents, path: str, exchange: Exchange, answer: Answer) -> Answer:
    """The answer to a write that put a mapping in force: in words where it names in vain, if no other is preferred.

    The warnings name what is there instead, so they are for those who may read everything.
    """
    is_told = exchange.permissions.may_read_all and not (exchange.prefer.minimal or exchange.prefer.representation)
    if not path.startswith(ROUTE) or not is_told:
        return answer
    url = documents.space.base + path
    warnings = await documents.mapping_warnings(url)
    if not warnings:
        return answer
    is_new = isinstance(answer, CreatedAnswer)
    problem = Problem(
        201 if is_new else 200,
        f"The mapping is in force. Of what it names this is not there now: {' '.join(warnings)}",
        title="In force, with warnings",
        headers={"Location": to_uri(url)} if is_new else {},
    )
    problem.extra |= {"warnings": list(warnings)}
    return render(problem, exchange.accept).response()
