"""The index: it finds entries with all words of a query, the best first."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rosld.server.search.index import Catalog, Entry, EntryKind, SearchIndex
from rosld.server.search.words import Query, read_query, words_of

FIELDS = {
    "sensor_msgs/msg/BatteryState": ("voltage", "percentage", "cell_voltage"),
    "nav_msgs/msg/Odometry": ("header", "pose", "pose.pose", "pose.pose.position", "pose.pose.position.x"),
}
WORDS = st.sampled_from(["a", "ab", "abc", "b", "bc", "state", "raw"])
SEGMENTS = st.lists(WORDS, min_size=1, max_size=2).map("_".join)
NAMES = st.lists(SEGMENTS, min_size=1, max_size=3).map(lambda segments: "/" + "/".join(segments))
ENTRIES = st.builds(
    Entry,
    st.sampled_from(EntryKind),
    NAMES,
    st.just("http://robot/x"),
    st.sampled_from([(), ("p/msg/AbState",), ("p/msg/Raw", "p/msg/AbState")]),
    st.lists(WORDS, max_size=2).map(tuple),
)
TYPE_FIELDS = {"p/msg/AbState": ("bc", "bc.state_abc[]"), "p/msg/Raw": ("raw_b",)}


def entry(name: str, *types: str, kind: EntryKind = EntryKind.TOPIC, texts: tuple[str, ...] = ()) -> Entry:
    return Entry(kind, name, f"http://robot/{kind.value}s{name}", types, texts)


def found(query: str, *entries: Entry) -> list[tuple[str, str, str | None]]:
    hits = SearchIndex(Catalog(entries, FIELDS)).find(read_query(query), 20).hits
    return [(hit.entry.name, hit.match.label, hit.field) for hit in hits]


def fits(term: str, entry: Entry) -> bool:
    """Whether a term matches an entry, computed without an index."""
    words = [word for text in entry.texts for word in words_of(text)]
    for name in entry.types:
        words += words_of(name)
        for path in TYPE_FIELDS[name]:
            own = path.rpartition(".")[2].removesuffix("[]")
            words += [own, *words_of(own)]
    words += [*entry.name.split("/"), *words_of(entry.name)]
    return (len(term) > 2 and term in entry.name) or any(word.startswith(term) for word in words)


@given(st.lists(ENTRIES, max_size=8), st.lists(WORDS | st.just("st"), min_size=1, max_size=3))
def test_what_is_found_is_what_has_all_words_or_else_some(entries: list[Entry], terms: list[str]) -> None:
    hits, total, is_complete, _ = SearchIndex(Catalog(entries, TYPE_FIELDS)).find(Query(tuple(terms)), 20)
    expected = [each for each in entries if all(fits(term, each) for term in terms)]
    if not expected:
        expected = [each for each in entries if any(fits(term, each) for term in terms)]
    assert is_complete == all(fits(term, each) for each in expected for term in terms)
    assert sorted(map(repr, expected)) == sorted(repr(hit.entry) for hit in hits)
    assert total == len(expected)
    assert [hit.rank for hit in hits] == sorted(hit.rank for hit in hits)


def test_names_come_before_words_before_what_means_the_same_before_texts() -> None:
    entries = (
        entry("/power", "sensor_msgs/msg/BatteryState"),
        entry("/low_battery"),
        entry("/sub/battery_monitor"),
        entry("/battery/level"),
        entry("/rechargeablebattery"),
        entry("/load", texts=("What the battery gives",)),
        entry("/robot/battery"),
    )
    assert found("battery", *entries) == [
        ("/robot/battery", "name", None),
        ("/battery/level", "name", None),
        ("/sub/battery_monitor", "prefix", None),
        ("/low_battery", "word", None),
        ("/power", "type", None),
        ("/load", "text", None),
        ("/rechargeablebattery", "part", None),
    ]


def test_of_equal_names_what_can_be_done_comes_first_and_the_shortest_name() -> None:
    entries = (
        entry("/a/b/dock"),
        entry("/dock", kind=EntryKind.NODE),
        entry("/dock"),
        entry("/dock", kind=EntryKind.ACTION),
    )
    hits = SearchIndex(Catalog(entries)).find(read_query("dock"), 20).hits
    assert [(hit.entry.kind.value, hit.entry.name) for hit in hits] == [
        ("action", "/dock"), ("topic", "/dock"), ("topic", "/a/b/dock"), ("node", "/dock"),
    ]  # fmt: skip


def test_names_are_split_into_words() -> None:
    words = {
        "/camera/image_raw": ("camera", "image", "raw"),
        "sensor_msgs/msg/BatteryState": ("sensor", "msgs", "msg", "battery", "state"),
        "IMUData2": ("imu", "data", "2"),
        "imageRAW": ("image", "raw"),
        "MyÄrger": ("my", "ärger"),
        "Größe der Batterie": ("grösse", "der", "batterie"),
        "": (),
    }
    assert {text: words_of(text) for text in words} == words
