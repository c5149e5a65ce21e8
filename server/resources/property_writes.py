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
    """Return a snapshot of newly read values."""
    return affordances.snapshot(tree, await affordances.read(reads, refresh=True))


def require_writable(affordances: AffordanceService[State], plan: PropertyPlan, snapshot: Snapshot) -> None:
    """Raise a 404 Problem if a property does not exist now, a 409 with the report if conditions forbid a write."""
    affordances.require_exists(plan.exists_when, snapshot.results, plan.source.name)
    condition_conflict(plan.write_conditions, snapshot, f"{plan.source.name} must not be written now")


def require_offered(affordances: AffordanceService[State], plan: ActionPlan, snapshot: Snapshot) -> None:
    """Raise a 404 Problem if an action's resource does not exist now, a 409 with the report if it is not offered."""
    affordances.require_exists(plan.exists_when, snapshot.results, plan.parent)
    condition_conflict(plan.conditions, snapshot, f"{plan.name} is not on offer now")


def condition_conflict(conditions: Sequence[Condition], snapshot: Snapshot, sentence: str) -> None:
    """Raise a 409 Problem with a report if any condition does not hold."""
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
    """Plan a write of a property and check it against the limits. Raises like `plan_write`, and LoweringError."""
    plan = plan_write(limit_checks.session, own, content, defaults=defaults)
    name, value = plan.writer.name, plan.value
    if not isinstance(value, MessageValue):
        await limit_checks.require_parameter(name, value.value)
    else:
        kind = Kind.SERVICE if isinstance(plan.writer, Setter) else Kind.TOPIC
        await limit_checks.require_message(kind, name, value.schema, value.message)
    return plan


def write_response(exchange: Exchange, space: Space, plan: PlannedWrite, written: WriteOutcome) -> Response:
    """Return the response to a completed write: 204, or 202 without a subscriber."""
    name = plan.writer.name
    if written is WriteOutcome.UNHEARD:
        return render(no_subscriber_problem(name), exchange.accept).response()
    if written is WriteOutcome.GOES_ON:
        return goes_on_response(exchange, name, space.topic(name))
    return Response(status_code=204)


class MemberChange(Struct, frozen=True):
    """Change of a member: `content` is the new value of the member, or of the field that it shows."""

    member: MemberPlan
    content: object


def changes_in_json(patch: object, plan: ComplexPlan, view: ComplexView) -> tuple[MemberChange, ...]:
    """Return the changes in a JSON merge patch (RFC 7396). Raises LoweringError for missing or removed members."""
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
    """Return the changes from the current members to those in `body`. Raises LoweringError."""
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
        if not _is_described(seen):
            return None
        raise LoweringError(Violation(plan.name, f"a member cannot be removed: {subject} {predicate} is missing"))
    try:
        content = content_from_rdf(body, subject, predicate, plan.source, lifting)
    except LoweringError as error:
        raise _within(plan.name, error) from error
    same = _says(content, seen) if isinstance(content, Literal) else content == _present(seen)
    return None if same else MemberChange(plan, content)


def _says(stated: Literal, seen: Member) -> bool:
    """Whether a literal equals the value of a member; compares values, because stores rewrite lexical forms."""
    present = _literal(seen)
    if stated == present or present is None:
        return stated == present
    try:
        one, other = lower_term(stated), lower_term(present)
    except LoweringError:
        return False
    return type(one) is type(other) and one == other


def _is_described(member: Member) -> bool:
    """Whether the member has a value in RDF."""
    return (member.field is None and isinstance(member.reading.value, MessageValue)) or _literal(member) is not None


def _literal(member: Member) -> Literal | None:
    """Return the value of a member as a literal, or None if it has none."""
    value = member.reading.value
    try:
        return None if value is None else value_literal(value, member.field)
    except ValueError:
        return None


def _present(member: Member) -> object:
    """Return the value of a member as plain JSON, or None if it has none."""
    value, field = member.reading.value, member.field
    if value is None:
        return None
    try:
        return parse_json(plain_json(value, WHOLE) if field is None else field_json(value, field))
    except ValueError:
        return None


# Planning


async def plan_changes(
    limit_checks: LimitChecks, snapshot: Snapshot, changes: Sequence[MemberChange]
) -> tuple[tuple[str, PlannedWrite], ...]:
    """Return the writes for these changes, with the names of the changed members; sends nothing to the robot.

    Raises a 409 Problem for a member that is not writable (now), and LoweringError for a value that does not fit or
    violates a limit.
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
    """Return the new content of each property; changes of several fields of one message are combined."""
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
    """Whether a field is the only (scalar) field of its message, which is then the value (`std_msgs/String`)."""
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
    """Return a literal as plain JSON, and other values unchanged."""
    return parse_json(parameter_json(lower_term(value))) if isinstance(value, Literal) else value


def _within(name: str, error: LoweringError) -> LoweringError:
    """Return the error with its paths prefixed by a member."""
    return LoweringError(*(replace(one, path=f"{name}.{one.path}" if one.path else name) for one in error.violations))


# Execution


async def carry_out_all(session: Session, writes: Sequence[tuple[str, PlannedWrite]]) -> Response:
    """Carry out the writes in order. The first failure stops: its Problem lists the outcome of each write."""
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
        names = ", ".join(str(one["name"]) for one in done) or "none"
        problem.detail = f"{name}: {problem.detail.rstrip('.')}. Written before: {names}."
    return problem
