"""The parts of a container that a request prefers: its members, its membership triples, all else (LDP 7.2)."""

from __future__ import annotations

from dataclasses import dataclass

from rosld.ontology.vocab import ldp
from rosld.server.http.negotiation import Preferences, preference_applied

_CONTAINMENT = f"{ldp.iri}PreferContainment"
_MEMBERSHIP = f"{ldp.iri}PreferMembership"
_MINIMAL = f"{ldp.iri}PreferMinimalContainer"
_EMPTY = f"{ldp.iri}PreferEmptyContainer"
"""The name that drafts of LDP had for the minimal container."""
_KNOWN = frozenset({_CONTAINMENT, _MEMBERSHIP, _MINIMAL})


@dataclass(frozen=True, slots=True)
class ContainerParts:
    """What a representation of a container holds. `applied`: a preference chose it, and the answer says so."""

    containment: bool = True
    membership: bool = True
    minimal: bool = True
    applied: bool = False

    @property
    def all(self) -> bool:
        """Whether nothing is left out."""
        return self.containment and self.membership and self.minimal

    @property
    def variant(self) -> str:
        """A short name of what is left out, empty where nothing is: representations that differ need other ETags."""
        held = ((self.containment, "c"), (self.membership, "m"), (self.minimal, "s"))
        return "".join(letter for is_held, letter in held if not is_held)

    @property
    def preference_applied(self) -> str | None:
        """The value of Preference-Applied (RFC 7240 3); None where no preference was."""
        return preference_applied("return=representation") if self.applied else None


ALL_PARTS = ContainerParts()


def select_parts(preferences: Preferences) -> ContainerParts:
    """What `include` and `omit` of return=representation choose (LDP 7.2.2).

    What is omitted is left out. Where something is included, members and membership that are not are left out; what the
    container says beside these comes along unless it is omitted by name, for it says what the membership triples are.
    Hints that contradict each other (7.2.2.3 leaves those open) or are unknown are passed over.
    """
    include, omit = _hints(preferences.include), _hints(preferences.omit)
    include, omit = include - omit, omit - include
    if not include and not omit:
        return ContainerParts(applied=True) if preferences.representation else ALL_PARTS
    return ContainerParts(
        containment=_is_wanted(_CONTAINMENT, include, omit),
        membership=_is_wanted(_MEMBERSHIP, include, omit),
        minimal=_MINIMAL not in omit,
        applied=True,
    )


def _hints(uris: frozenset[str]) -> frozenset[str]:
    return frozenset(_MINIMAL if uri == _EMPTY else uri for uri in uris) & _KNOWN


def _is_wanted(hint: str, include: frozenset[str], omit: frozenset[str]) -> bool:
    return hint in include if include else hint not in omit
