"""Events as bytes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.events.event_stream import KEEP_ALIVE_COMMENT, event_frame, opening_frame


def read(stream: bytes) -> list[dict[str, str]]:
    """Return the fields of each event, parsed as in a browser (WHATWG HTML 9.2.6)."""
    events: list[dict[str, str]] = []
    fields: dict[str, list[str]] = {}
    for line in stream.decode().replace("\r\n", "\n").replace("\r", "\n").split("\n"):
        if not line:
            if fields:
                events.append({name: "\n".join(values) for name, values in fields.items()})
            fields = {}
        elif not line.startswith(":"):
            name, _, value = line.partition(":")
            fields.setdefault(name, []).append(value.removeprefix(" "))
    return events


def test_an_event_has_its_name_its_id_and_its_data() -> None:
    assert event_frame(b'{"x":1}', "boot-1", "gone") == b'event: gone\nid: boot-1\ndata: {"x":1}\n\n'
    assert read(KEEP_ALIVE_COMMENT) == []
    assert opening_frame(2) == b"retry: 2000\n\n"


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_data_arrives_line_by_line_whatever_ends_its_lines(text: str) -> None:
    normal = text.replace("\r\n", "\n").replace("\r", "\n")
    assert read(event_frame(text.encode(), "1")) == [{"id": "1", "data": normal.removesuffix("\n")}]


def test_a_name_or_id_that_would_end_its_line_is_refused() -> None:
    for bad in ("a\nb", "a\rdata: x", "a\0"):
        with pytest.raises(ValueError, match="id"):
            event_frame(b"", bad)
        with pytest.raises(ValueError, match="event"):
            event_frame(b"", name=bad)
