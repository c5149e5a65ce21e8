"""Preconditions of writes: the conditions of mappings, evaluated on values that are read again before the write."""

from __future__ import annotations

from collections.abc import Sequence

from rosld.ontology.urls import Space
from rosld.ontology.violations import Violation, violations_text
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService, Snapshot
from rosld.server.hypermedia.catalogue import Property
from rosld.server.hypermedia.mapping import Condition
from rosld.server.hypermedia.resource_tree import ActionPlan, PropertyPlan, ResourceTree
from rosld.server.rest.state import State
from rosld.server.runtime.dry_run import note_conditions


async def read_fresh_state(
    affordances: AffordanceService[State], tree: ResourceTree, reads: Sequence[Property]
) -> Snapshot:
    """The state as it is now, not as it was a moment ago."""
    return affordances.snapshot(tree, await affordances.read(reads, refresh=True))


def require_writable(
    space: Space, affordances: AffordanceService[State], plan: PropertyPlan, snapshot: Snapshot
) -> None:
    """Raise a 404 Problem where a property is not there now, a 409 with the report where it must not be written."""
    affordances.require_exists(plan.exists_when, snapshot.results, plan.source.name)
    condition_conflict(space, plan.write_conditions, snapshot, f"{plan.source.name} must not be written now")


def require_offered(space: Space, affordances: AffordanceService[State], plan: ActionPlan, snapshot: Snapshot) -> None:
    """Raise a 404 Problem where what an action belongs to is not there, a 409 with the report if it is not offered."""
    affordances.require_exists(plan.exists_when, snapshot.results, plan.parent)
    condition_conflict(space, plan.conditions, snapshot, f"{plan.name} is not on offer now")


def condition_conflict(space: Space, conditions: Sequence[Condition], snapshot: Snapshot, sentence: str) -> None:
    """Raise a 409 Problem with the report of the conditions that do not hold."""
    note_conditions(condition.iri for condition in conditions)
    broken: tuple[Violation, ...] = snapshot.results.violations(conditions)
    if broken:
        about = snapshot.results.about(conditions)
        raise Problem(
            409, f"{sentence}: {violations_text(broken)}.", title="Not on offer now", violations=broken, about=about
        )
