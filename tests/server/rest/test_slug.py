"""Names of new members (LDP 5.2.3.10, 5.2.3.11, RFC 5023 9.7)."""

from __future__ import annotations

import unicodedata
from urllib.parse import quote

from hypothesis import example, given
from hypothesis import strategies as st

from rosld.ontology.urls import decode_segment, encode_segment
from rosld.server.rest.interaction import MAX_LENGTH, choose_name


def free(_: str) -> bool:
    return False


def test_what_can_be_read_of_a_slug_is_the_name() -> None:
    for slug, name in (
        ("kitchen", "kitchen"),
        ("The Beach at Rügen".encode().decode("latin-1"), "The-Beach-at-Rügen"),
        ("The%20Beach%20at%20R%C3%BCgen", "The-Beach-at-Rügen"),
        ("%E5%8F%B0%E6%89%80", "台所"),
        ("u%CC%88ber", "über"),
        ("map.2026-11-21.ttl", "map.2026-11-21.ttl"),
        ("a_b-c.d", "a_b-c.d"),
        ("100%", "100"),
        ("50%zz", "50-zz"),
        ("bad%FFbytes", "bad-bytes"),
        ("a\tb\r\nc", "a-b-c"),
        ("_draft", "_draft"),
        ("x?y#z", "x-y-z"),
    ):
        assert choose_name(slug, free) == name


def test_what_would_be_dangerous_or_misleading_is_not_in_the_name() -> None:
    for slug, name in (
        ("../../etc/passwd", "etc-passwd"),
        ("..%2F..%2Fetc", "etc"),
        ("a/b", "a-b"),
        ("a%2Fb", "a-b"),
        ("a\\b", "a-b"),
        (".htaccess", "htaccess"),
        ("a%00b", "a-b"),
        ("rtl%E2%80%AEgnp.exe", "rtl-gnp.exe"),
        ("zero%E2%80%8Bwidth", "zero-width"),
        ("invisible%E3%85%A4", "invisible"),
        ("%CC%88mark", "mark"),
        ("file.meta", "file-meta"),
        ("file.META", "file-meta"),
        ("file.meta.", "file-meta"),
        ("file.meta.meta", "file.meta-meta"),
        ("file.meta%2F", "file-meta"),
        ("end...", "end"),
    ):
        assert choose_name(slug, free) == name


def test_without_anything_readable_a_name_is_made_that_can_be_read_aloud() -> None:
    for slug in (None, "", " ", ".", "..", "...", "%2E%2E", "/", "~", "---", "%E2%80%AE", "%CC%88"):
        name = choose_name(slug, free)
        assert len(name) == 13
        assert name.replace("-", "").isalpha()
        assert name != choose_name(slug, free)


def test_a_name_that_is_or_was_there_is_never_given_again() -> None:
    there: set[str] = set()
    for _ in range(50):
        name = choose_name("room", there.__contains__)
        assert name not in there
        there.add(name)
    assert {"room", "room-2", "room-3", "room-9"} <= there


def test_a_thousand_members_of_one_slug_are_named_by_few_questions() -> None:
    asked: list[str] = []

    def taken(name: str) -> bool:
        asked.append(name)
        return len(name) < len("room-12345678")

    choose_name("room", taken)
    assert len(asked) < 12


def test_a_number_stands_before_the_extension() -> None:
    assert choose_name("photo.png", {"photo.png"}.__contains__) == "photo-2.png"


_slugs = (
    st.none() | st.text(max_size=300) | st.text(max_size=80).map(lambda text: quote(text.encode("utf-8", "replace")))
)


@given(_slugs, st.integers(0, 12))
@example("." * 200, 0)
@example("a" * 97 + ".meta", 0)
@example("a" * 300 + ".png", 3)
@example("x" * 99 + "/.meta", 0)
@example("\u0344" * 120, 0)
def test_a_name_is_always_one_safe_segment(slug: str | None, refused: int) -> None:
    seen: list[str] = []

    def taken(name: str) -> bool:
        seen.append(name)
        return len(seen) <= refused

    name = choose_name(slug, taken)
    assert seen[-1] == name
    assert 0 < len(name) <= MAX_LENGTH
    assert name == unicodedata.normalize("NFC", name)
    assert not name.casefold().endswith(".meta")
    assert name.strip(".")
    assert name[0] not in "-."
    assert name[-1] != "."
    assert all(char in "-_." or unicodedata.category(char)[0] in "LMN" for char in name)
    assert decode_segment(encode_segment(name)) == name
