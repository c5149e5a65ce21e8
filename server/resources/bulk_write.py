"""Writes of several members of a complex resource: planned together, carried out and reported one by one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from pyoxigraph import Literal, NamedNode
from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.ontology.body import RdfBody, parse_json
from rosld.ontology.lift import LiftSettings
from rosld.ontology.parameters import lower_term, parameter_json
from rosld.ontology.violations import LoweringError, Violation
from rosld.ontology.vocab import rdf
from rosld.server.http.problem import ROBOT_SAID, Problem
from rosld.server.hypermedia.affordance_service import Snapshot
from rosld.server.hypermedia.catalogue import Property, TopicSource
from rosld.server.hypermedia.property_writer import PlannedWrite, WriteOutcome, carry_out
from rosld.server.hypermedia.resource_tree import ComplexPlan, MemberPlan
from rosld.server.hypermedia.value import (
    WHOLE,
    MessageValue,
    Reading,
    field_json,
    plain_json,
    scalar_field,
    value_literal,
)
from rosld.server.hypermedia.value_body import content_from_rdf
from rosld.server.hypermedia.views import ComplexView, Member
from rosld.server.patches.patch import merge_patch
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.preconditions import condition_conflict
from rosld.server.resources.property_writes import plan_property_write
from rosld.server.rest.ros_problems import problem_of
from rosld.server.robot.session import Session
from rosld.server.runtime.dry_run import DryRunEnded


@dataclass(frozen=True, slots=True)
class MemberChange:
    """A member that is to have another value: `content` is what becomes of it, or of the field that it shows."""

    member: MemberPlan
    content: object


def changes_in_json(patch: object, plan: ComplexPlan, view: ComplexView) -> tuple[MemberChange, ...]:
    """The changes that a JSON merge patch asks for (RFC 7396). Raises LoweringError for what is no member."""
    if not isinstance(patch, dict):
        raise LoweringError(Violation("", "expected an object of members and their values"))
    members = {one.name: one for one in plan.members}
    has = ", ".join(members) or "none"
    wrong = [
        Violation(
            name, "a member cannot be removed" if name in members else f"{plan.path} has no such member; it has {has}"
        )
        for name, value in patch.items()
        if name not in members or value is None
    ]
    if wrong:
        raise LoweringError(*wrong)
    before = {one.affordance.name: _present(one) for one in view.members}
    return tuple(MemberChange(members[name], merge_patch(before[name], value)) for name, value in patch.items())


def changes_in_graph(
    body: RdfBody, plan: ComplexPlan, view: ComplexView, lifting: LiftSettings
) -> tuple[MemberChange, ...]:
    """The changes between what is said of the members now and what `body` says. Raises LoweringError."""
    seen = {one.affordance.name: one for one in view.members}
    found = (_member_change(body, one, seen[one.name], view.url, lifting) for one in plan.members)
    return tuple(change for change in found if change is not None)


def _member_change(
    body: RdfBody, plan: MemberPlan, seen: Member, url: str, lifting: LiftSettings
) -> MemberChange | None:
    relation = seen.affordance.predicate
    subject = NamedNode(url if relation else seen.affordance.url)
    predicate = relation or rdf.value
    stated = body.objects(subject, predicate)
    if not stated:
        if not _is_said(seen):
            return None
        raise LoweringError(Violation(plan.name, f"a member cannot be removed: {subject} {predicate} is missing"))
    try:
        content = content_from_rdf(body, subject, predicate, plan.source, lifting)
    except LoweringError as error:
        raise _within(plan.name, error) from error
    same = _says(content, seen) if isinstance(content, Literal) else content == _present(seen)
    return None if same else MemberChange(plan, content)


def _says(stated: Literal, seen: Member) -> bool:
    """Whether a literal says what the value of a member is already: a store gives numbers back in other words."""
    present = _literal(seen)
    if stated == present or present is None:
        return stated == present
    try:
        one, other = lower_term(stated), lower_term(present)
    except LoweringError:
        return False
    return type(one) is type(other) and one == other


def _is_said(member: Member) -> bool:
    """Whether RDF states a value of the member."""
    return (member.field is None and isinstance(member.reading.value, MessageValue)) or _literal(member) is not None


def _literal(member: Member) -> Literal | None:
    """The literal that is the value of a member, None where there is none."""
    value = member.reading.value
    try:
        return None if value is None else value_literal(value, member.field)
    except ValueError:
        return None


def _present(member: Member) -> object:
    """The value of a member as plain JSON, None where there is none."""
    value, field = member.reading.value, member.field
    if value is None:
        return None
    try:
        return parse_json(plain_json(value, WHOLE) if field is None else field_json(value, field))
    except ValueError:
        return None


# The plan


async def plan_changes(
    session: Session, limit_checks: LimitChecks, plan: ComplexPlan, snapshot: Snapshot, changes: Sequence[MemberChange]
) -> tuple[tuple[str, PlannedWrite], ...]:
    """The writes that bring these changes about, with the names of the members that ask for them.

    Everything that can be refused is: a member that must not be written now (409), that nothing writes (409), a value
    that does not fit or breaks a limit (LoweringError). Nothing moves.
    """
    for change in changes:
        condition_conflict(
            session.space, change.member.write_conditions, snapshot, f"{change.member.name} must not be written now"
        )
    writes = []
    broken: list[Violation] = []
    for names, own, content in _by_property(changes, snapshot.readings):
        try:
            writes.append((names, await plan_property_write(session, limit_checks, own, content)))
        except LoweringError as error:
            broken += _within(names, error).violations
        except Problem as problem:
            raise Problem(409, f"{names} cannot be written: {problem.detail}", about=problem.about) from problem
    if broken:
        raise LoweringError(*broken)
    return tuple(writes)


def _by_property(
    changes: Iterable[MemberChange], readings: Mapping[str, Reading]
) -> Iterable[tuple[str, Property, object]]:
    """One content a property: members that show fields of one message change that message together."""
    whole: dict[str, tuple[list[str], Property, object]] = {}
    for change in changes:
        member, own = change.member, change.member.source
        names, _, content = whole.get(own.name, ([], own, None))
        if member.field is not None:
            content = with_field(own, readings[own.name], member.name, member.field, change.content, content)
        else:
            content = change.content
        whole[own.name] = ([*names, member.name], own, content)
    return [(", ".join(names), own, content) for names, own, content in whole.values()]


def with_field(own: Property, reading: Reading, name: str, path: str, value: object, content: object = None) -> object:
    """Return what the property is to be written, of which `name` shows the field at a dotted path.

    `content` is what others of its fields have made of it already, None where none has. Raises a 409 Problem where the
    field is one of several and the others are not known, and LoweringError where there is no such field.
    """
    if _is_whole_value(own, reading, path):
        return value
    if content is None:
        if reading.value is None:
            why = reading.failure or "it has no value yet"
            detail = f"{name} is a field of {reading.name}, which must be known to be changed: {why}."
            raise Problem(409, detail, extra={ROBOT_SAID: reading.words}, about=reading.about)
        content = parse_json(plain_json(reading.value, WHOLE))
    return _replace_field(content, path, value)


def _is_whole_value(own: Property, reading: Reading, path: str) -> bool:
    """Whether a field is all of a message: one of a single scalar is read and written as that (`std_msgs/String`)."""
    if isinstance(reading.value, MessageValue):
        fields = [reading.value.fields]
    else:
        topics = (one for one in (*own.readers, *own.writers) if isinstance(one, TopicSource))
        fields = [topic.schema.type.fields for topic in topics if topic.schema is not None]
    return any((field := scalar_field(each)) is not None and field.name == path for each in fields)


def _replace_field(content: object, path: str, value: object) -> object:
    step, _, rest = path.partition(".")
    if isinstance(content, list) and step.isdecimal() and int(step) < len(content):
        inner = _replace_field(content[int(step)], rest, value) if rest else _plain(value)
        return [*content[: int(step)], inner, *content[int(step) + 1 :]]
    if isinstance(content, dict) and step in content:
        return {**content, step: _replace_field(content[step], rest, value) if rest else _plain(value)}
    raise LoweringError(Violation(path, "there is no such field"))


def _plain(value: object) -> object:
    """A literal as JSON, so that it can stand within a message."""
    return parse_json(parameter_json(lower_term(value))) if isinstance(value, Literal) else value


def _within(name: str, error: LoweringError) -> LoweringError:
    """The same violations, at a member."""
    return LoweringError(*(replace(one, path=f"{name}.{one.path}" if one.path else name) for one in error.violations))


# Carrying it out


async def carry_out_all(session: Session, writes: Sequence[tuple[str, PlannedWrite]]) -> Response:
    """Carry the writes out in their order. The first that fails ends it: the Problem tells what became of each."""
    done: list[dict[str, object]] = []
    for place, (name, write) in enumerate(writes):
        try:
            written = await carry_out(session, write)
        except DryRunEnded:
            continue
        except (RosError, Problem) as error:
            raise _partly(error, name, done, [name for name, _ in writes[place + 1 :]]) from error
        done.append({"name": name, "status": 202 if written is WriteOutcome.UNHEARD else 204})
    return Response(status_code=204)


def _partly(error: RosError | Problem, name: str, done: Sequence[dict[str, object]], left: Iterable[str]) -> Problem:
    problem = problem_of(error) if isinstance(error, RosError) else error
    failed = {"name": name, "status": problem.status, "detail": problem.detail, **problem.said}
    rest = [{"name": each, "status": 424, "detail": "Not attempted."} for each in left]
    problem.extra |= {"members": [*done, failed, *rest]}
    if done or rest:
        said = ", ".join(str(one["name"]) for one in done) or "none"
        problem.detail = f"{name}: {problem.detail.rstrip('.')}. Written before: {said}."
    return problem
