"""Refusals of a resource as problem details, with links to what it is and to what constrains it."""

from __future__ import annotations

from rosld.adapters.model import RosError
from rosld.ontology.body import BodyError
from rosld.ontology.violations import LoweringError
from rosld.server.http.fields import Link, render_links
from rosld.server.http.problem import Problem
from rosld.server.rest.resource import LDP, Resource
from rosld.server.rest.ros_problems import problem_of, problem_of_body

_REFUSED_BODIES = frozenset({400, 409, 415, 422})


def problem_of_error(error: BodyError | LoweringError | RosError | Problem) -> Problem:
    """The problem details (RFC 9457) of an error that a resource raises."""
    if isinstance(error, Problem):
        return error
    return problem_of(error) if isinstance(error, RosError) else problem_of_body(error)


def with_constraint_link(resource: Resource, error: BodyError | LoweringError | Problem) -> Problem:
    """The refusal of a body, with a link to what constrains it (LDP 4.2.1.6)."""
    problem = error if isinstance(error, Problem) else problem_of_body(error)
    if problem.status in _REFUSED_BODIES and resource.constrained_by is not None:
        problem.headers["Link"] = render_links([Link(resource.constrained_by, f"{LDP}constrainedBy")])
    return problem


def with_type_links(resource: Resource, problem: Problem) -> Problem:
    """A refusal, with links to the types of the resource that refuses; what is not there has none."""
    if problem.status not in (404, 410) and resource.links:
        there = problem.headers.get("Link")
        problem.headers["Link"] = ", ".join([render_links(resource.links), *([there] if there else ())])
    return problem
