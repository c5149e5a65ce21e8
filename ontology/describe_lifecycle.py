"""Lifecycles described: the state of a managed node, and the transitions that are on offer now."""

from __future__ import annotations

from collections.abc import Mapping

from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Lifecycle, LifecycleState
from rosld.ontology.affordances import BODIES, forms
from rosld.ontology.triples import Statement, integer, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, ros, sh, td, xsd

_STATES: Mapping[int, NamedNode] = {
    1: ros.Unconfigured,
    2: ros.Inactive,
    3: ros.Active,
    4: ros.Finalized,
    10: ros.Configuring,
    11: ros.CleaningUp,
    12: ros.ShuttingDown,
    13: ros.Activating,
    14: ros.Deactivating,
    15: ros.ErrorProcessing,
}
"""The states of lifecycle_msgs/msg/State that have a meaning."""


def lifecycle_statements(lifecycle: Lifecycle) -> tuple[Statement, ...]:
    """What is said of a managed node itself."""
    state = lifecycle.state
    return (
        (ros.lifecycleState, None if state is None else _STATES.get(state.id)),
        (ros.lifecycleStateWord, None if state is None else text(state.label)),
        (ros.lifecycleUnknown, text(lifecycle.unknown)),
    )


def transition_triples(node: str, lifecycle: Lifecycle, space: Space) -> list[Triple]:
    """An affordance of the node at a URL for each transition that is legal now: what to send, and how."""
    subject = NamedNode(node)
    triples: list[Triple] = []
    for transition in lifecycle.transitions:
        affordance = NamedNode(space.fragment(node, "transitions", transition.label))
        shape, path = (NamedNode(f"{affordance.value}/{part}") for part in ("shape", "shape/transition"))
        label = text(transition.label)
        triples += [
            Triple(subject, td.hasActionAffordance, affordance),
            *triples_about(
                affordance,
                (rdf.type, td.ActionAffordance),
                (td.name, label),
                *_goal(transition.goal),
                (ros.shape, shape),
            ),
            *forms(affordance, "invoke", "POST", td.invokeAction, node, BODIES),
            *triples_about(shape, (rdf.type, sh.NodeShape), (sh.property, path)),
            *triples_about(
                path,
                (sh.path, ros.transition),
                (sh.datatype, xsd.string),
                (sh.hasValue, label),
                (sh.minCount, integer(1)),
                (sh.maxCount, integer(1)),
            ),
        ]
    return triples


def _goal(state: LifecycleState) -> tuple[Statement, ...]:
    return ((ros.targetState, _STATES.get(state.id)), (ros.targetStateWord, text(state.label)))
