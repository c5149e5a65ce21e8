"""The parts of a container that a request prefers (LDP 7.2, RFC 7240)."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http import prefer
from rosld.server.rest.prefer_container import ALL_PARTS, ContainerParts, select_parts

LDP = "http://www.w3.org/ns/ldp#"
HINTS = ("PreferContainment", "PreferMembership", "PreferMinimalContainer", "PreferEmptyContainer")


def asked(include: str = "", omit: str = "") -> ContainerParts:
    text = "return=representation"
    for name, hints in (("include", include), ("omit", omit)):
        if hints:
            text += f'; {name}="{" ".join(LDP + hint for hint in hints.split())}"'
    return select_parts(prefer.parse(text))


def held(parts: ContainerParts) -> set[str]:
    return {name for name in ("containment", "membership", "minimal") if getattr(parts, name)}


def test_without_a_preference_everything_is_there_and_nothing_is_said_of_it() -> None:
    for text in (
        None,
        "return=minimal",
        "respond-async",
        f'include="{LDP}PreferMinimalContainer"',
    ):
        parts = select_parts(prefer.parse(text))
        assert parts == ALL_PARTS
        assert parts.preference_applied is None


def test_the_minimal_container_has_neither_members_nor_membership() -> None:
    for hint in (
        "PreferMinimalContainer",
        "PreferEmptyContainer",
    ):
        assert held(asked(include=hint)) == {"minimal"}


def test_hints_choose_the_parts() -> None:
    for include, omit, parts in (
        ("PreferContainment", "", {"containment", "minimal"}),
        ("PreferMembership", "", {"membership", "minimal"}),
        ("PreferMembership PreferContainment", "", {"containment", "membership", "minimal"}),
        ("PreferMinimalContainer PreferMembership", "", {"membership", "minimal"}),
        ("", "PreferContainment", {"membership", "minimal"}),
        ("", "PreferMembership PreferContainment", {"minimal"}),
        ("PreferMinimalContainer PreferCake", "", {"minimal"}),
        ("", "PreferMembership", {"containment", "minimal"}),
        ("", "PreferMinimalContainer", {"containment", "membership"}),
        ("PreferMembership", "PreferMinimalContainer", {"membership"}),
        ("PreferMembership", "PreferContainment", {"membership", "minimal"}),
    ):
        assert held(asked(include, omit)) == parts
        assert asked(include, omit).preference_applied == "return=representation"


def test_a_hint_that_is_included_and_omitted_says_nothing() -> None:
    assert asked("PreferMembership", "PreferMembership").all
    assert held(asked("PreferMembership PreferContainment", "PreferMembership")) == {"containment", "minimal"}


def test_a_hint_may_be_quoted_or_not_and_stand_between_others() -> None:
    assert held(select_parts(prefer.parse(f'wait=5, return="representation"; omit="x {LDP}PreferContainment"'))) == {
        "membership",
        "minimal",
    }


@given(st.lists(st.sampled_from(HINTS)), st.lists(st.sampled_from(HINTS)))
def test_what_differs_has_another_variant_and_only_the_whole_has_none(include: list[str], omit: list[str]) -> None:
    parts = asked(" ".join(include), " ".join(omit))
    assert (parts.variant == "") is parts.all
    assert len(parts.variant) == 3 - len(held(parts))
    assert parts.applied
