"""Views: values on a page (texts, numbers, times, tables) for the templates. All of it is plain text."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from typing import ClassVar, TypeAlias

from msgspec import Struct

from rosld.server.html.site import Anchor

_LONG = 400
_PICTURES = {code: 0x2400 + code for code in range(0x20) if code not in (0x09, 0x0A)} | {0x7F: 0x2421}
_UNASSIGNED = re.compile(r"[\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff\x80-\x9f]")


class TextView(Struct, frozen=True):
    """A value as text; `full` is a long one in full, `exact` all digits of a number, `hint` its type, `tone` a style.

    `plot` refers to the plot of a number over time, `unit` is the symbol of its unit, or they are empty.
    """

    kind: ClassVar[str] = "text"
    text: str
    hint: str = ""
    full: str | None = None
    tone: str = ""
    exact: str = ""
    plot: str = ""
    unit: str = ""


class BlockView(Struct, frozen=True):
    """Text of several lines, such as the definition of a type or a query."""

    kind: ClassVar[str] = "block"
    text: str
    hint: str = ""


class LinkView(Struct, frozen=True):
    """A link."""

    kind: ClassVar[str] = "link"
    anchor: Anchor
    hint: str = ""


class TimeView(Struct, frozen=True):
    """A time: for machines (`iso`), for people, and in its original form."""

    kind: ClassVar[str] = "moment"
    iso: str
    text: str
    hint: str = ""


class ArrayView(Struct, frozen=True):
    """An array of scalars: its length, its beginning and, if it is longer, as much of the rest as is shown."""

    kind: ClassVar[str] = "series"
    count: int
    head: str
    full: str | None = None
    hint: str = ""
    unit: str = ""


class BytesView(Struct, frozen=True):
    """Bytes: their number, the first of them in hexadecimal, and their URL (None if they have none)."""

    kind: ClassVar[str] = "octets"
    count: int
    head: str = ""
    href: str | None = None
    hint: str = ""


class ThumbnailView(Struct, frozen=True):
    """A small picture in a table: its URL, the URL of the full one, its title, and its value in words."""

    kind: ClassVar[str] = "thumbnail"
    source: str
    href: str
    text: str
    words: str


class TableRow(Struct, frozen=True):
    """A named value (or several); `hint` is shown quietly, `term` links to the definition of the name."""

    label: str
    values: tuple[View, ...]
    hint: str = ""
    about: str = ""
    term: Anchor | None = None

    @property
    def nested(self) -> bool:
        """Whether the values are nested tables."""
        return any(
            value.kind in ("many", "block") or (isinstance(value, TableView) and not value.short)
            for value in self.values
        )


class TableView(Struct, frozen=True):
    """A table of named values. `id` is its fragment on the page; `short` ones (a few numbers) take one line."""

    kind: ClassVar[str] = "rows"
    rows: tuple[TableRow, ...]
    hint: str = ""
    id: str = ""
    short: bool = False


class TableListView(Struct, frozen=True):
    """An array of tables; `items` are those shown."""

    kind: ClassVar[str] = "many"
    count: int
    items: tuple[TableView, ...]
    hint: str = ""


View: TypeAlias = (
    TextView | BlockView | LinkView | TimeView | ArrayView | BytesView | ThumbnailView | TableView | TableListView
)


def escape_controls(text: str) -> str:
    """Return `text` with control characters as visible symbols, and characters replaced that HTML cannot represent."""
    return _UNASSIGNED.sub("\ufffd", text.translate(_PICTURES))


def text_view(text: str, hint: str = "") -> View:
    """Return the view of a string: several lines as a block, a long one shortened."""
    shown = escape_controls(text)
    if not shown:
        return TextView("empty", hint, tone="none")
    if "\n" in shown:
        return BlockView(shown, hint)
    if len(shown) > _LONG:
        return TextView(shown[: _LONG // 4], hint, full=shown)
    return TextView(shown, hint)


_DIGITS = 6
_LONGEST = 9
"""Maximum number of characters of a number that is shown unchanged."""


def number_view(text: str, hint: str = "") -> TextView:
    """Return the view of a number: shortened if it has many decimals, with all digits in `exact`."""
    shown = shorten_number(text)
    return TextView(escape_controls(shown), hint, tone="number", exact=escape_controls(text) if shown != text else "")


def shorten_number(text: str) -> str:
    """Return a number with at most six significant digits; integers and other texts are unchanged."""
    if len(text) <= _LONGEST or not ("." in text or "e" in text.lower()):
        return text
    try:
        return f"{float(text):.{_DIGITS}g}"
    except ValueError:
        return text


_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def time_view(nanoseconds: int, hint: str = "") -> View:
    """Return a wall-clock time in nanoseconds since 1970: to the millisecond for people, exact for machines."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    try:
        when = _EPOCH + timedelta(seconds=seconds)
    except OverflowError:
        return TextView(f"{seconds}.{rest:09d} s", hint)
    day = when.strftime("%Y-%m-%d %H:%M:%S") if when.year >= 1000 else when.isoformat(" ")[:19]
    return TimeView(f"{day.replace(' ', 'T')}.{rest:09d}Z", f"{day}.{rest // 1_000_000:03d} UTC", hint)


def time_view_of_text(text: str, hint: str = "") -> View:
    """Return a time in the lexical form of xsd:dateTime; unchanged if it is invalid."""
    main, dot, rest = text.removesuffix("Z").partition(".")
    if text.endswith("Z") and len(main) == 19 and (not dot or rest.isdigit()):
        fraction = f".{rest[:3]:0<3}" if dot else ""
        return TimeView(text, f"{main.replace('T', ' ')}{fraction} UTC", hint)
    return TextView(text, hint)


def duration_view(seconds: int, nanoseconds: int) -> View:
    """Return a ROS duration: the sum of whole seconds and nanoseconds."""
    total = seconds * 1_000_000_000 + nanoseconds
    whole, rest = divmod(abs(total), 1_000_000_000)
    digits = f"{rest:09d}".rstrip("0")
    return TextView(f"{'-' if total < 0 else ''}{whole}{'.' if digits else ''}{digits} s")
