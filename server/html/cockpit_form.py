"""The form that edits a cockpit, and the parts that all forms share: methods and their pairs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, TypeAlias

from msgspec import Struct

from rosld.ontology.cockpit import COLUMNS, Cockpit, GridArea, Panel, PanelKind
from rosld.ontology.violations import LoweringError, Violation
from rosld.server.html.inputs import Control, Input
from rosld.server.html.view import escape_controls

Method: TypeAlias = Literal["PUT", "POST", "PATCH", "DELETE"]
Pairs: TypeAlias = Sequence[tuple[str, str]]


ADDED = 2
"""Number of empty rows for new panels."""
_NAMES = ("kind", "type", "shows", "fields", "title", "column", "row", "width", "height", "remove")
_ROW = re.compile(rf"panel\.([0-9]{{1,3}})\.({'|'.join(_NAMES)})")
KINDS = tuple(kind.value for kind in PanelKind)
"""Kinds of panels that a form offers."""
_MOST = 99


class EditForm(Struct, frozen=True):
    """A form that replaces a cockpit. `base` is the prefix of the robot's URLs, `version` the version to replace."""

    template: ClassVar[str] = "edit"
    cockpit: Cockpit
    base: str
    version: str
    method: Method = "PUT"
    action: ClassVar[str] = ""
    submitted: Pairs | None = None
    violations: tuple[Violation, ...] = ()
    controls: ClassVar[tuple[Control, ...]] = ()

    @property
    def title(self) -> str:
        """The title of the cockpit."""
        return escape_controls(dict(self.submitted or ()).get("title", self.cockpit.title))

    @property
    def panels(self) -> tuple[Mapping[str, str | int], ...]:
        """The inputs of the panels, followed by empty ones; the `number` of a new panel is 0."""
        if self.submitted is not None:
            rows = sorted(_rows(self.submitted).items())
            return tuple(_panel_inputs(number, number, texts) for number, texts in rows)
        there = [_panel_texts(panel, self.base) for panel in self.cockpit.panels]
        found = enumerate([*there, *[_NEW_PANEL] * ADDED], 1)
        return tuple(_panel_inputs(row, row if row <= len(there) else 0, texts) for row, texts in found)


class CopyForm(Struct, frozen=True):
    """A form that copies the cockpit at a URL under a new name."""

    template: ClassVar[str] = "copy"
    source: str
    method: Method = "POST"
    title: str = "Keep a copy"
    button: str = "Keep"
    action: str = ""
    about: str = "It can be changed, and has its own URL."
    submitted: Pairs | None = None
    violations: tuple[Violation, ...] = ()

    @property
    def controls(self) -> tuple[Control, ...]:
        """The inputs of the form."""
        given = dict(self.submitted or ())
        error = escape_controls("; ".join(each.message for each in self.violations))
        return (
            Input("name", "name", "text", escape_controls(given.get("name", "")), error=error, maxlength="100"),
            Input("source", "copy of", "text", escape_controls(given.get("source", self.source)), maxlength="1000"),
        )


def parse_copy(pairs: Pairs) -> dict[str, object]:
    """Return the plain JSON of a form that copies a cockpit. Raises LoweringError."""
    given = dict(pairs)
    name, source = given.get("name", "").strip(), given.get("source", "").strip()
    if not name:
        raise LoweringError(Violation("name", "is empty: a cockpit needs a name", None))
    return {"name": name, "source": source}


def parse_edit(pairs: Pairs) -> dict[str, object]:
    """Return the plain JSON of a form that replaces a cockpit. Raises LoweringError for an invalid number."""
    given, rows = dict(pairs), _rows(pairs)
    violations: list[Violation] = []
    panels = []
    for number in sorted(rows):
        row = rows[number]
        if row.get("remove") or not (row.get("shows", "").strip() or row.get("title", "").strip()):
            continue
        area = {
            name: _number(number, name, row.get(name, ""), most, violations)
            for name, most in (("column", COLUMNS), ("row", _MOST), ("width", COLUMNS), ("height", COLUMNS))
        }
        panels.append(
            {
                "kind": row.get("kind", ""),
                "type": row.get("type", ""),
                "title": row.get("title", "").strip(),
                "shows": row.get("shows", "").split(),
                "fields": row.get("fields", "").split(),
                **area,
            }
        )
    if violations:
        raise LoweringError(*violations)
    return {"title": given.get("title", "").strip(), "version": given.get("version", ""), "panels": panels}


def _number(panel: int, name: str, text: str, most: int, violations: list[Violation]) -> int | None:
    text = text.strip()
    if not text:
        return None
    if text.isdecimal() and text.isascii() and len(text) < 4 and 1 <= int(text) <= most:
        return int(text)
    violations.append(Violation(f"panel.{panel}.{name}", f"must be an integer from 1 to {most}", text[:40]))
    return None


def cockpit_of_form(value: Mapping[str, object], base: str) -> Cockpit:
    """Return the cockpit in the plain JSON of a form; references are relative to the base of the server."""
    rows = value.get("panels")
    panels = [_panel(row, base) for row in (rows if isinstance(rows, list) else []) if isinstance(row, dict)]
    return Cockpit(str(value.get("title", "")), tuple(panels))


def _panel(row: Mapping[str, object], base: str) -> Panel:
    name = str(row["kind"])
    kind = PanelKind(name) if name in KINDS else None
    default = GridArea()
    area = GridArea(
        _whole(row["width"]) or default.width,
        _whole(row["height"]) or default.height,
        _whole(row["column"]),
        _whole(row["row"]),
    )
    shows, fields = _texts(row["shows"]), _texts(row["fields"])
    split = [each.partition("#") for each in shows]
    fields = list(dict.fromkeys([*fields, *(field for _, _, field in split if field)]))
    urls = list(dict.fromkeys(_absolute(url, base) for url, _, _ in split if url))
    return Panel(kind, tuple(urls), tuple(fields), str(row["title"]), area, str(row["type"]))


def _texts(value: object) -> list[str]:
    return [str(each) for each in value] if isinstance(value, list) else []


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) else None


def _absolute(reference: str, base: str) -> str:
    """Return a reference as an IRI, resolved against the base if it has no scheme."""
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", reference):
        return reference
    return base + reference.lstrip("/")


def _rows(pairs: Pairs) -> dict[int, dict[str, str]]:
    found: dict[int, dict[str, str]] = {}
    for name, value in pairs:
        match = _ROW.fullmatch(name)
        if match is not None:
            found.setdefault(int(match[1]), {})[match[2]] = value
    return found


_NEW_PANEL = {"kind": PanelKind.VALUE.value, "width": "4", "height": "3"}


def _panel_texts(panel: Panel, base: str) -> Mapping[str, str]:
    area = panel.area
    return {
        "kind": "" if panel.kind is None else panel.kind.value,
        "type": panel.type,
        "shows": " ".join(each.removeprefix(base) for each in panel.shows),
        "fields": " ".join(panel.fields),
        "title": panel.title,
        "column": str(area.column or ""),
        "row": str(area.row or ""),
        "width": str(area.width),
        "height": str(area.height),
    }


def _panel_inputs(row: int, number: int, texts: Mapping[str, str]) -> Mapping[str, str | int]:
    given = {name: escape_controls(texts.get(name, "")) for name in _NAMES}
    return {**given, "prefix": f"panel.{row}.", "number": number}
