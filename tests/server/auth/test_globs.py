from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.ontology.urls import encode_segment, locate
from rosld.server.auth.globs import Glob, path_at, type_matches

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
        ("/ontology", ["/ontology", "/ontology/types", "/ontology/0.2.0/types"]),
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


def test_globs_over_types() -> None:
    assert type_matches("sensor_msgs/msg/*", "sensor_msgs/msg/Image")
    assert not type_matches("sensor_msgs/msg/*", "std_msgs/msg/String")
