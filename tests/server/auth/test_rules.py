"""Access rules and their globs."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.ontology.urls import encode_segment, locate
from rosld.server.auth.rules import (
    ANONYMOUS,
    AUTHENTICATED,
    Agent,
    Glob,
    Mode,
    Policy,
    Rights,
    Rule,
    allow_all_rules,
    mode_of,
    path_at,
)

_segments = st.lists(st.text(st.characters(blacklist_categories=("Cs",)), max_size=5), min_size=1, max_size=5)


def at(path: str) -> tuple[str, ...]:
    return path_at(locate(path))


def test_a_glob_is_about_these_paths() -> None:
    for glob, paths in (
        ("/**", ["/", "/topics", "/topics/", "/topics/a/b/"]),
        ("/topics/**", ["/topics", "/topics/", "/topics/a", "/topics/a/b/c/"]),
        ("/topics/*", ["/topics/a", "/topics/a/"]),
        ("/topics/*/image", ["/topics/camera/image"]),
        ("/topics/**/image", ["/topics/image", "/topics/a/image", "/topics/a/b/image"]),
        ("/topics/front_*", ["/topics/front_", "/topics/front_left"]),
        ("/topics/caf%C3%A9", ["/topics/caf%C3%A9", "/topics/caf%c3%a9"]),
        ("/topics/café", ["/topics/caf%C3%A9"]),
        ("/", ["/"]),
        ("/ontology", ["/ontology", "/ontology/types", "/ontology/types/none"]),
    ):
        assert all(Glob(glob).matches(at(path)) for path in paths)


def test_a_glob_is_not_about_these_paths() -> None:
    for glob, paths in (
        ("/topics/*", ["/topics", "/topics/a/b", "/Topics/a", "/services/a"]),
        ("/topics/a/b", ["/topics/a%2Fb", "/topics/a", "/topics/a/b/c", "/topics/a/B"]),
        ("/topics/**/image", ["/topics/images", "/topics/a/image/raw"]),
        ("/topics/a", ["/topics/\u0430", "/topics/%61b", "/topics/a/~"]),
        ("/", ["/topics"]),
        ("/ontology/types", ["/ontology", "/ontology/core", "/ontology/types/a"]),
    ):
        quoted = [
            "/" + "/".join(part if "%" in part else encode_segment(part) for part in p[1:].split("/")) for p in paths
        ]
        assert not any(Glob(glob).matches(at(path)) for path in quoted)


def test_what_is_no_glob_is_refused_with_its_text() -> None:
    for glob in ("topics/**", "/topics/a**", "/a?b", "/a#b", "/a b", "/a//b", "/%zz", "/a/../b", "/[a]"):
        with pytest.raises(ValueError, match=re.escape(repr(glob))):
            Glob(glob)


@given(_segments, _segments)
def test_a_name_is_matched_by_its_own_glob_alone_however_it_is_encoded(segments: list[str], other: list[str]) -> None:
    spelt = "/topics/" + "/".join(map(encode_segment, segments))
    loud = "/topics/" + "/".join(
        encode_segment(each)
        if encode_segment(each).startswith("~")
        else "".join(f"%{byte:02x}" for byte in each.encode())
        for each in segments
    )
    assert at(spelt) == at(loud)
    glob = Glob(spelt.replace("*", "%2A"))
    assert glob.matches(at(loud))
    assert glob.matches(("topics", *other)) == (segments == other)
    assert Glob("/topics/**").matches(at(loud))


@given(st.lists(st.sampled_from(["a", "b"]), max_size=4), st.lists(st.sampled_from(["a", "b", "*", "**"]), max_size=4))
def test_what_covers_below_is_about_everything_below_and_what_is_not_reached_is_about_nothing(
    path: list[str], parts: list[str]
) -> None:
    glob, below = Glob("/" + "/".join(parts)), tuple(path)
    deeper = [below, (*below, "a"), (*below, "b", "c"), (*below, "a", "a", "a")]
    if glob.covers_subtree(below):
        assert all(map(glob.matches, deeper))
    if any(map(glob.matches, deeper)):
        assert glob.overlaps_subtree(below)


ANNA = Agent("anna", "https://anna.example/#me")
IMAGE, TWIST = frozenset({"sensor_msgs/msg/Image"}), frozenset({"geometry_msgs/msg/Twist"})


def rule(
    *globs: str, agents: str = "anna", modes: str = "read", types: tuple[str, ...] = (), deny: bool = False
) -> Rule:
    return Rule(frozenset(agents.split()), frozenset(map(Mode, modes.split())), tuple(map(Glob, globs)), types, deny)


def rights(*rules: Rule, agent: Agent = ANNA) -> Rights:
    return Policy(rules).rights_of(agent)


def test_rules_are_about_names_webids_everybody_and_those_who_are_known() -> None:
    assert not rights().may(Mode.READ, ())
    assert not rights().may_know(("topics",))
    assert Policy(allow_all_rules()).rights_of(ANONYMOUS).is_unrestricted
    for name in ("anna", "https://anna.example/#me", "anybody", AUTHENTICATED):
        assert rights(rule("/**", agents=name)).may(Mode.READ, ("topics",)), name
    assert not rights(rule("/**", agents="bert")).may(Mode.READ, ("topics",))
    assert not rights(rule("/**", agents=AUTHENTICATED), agent=ANONYMOUS).may(Mode.READ, ("topics",))
    assert not rights(rule("/**", agents="anna"), agent=ANONYMOUS).may(Mode.READ, ("topics",))


_rules = st.builds(
    rule,
    st.sampled_from(["/**", "/topics/**", "/topics/a", "/topics/*", "/services/**", "/topics/a/**"]),
    modes=st.sampled_from(["read", "control", "read control", "write"]),
    types=st.sampled_from([(), ("sensor_msgs/*",)]),
    deny=st.booleans(),
)
_paths = st.sampled_from([(), ("topics",), ("topics", "a"), ("topics", "a", "b"), ("topics", "b"), ("services", "a")])


@given(
    st.lists(_rules, max_size=5), _paths, st.sampled_from(list(Mode)), st.sampled_from([frozenset[str](), IMAGE, TWIST])
)
def test_what_one_rule_denies_no_other_allows_in_whatever_order(
    rules: list[Rule], path: tuple[str, ...], mode: Mode, types: frozenset[str]
) -> None:
    found = rights(*rules)
    said = [one.deny for one in rules if one.covers(mode, path, types)]
    assert found.may(mode, path, types) == (False in said and True not in said)
    assert rights(*reversed(rules)).may(mode, path, types) == found.may(mode, path, types)
    denial = rule("/**", modes=mode.value, deny=True)
    assert not rights(*rules, denial).may(mode, path, types)


@given(
    st.lists(_rules, max_size=4), _paths, st.sampled_from(list(Mode)), st.sampled_from([frozenset[str](), IMAGE, TWIST])
)
def test_what_the_path_alone_forbids_is_forbidden_whatever_is_there(
    rules: list[Rule], path: tuple[str, ...], mode: Mode, types: frozenset[str]
) -> None:
    found = rights(*rules)
    if not found.may(mode, path, None):
        assert not found.may(mode, path, types)


@given(st.lists(_rules, max_size=4), _paths, st.sampled_from(list(Mode)), _paths, st.sampled_from([IMAGE, TWIST]))
def test_a_right_to_all_below_is_a_right_to_each_thing_below(
    rules: list[Rule], path: tuple[str, ...], mode: Mode, inner: tuple[str, ...], types: frozenset[str]
) -> None:
    found = rights(*rules)
    if found.may_subtree(mode, path):
        assert found.may(mode, (*path, *inner), types)


def test_rules_about_types_are_about_what_is_of_such_types_alone() -> None:
    only = rights(rule("/topics/**", types=("sensor_msgs/*",)))
    assert only.may(Mode.READ, ("topics", "a"), IMAGE)
    assert not only.may(Mode.READ, ("topics", "a"), TWIST)
    assert not only.may(Mode.READ, ("topics", "a"))
    but = rights(rule("/topics/**"), rule("/topics/**", types=("sensor_msgs/*",), deny=True))
    assert not but.may(Mode.READ, ("topics", "a"), IMAGE)
    assert not but.may(Mode.READ, ("topics", "a"), IMAGE | TWIST)
    assert but.may(Mode.READ, ("topics", "a"), TWIST)


def test_agents_with_the_same_rules_share_the_name_of_their_rights_and_others_do_not() -> None:
    one, two = rule("/a", agents="anna bert"), rule("/b", agents="anna bert")
    assert rights(one, two).key == rights(two, one, agent=Agent("bert")).key
    assert rights(one).key != rights(two).key


def test_what_a_request_does() -> None:
    assert mode_of("PUT", ("topics", "a")) is Mode.CONTROL
    assert mode_of("POST", ("services", "a")) is Mode.CONTROL
    assert mode_of("PUT", ("data", "a")) is Mode.WRITE
    assert mode_of("DELETE", ("parameters", "a")) is Mode.WRITE
    assert mode_of("POST", ("stop",)) is Mode.CONTROL
    assert mode_of("DELETE", ("stop",)) is Mode.ADMINISTER
    assert mode_of("GET", ("acl",)) is Mode.ADMINISTER
    assert mode_of("POST", ("sparql",)) is Mode.READ
    assert mode_of("HEAD", ()) is Mode.READ
