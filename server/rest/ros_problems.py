"""Mapping of errors of ROS, lifting and lowering to HTTP problems."""

from __future__ import annotations

from rosld.adapters.model import NotFound, Refused, RosError, Sent, TimedOut, UnknownType, Unreachable
from rosld.ontology.body import BodyError, ExpandedBodyError, UnsupportedCharset
from rosld.ontology.triples import date_time_literal
from rosld.ontology.violations import LoweringError
from rosld.server.http.problem import AGENT_SAID, ROBOT_SAID, Problem
from rosld.server.robot.interlock import Stopped, TopicHeld
from rosld.server.runtime.process_memory import NotEnoughMemory

RETRY_AFTER_SECONDS = 2

_STATUS: tuple[tuple[type[RosError], int], ...] = (
    (NotFound, 404),
    (Refused, 422),
    (TimedOut, 504),
    (Unreachable, 503),
    (UnknownType, 404),
    (Stopped, 423),
    (TopicHeld, 409),
)


def problem_of(error: RosError) -> Problem:
    """Return the Problem of a ROS error: its sentence, the robot's text, and whether the robot may have acted."""
    status = next((status for kind, status in _STATUS if isinstance(error, kind)), 502)
    extra: dict[str, object] = {"sent": error.sent.value}
    about = error.about
    if error.words is not None:
        extra[ROBOT_SAID] = error.words
    match error:
        case Stopped(stop_state=stop_state):
            since = date_time_literal(stop_state.since_ns)
            extra |= {
                "stoppedBy": stop_state.stopped_by,
                "since": since.value if since else None,
            }
            if stop_state.reason is not None:
                extra[AGENT_SAID] = stop_state.reason
            about += () if stop_state.url is None else (stop_state.url,)
        case TopicHeld(holder=holder):
            extra |= {"holder": holder.name, "hold": holder.hold}
            about += (holder.hold,)
    headers = {"Retry-After": str(RETRY_AFTER_SECONDS)} if status == 503 and error.sent is Sent.NO else {}
    return Problem(status, error.sentence, title=type(error).__name__, headers=headers, extra=extra, about=about)


def problem_of_out_of_memory(error: BaseException, *, is_write: bool) -> Problem:
    """Return a 507 for a write that lacks memory, a 503 for anything else."""
    words = str(error) if isinstance(error, NotEnoughMemory) else "The server is low on memory: try again later."
    headers = {"Retry-After": str(RETRY_AFTER_SECONDS)}
    return Problem(507 if is_write else 503, words, headers=headers, extra={"reason": "memory"})


def problem_of_body(error: BodyError | LoweringError) -> Problem:
    """Return a 400 for an unreadable body (413, 415 for its IRIs, its charset), or a 422 with the violations."""
    if isinstance(error, LoweringError):
        return Problem(422, str(error), title="Does not fit", violations=error.violations, about=error.about)
    if isinstance(error, UnsupportedCharset):
        return Problem(415, str(error))
    if isinstance(error, ExpandedBodyError):
        return Problem(413, str(error))
    return Problem(400, str(error), title="Malformed body")
