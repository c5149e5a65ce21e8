"""Redaction of problem details: remove what a refusal tells of resources that the agent may not read."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

from pyoxigraph import NamedNode

from rosld.ontology.urls import Location
from rosld.ontology.violations import Violation
from rosld.server.auth.errors import gone, not_found, withhold_reason
from rosld.server.auth.permissions import Permissions
from rosld.server.http.problem import Problem

_OFFERED_METHODS = frozenset({"allow", "accept-put", "accept-post", "accept-patch"})
"""The fields of a 404 or 410 that say what may be made there."""


def redact_problem(problem: Problem, permissions: Permissions, place: Location | None) -> Problem:
    """Return a problem with what is at `place` as this agent may be told of it.

    A 410 remains one only where the agent may know of whatever might be there. A Location that the agent may not read
    makes it a 404. A reason that speaks of something else that the agent may not read is left out, and so are the IRIs
    of shapes in such documents.
    """
    if permissions.is_unrestricted:
        return problem
    if problem.status in (404, 410):
        return _redact_absence(problem, permissions, place)
    if not all(permissions.may_read(url) or permissions.locate(url) == place for url in problem.about):
        return withhold_reason(problem)
    violations = tuple(_redact_violation(each, permissions) for each in problem.violations)
    if violations != problem.violations:
        problem = copy(problem)  # others may be told the same
        problem.violations = violations
    target = problem.headers.get("Location")
    if target is not None and problem.status < 400 and not permissions.may_read(target):
        return not_found()
    return problem


def _redact_violation(violation: Violation, permissions: Permissions) -> Violation:
    shape = violation.shape
    is_hidden = isinstance(shape, NamedNode) and not permissions.may_read(shape.value)
    return replace(violation, shape=None) if is_hidden else violation


def _redact_absence(problem: Problem, permissions: Permissions, place: Location | None) -> Problem:
    if place is None or not permissions.may_know_any_type(place):
        return not_found()
    if permissions.may_read_all:
        return problem
    found = gone() if problem.status == 410 else not_found()
    found.headers |= {name: value for name, value in problem.headers.items() if name.lower() in _OFFERED_METHODS}
    return found
