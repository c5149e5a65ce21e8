"""What a snapshot of the source changes in the target: pure functions of what it says and what the target holds."""

from __future__ import annotations

from collections.abc import Callable, Container, Hashable, Iterator, Mapping
from typing import NamedTuple

from rosld.server.sparql.graph_rendering import INLINE
from rosld.server.sparql.graph_source import GraphEntry, Snapshot
from rosld.server.sparql.sync_target import HeldGraph, TargetState


class GraphChange(NamedTuple):
    """What becomes of one graph: `entry` is None where it goes. `size` is the number of characters it had."""

    entry: GraphEntry | None
    description: Hashable
    has_values: bool
    size: int


def find_changes(snapshot: Snapshot, state: TargetState, pinned: Container[str]) -> dict[str, GraphChange]:
    """What the target must be sent to hold what a snapshot says, by graph. Nothing newer than that is touched.

    Extras that are `pinned` by queries that are about to begin do not go.
    """
    changes: dict[str, GraphChange] = {}
    if snapshot.revision != state.descriptions:
        changes.update(_changed_descriptions(snapshot, state))
    changes.update(_vanished_graphs(snapshot, state, pinned))
    for entry in snapshot.entries:
        description = snapshot.described[entry.iri].token if entry.iri in snapshot.described else None
        held = state.held.get(entry.iri)
        if held is None or (held.token, held.description, held.has_values) != (entry.token, description, True):
            if held is None or held.snapshot < snapshot.number:
                changes[entry.iri] = GraphChange(entry, description, True, _size(held))
        else:
            changes.pop(entry.iri, None)
    return changes


def _changed_descriptions(snapshot: Snapshot, state: TargetState) -> Iterator[tuple[str, GraphChange]]:
    for iri, entry in snapshot.described.items():
        held = state.held.get(iri)
        if held is None or (held.description != entry.token and held.snapshot < snapshot.number):
            yield iri, GraphChange(entry, entry.token, False, _size(held))
    for iri, held in state.held.items():
        if iri not in snapshot.described and iri not in state.extras and held.snapshot < snapshot.number:
            yield iri, GraphChange(None, None, False, 0)


def _vanished_graphs(
    snapshot: Snapshot, state: TargetState, pinned: Container[str]
) -> Iterator[tuple[str, GraphChange]]:
    """What was there for an earlier query only, and values that a look at everything no longer finds."""
    if not state.extras and not snapshot.needs.is_everything:
        return
    found = {entry.iri for entry in snapshot.entries}
    for iri in state.extras - found:
        if iri not in pinned and state.held[iri].snapshot < snapshot.number:
            entry = snapshot.described.get(iri)
            yield iri, GraphChange(entry, entry and entry.token, False, 0)
    if snapshot.needs.is_everything and snapshot.has_values:
        for iri in state.live - found - state.extras:
            entry = snapshot.described.get(iri)
            if entry is not None and state.held[iri].snapshot < snapshot.number:
                yield iri, GraphChange(entry, entry.token, False, state.held[iri].size)


def without_pinned(
    changes: Mapping[str, GraphChange], state: TargetState, pinned: Container[str]
) -> dict[str, GraphChange]:
    """The changes but those that take away an extra that was pinned after they were found."""
    return {
        iri: change
        for iri, change in changes.items()
        if change.has_values or iri not in pinned or iri not in state.extras
    }


def note_changes(
    changes: Mapping[str, GraphChange], snapshot: Snapshot, sizes: Mapping[str, int], state: TargetState
) -> None:
    """Note in the state that the target was sent these changes; `sizes` are in characters, by graph."""
    for iri, change in changes.items():
        _note_change(iri, change, snapshot, sizes[iri], state)
    state.descriptions = snapshot.revision


def _note_change(iri: str, change: GraphChange, snapshot: Snapshot, size: int, state: TargetState) -> None:
    state.live.discard(iri)
    state.extras.discard(iri)
    if change.entry is None:
        state.held.pop(iri, None)
        return
    state.held[iri] = HeldGraph(change.entry.token, change.description, change.has_values, snapshot.number, size)
    if change.has_values:
        state.live.add(iri)
        if change.entry.is_transient or iri not in snapshot.described:
            state.extras.add(iri)


def is_small(changes: Mapping[str, GraphChange]) -> bool:
    """Whether the changed graphs are rendered on the loop: by what they were like before."""
    return not changes or sum(change.size for change in changes.values()) <= INLINE


def renderings(changes: Mapping[str, GraphChange]) -> dict[str, Callable[[], str] | None]:
    """What renders each changed graph, None for one that goes."""
    return {iri: None if change.entry is None else change.entry.ntriples for iri, change in changes.items()}


def _size(held: HeldGraph | None) -> int:
    """How large its graph was; one that is not known yet counts as large."""
    return INLINE + 1 if held is None else held.size
