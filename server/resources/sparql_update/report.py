"""Outcome of an update, graph by graph."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from http import HTTPStatus

import orjson
from msgspec import Struct
from starlette.responses import Response

from rosld.adapters.model import RosError, Sent
from rosld.ontology.body import BodyError
from rosld.ontology.violations import LoweringError
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.redaction import redact_problem
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import members
from rosld.server.rest.responses import no_content
from rosld.server.rest.ros_problems import problem_of, problem_of_body


class Outcome(Enum):
    """Outcome of the write of one graph."""

    DONE = "done"
    UNHEARD = "unheard"
    """The message was published without any subscriber."""
    FAILED = "failed"
    """The write was not done."""
    UNKNOWN = "unknown"
    """The write may have been done."""
    LEFT = "not attempted"


class ReportEntry(Struct, frozen=True):
    """Entry of a report for one graph: description of the write, its outcome, and the reason for a failure."""

    graph: str
    description: str
    outcome: Outcome
    reason: Problem | None = None

    @property
    def members(self) -> dict[str, object]:
        """Return the entry as JSON members."""
        found: dict[str, object] = {"graph": self.graph, "does": self.description, "outcome": self.outcome.value}
        if self.reason is not None:
            found |= {"status": self.reason.status, "detail": self.reason.detail, **self.reason.quoted_members}
        return found


def report_response(entries: Sequence[ReportEntry]) -> Response:
    """Return the response to a completed update: 204, or 202 with a JSON report if any message had no subscriber."""
    if not any(entry.outcome is Outcome.UNHEARD for entry in entries):
        return no_content()
    body = orjson.dumps({"graphs": [entry.members for entry in entries]}, option=orjson.OPT_INDENT_2)
    return Response(body, HTTPStatus.ACCEPTED, {"Cache-Control": "no-store"}, "application/json")


class RefusedGraphs(Problem):
    """Problem of an update refused because of `graphs`, with the status of the first reason; nothing was done."""

    def __init__(self, reasons: Sequence[tuple[str, Problem]]) -> None:
        self.graphs = frozenset(name for name, _ in reasons)
        graph, problem = reasons[0]
        detail = f"<{graph}>: {problem.detail.rstrip('.')}."
        if reasons[1:]:
            detail += f" Other graphs are refused too: {len(reasons) - 1}."
        entries = [{"graph": name, **members(each)} for name, each in reasons]
        super().__init__(
            problem.status,
            f"{detail} Nothing was done.",
            title=problem.title,
            headers=_retry_after(problem),
            extra={**problem.extra, "graphs": entries},
            violations=problem.violations,
        )


def partial_failure(entries: Sequence[ReportEntry]) -> Problem:
    """Return the Problem of an update that failed part-way, with the outcome of each graph."""
    failed = next(entry for entry in entries if entry.reason is not None)
    assert failed.reason is not None
    by_fate = {
        fate: ", ".join(f"<{entry.graph}>" for entry in entries if entry.outcome in fates)
        for fate, fates in (
            ("Done", (Outcome.DONE, Outcome.UNHEARD)),
            ("unknown", (Outcome.UNKNOWN,)),
            ("not done", (Outcome.FAILED, Outcome.LEFT)),
        )
    }
    summary = "; ".join(f"{fate}: {graphs or 'none'}" for fate, graphs in by_fate.items())
    return Problem(
        failed.reason.status,
        f"<{failed.graph}>: {failed.reason.detail.rstrip('.')}. {summary}.",
        title=failed.reason.title,
        headers=_retry_after(failed.reason),
        extra={**failed.reason.extra, "graphs": [entry.members for entry in entries]},
    )


def _retry_after(problem: Problem) -> dict[str, str]:
    return {name: value for name, value in problem.headers.items() if name == "Retry-After"}


def failed_outcome(error: RosError | Problem) -> Outcome:
    """Return the outcome of a write that raised this error."""
    sent = error.sent.value if isinstance(error, RosError) else error.extra.get("sent")
    return Outcome.UNKNOWN if sent == Sent.MAYBE.value else Outcome.FAILED


def reason(error: Problem | LoweringError | BodyError | RosError, permissions: Permissions, graph: str) -> Problem:
    """Return the Problem of a graph that cannot be updated, without details that the agent may not see."""
    if isinstance(error, RosError):
        problem = problem_of(error)
    elif isinstance(error, LoweringError | BodyError):
        problem = problem_of_body(error)
    else:
        problem = Problem(403, error.detail, about=error.about) if error.status == 405 else error
    return redact_problem(problem, permissions, permissions.locate(graph))
