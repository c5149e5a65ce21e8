"""Writes of properties: planned, checked against limits and conditions, carried out, and reported.

Several members of a complex resource are planned together, and carried out and reported one by one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import Literal, NamedNode
from starlette.responses import Response

from rosld.adapters.model import Kind, RosError
from rosld.ontology.body import RdfBody, parse_json
from rosld.ontology.lift import LiftSettings
from rosld.ontology.parameters import lower_term, parameter_json
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError, Violation, violations_text
from rosld.ontology.vocab import rdf
from rosld.server.http.problem import ROBOT_SAID, Problem
from rosld.server.http.problem_details import render
from rosld.server.hypermedia.affordance_service import AffordanceService, Snapshot
from rosld.server.hypermedia.catalogue import Property, Setter, TopicSource
from rosld.server.hypermedia.mapping import Condition
from rosld.server.hypermedia.property_writer import PlannedWrite, WriteOutcome, carry_out, plan_write
from rosld.server.hypermedia.resource_tree import ActionPlan, ComplexPlan, MemberPlan, PropertyPlan, ResourceTree
from rosld.server.hypermedia.value import (
    WHOLE,
    MessageValue,
    Reading,
    content_from_rdf,
    field_json,
    plain_json,
    scalar_field,
    value_literal,
)
from rosld.server.hypermedia.views import ComplexView, Member
from rosld.server.patches.patch import merge_patch
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.publisher import goes_on_response
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State
from rosld.server.robot.publication import no_subscriber_problem
from rosld.server.robot.session import Session
from rosld.server.runtime.dry_run import DryRunEnded, note_conditions


async def read_fresh_state(
    affordances: AffordanceService[State], tree: ResourceTree, reads: Sequence[Property]
) -> Snapshot:
    """Return the state as it is now, not as it was a moment ago."""
    return affordances.snapshot(tree, await affordances.read(reads, refresh=True))


def require_writable(affordances: AffordanceService[State], plan: PropertyPlan, snapshot: Snapshot) -> None:
    """Raise a 404 Problem where a property is not there now, a 409 with the report where it must not be written."""
    affordances.require_exists(plan.exists_when, snapshot.results, plan.source.name)
    condition_conflict(plan.write_conditions, snapshot, f"{plan.source.name} must not be written now")


def require_offered(affordances: AffordanceService[State], plan: ActionPlan, snapshot: Snapshot) -> None:
    """Raise a 404 Problem where what an action belongs to is not there, a 409 with the report if it is not offered."""
    affordances.require_exists(plan.exists_when, snapshot.results, plan.parent)
    condition_conflict(plan.conditions, snapshot, f"{plan.name} is not on offer now")


def condition_conflict(conditions: Sequence[Condition], snapshot: Snapshot, sentence: str) -> None:
    """Raise a 409 Problem with the report of the conditions that do not hold."""
    note_conditions(condition.iri for condition in conditions)
    broken: tuple[Violation, ...] = snapshot.results.violations(conditions)
    if broken:
        about = snapshot.results.about(conditions)
        raise Problem(
            409, f"{sentence}: {violations_text(broken)}.", title="Not on offer now", violations=broken, about=about
        )


async def plan_property_write(
    limit_checks: LimitChecks, own: Property, content: object, *, defaults: bool = False
) -> PlannedWrite:
    """Plan a write of a property within the limits. Raises as `plan_write` does."""
    plan = plan_write(limit_checks.session, own, content, defaults=defaults)
    name, value = plan.writer.name, plan.value
    if not isinstance(value, MessageValue):
        await limit_checks.require_parameter(name, value.value)
    else:
        kind = Kind.SERVICE if isinstance(plan.writer, Setter) else Kind.TOPIC
        await limit_checks.require_message(kind, name, value.schema, value.message)
    return plan


def write_response(exchange: Exchange, space: Space, plan: PlannedWrite, written: WriteOutcome) -> Response:
    """Return the response to a write that was carried out: 204, or 202 without a receiver."""
    name = plan.writer.name
    if written is WriteOutcome.UNHEARD:
        return render(no_subscriber_problem(name), exchange.accept).response()
    if written is WriteOutcome.GOES_ON:
        return goes_on_response(exchange, name, space.topic(name))
    return Response(status_code=204)


class MemberChange(Struct, frozen=True):
    """A member that is to have another value: `content` is what becomes of it, or of the field that it shows."""

    member: MemberPlan
    content: object


def changes_in_json(patch: object, plan: ComplexPlan, view: ComplexView) -> tuple[MemberChange, ...]:
    """Return the changes that a JSON merge patch asks for (RFC 7396). Raises LoweringError for what is no member."""
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
    """Return the changes between what is said of the members now and what `body` says. Raises LoweringError."""
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
    """Return the literal that is the value of a member, None where there is none."""
    value = member.reading.value
    try:
        return None if value is None else value_literal(value, member.field)
    except ValueError:
        return None


def _present(member: Member) -> object:
    """Return the value of a member as plain JSON, None where there is none."""
    value, field = member.reading.value, member.field
    if value is None:
        return None
    try:
        return parse_json(plain_json(value, WHOLE) if field is None else field_json(value, field))
    except ValueError:
        return None


# The plan


async def plan_changes(
    limit_checks: LimitChecks, plan: ComplexPlan, snapshot: Snapshot, changes: Sequence[MemberChange]
) -> tuple[tuple[str, PlannedWrite], ...]:
    """Return the writes that bring these changes about, with the names of the members that ask for them.

    Everything that can be refused is: a member that must not be written now (409), that nothing writes (409), a value
    that does not fit or breaks a limit (LoweringError). Nothing moves.
    """
    for change in changes:
        condition_conflict(change.member.write_conditions, snapshot, f"{change.member.name} must not be written now")
    writes = []
    broken: list[Violation] = []
    for names, own, content in _by_property(changes, snapshot.readings):
        try:
            writes.append((names, await plan_property_write(limit_checks, own, content)))
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
    """Return the value of a property with one field, named `name`, set to a value.

    `content` is the value with other fields set already, or None. Raises a 409 Problem if other fields are unknown, and
    LoweringError if there is no such field.
    """
    if _is_whole_value(own, reading, path):
        return value
    if content is None:
        if reading.value is None:
            why = reading.failure or "it has no value yet"
            detail = f"{name} is a field of {reading.name}, whose value must be known to change it: {why}."
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
    """Return a literal as JSON, for use in a message."""
    return parse_json(parameter_json(lower_term(value))) if isinstance(value, Literal) else value


def _within(name: str, error: LoweringError) -> LoweringError:
    """Return the same violations, at a member."""
    return LoweringError(*(replace(one, path=f"{name}.{one.path}" if one.path else name) for one in error.violations))


# Carrying it out


async def carry_out_all(session: Session, writes: Sequence[tuple[str, PlannedWrite]]) -> Response:
    """Carry the writes out in order. The first failure ends this: its Problem has the outcome of each."""
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
    failed = {"name": name, "status": problem.status, "detail": problem.detail, **problem.quoted_members}
    rest = [{"name": each, "status": 424, "detail": "Not attempted."} for each in left]
    problem.extra |= {"members": [*done, failed, *rest]}
    if done or rest:
        said = ", ".join(str(one["name"]) for one in done) or "none"
        problem.detail = f"{name}: {problem.detail.rstrip('.')}. Written before: {said}."
    return problem
