"""Views: what one value looks like on a page, ready for the templates. Everything in them is plain text."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from rosld.server.html.site import Anchor

_LONG = 400
_PICTURES = {code: 0x2400 + code for code in range(0x20) if code not in (0x09, 0x0A)} | {0x7F: 0x2421}
_UNASSIGNED = re.compile(r"[\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff\x80-\x9f]")


@dataclass(frozen=True, slots=True)
class TextView:
    """A value as text; `full` is all of a long one, `exact` all digits of a number, `hint` its type, `tone` a style.

    `plot` refers to the plot of a number over time; empty without.
    """

    kind: ClassVar[str] = "text"
    text: str
    hint: str = ""
    full: str | None = None
    tone: str = ""
    exact: str = ""
    plot: str = ""


@dataclass(frozen=True, slots=True)
class BlockView:
    """Text of several lines, such as the definition of a type or a query."""

    kind: ClassVar[str] = "block"
    text: str
    hint: str = ""


@dataclass(frozen=True, slots=True)
class LinkView:
    """A link."""

    kind: ClassVar[str] = "link"
    anchor: Anchor
    hint: str = ""


@dataclass(frozen=True, slots=True)
class TimeView:
    """A time: for machines (`iso`), for people, and as it was given."""

    kind: ClassVar[str] = "moment"
    iso: str
    text: str
    hint: str = ""


@dataclass(frozen=True, slots=True)
class ArrayView:
    """An array of scalars: its length, its beginning, and (where there is more) as much of the whole as is shown."""

    kind: ClassVar[str] = "series"
    count: int
    head: str
    full: str | None = None
    hint: str = ""


@dataclass(frozen=True, slots=True)
class BytesView:
    """Bytes: how many, the first of them in hexadecimal, and where they are (None: nowhere by themselves)."""

    kind: ClassVar[str] = "octets"
    count: int
    head: str = ""
    href: str | None = None
    hint: str = ""


@dataclass(frozen=True, slots=True)
class ThumbnailView:
    """A small picture in a table: where it is, where it is to be seen in full, what it is, and its value in words."""

    kind: ClassVar[str] = "thumbnail"
    source: str
    href: str
    text: str
    words: str


@dataclass(frozen=True, slots=True)
class TableRow:
    """A named value (or several); `hint` is quiet, `term` links to what the name means."""

    label: str
    values: tuple[View, ...]
    hint: str = ""
    about: str = ""
    term: Anchor | None = None

    @property
    def nested(self) -> bool:
        """Whether the values are tables of their own."""
        return any(
            value.kind in ("many", "block") or (isinstance(value, TableView) and not value.short)
            for value in self.values
        )


@dataclass(frozen=True, slots=True)
class TableView:
    """A table of named values. `id` is the fragment it has on the page; `short` ones (a few numbers) take one line."""

    kind: ClassVar[str] = "rows"
    rows: tuple[TableRow, ...]
    hint: str = ""
    id: str = ""
    short: bool = False


@dataclass(frozen=True, slots=True)
class TableListView:
    """An array of tables, of which `items` are shown."""

    kind: ClassVar[str] = "many"
    count: int
    items: tuple[TableView, ...]
    hint: str = ""


View: TypeAlias = (
    TextView | BlockView | LinkView | TimeView | ArrayView | BytesView | ThumbnailView | TableView | TableListView
)


def escape_controls(text: str) -> str:
    """`text` with what HTML cannot hold made visible: control characters as their pictures, surrogates replaced."""
    return _UNASSIGNED.sub("\ufffd", text.translate(_PICTURES))


def text_view(text: str, hint: str = "", tone: str = "") -> View:
    """How a string is shown: several lines as a block, a long one shortened."""
    shown = escape_controls(text)
    if not shown:
        return TextView("empty", hint, tone="none")
    if "\n" in shown:
        return BlockView(shown, hint)
    if len(shown) > _LONG:
        return TextView(shown[: _LONG // 4], hint, full=shown, tone=tone)
    return TextView(shown, hint, tone=tone)
