"""Tables for people (aligned columns, bold heads on terminals, sizes and durations with units), and JSON."""

from __future__ import annotations

from collections.abc import Sequence

import click
import orjson

_UNITS = ("B", "kB", "MB", "GB", "TB")


PROBLEM = "problem"
"""Head of a column that is left out if it is empty."""


def print_table(head: Sequence[str], rows: Sequence[Sequence[str]], numeric: frozenset[str] = frozenset()) -> None:
    """Print rows below their head; `numeric` columns are aligned on the right."""
    shown = [at for at in range(len(head)) if head[at] != PROBLEM or any(row[at] for row in rows)]
    widths = {at: max(len(row[at]) for row in (head, *rows)) for at in shown}
    for row in (head, *rows):
        cells = (row[at].rjust(widths[at]) if head[at] in numeric else row[at].ljust(widths[at]) for at in shown)
        click.secho("  ".join(cells).rstrip(), bold=row is head or None)


def size_text(size: int) -> str:
    """Return a number of bytes with a unit."""
    number, power = float(size), 0
    while number >= 1000 and power < len(_UNITS) - 1:
        number, power = number / 1000, power + 1
    return f"{number:.{min(power, 1)}f} {_UNITS[power]}"


def duration_text(seconds: float) -> str:
    """Return a duration in hours, minutes and seconds, as far as needed."""
    minutes, rest = divmod(round(seconds, 1), 60)
    hours, minutes = divmod(int(minutes), 60)
    parts = [f"{number} {unit}" for number, unit in ((hours, "h"), (minutes, "min")) if number]
    return " ".join([*parts, f"{rest:.1f} s"])


def json_text(value: object) -> str:
    """Return a value as JSON for people."""
    return orjson.dumps(value, option=orjson.OPT_INDENT_2).decode()
