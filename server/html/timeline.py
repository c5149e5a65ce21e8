"""Time line of a recording as SVG: a row a topic, darker where it has more messages, and marks of events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from itertools import groupby
from typing import NamedTuple

from markupsafe import escape

from rosld.server.html.view import escape_controls

PARTS = 160
"""Number of equal parts of the time of a recording."""
_LEFT, _PART, _ROW, _TOP = 240, 4.5, 16, 34
_WIDTH = _LEFT + PARTS * _PART + 10
_MAX_TOPICS = 60
_MAX_EVENTS = 500
_LONGEST = 38
_INK, _BAR, _MARK = "#7a7a7a", "#3b7dd8", "#d9480f"
"""Colours that are legible on white and on black."""
_SHADES = (0.0, 0.35, 0.65, 1.0)


class Mark(NamedTuple):
    """An event: its name, start and end (None for an instant) in ns."""

    name: str
    start_ns: int
    end_ns: int | None


def timeline_svg(start_ns: int, end_ns: int, density: Mapping[str, Sequence[int]], marks: Sequence[Mark]) -> str:
    """Return the time line of a recording, with the numbers of messages in `PARTS` parts of its time, by topic."""
    rows = sorted(density.items())[:_MAX_TOPICS]
    height = _TOP + len(rows) * _ROW + 24
    words = f"{len(rows)} topics and {len(marks)} events from {_time(start_ns)} to {_time(end_ns)}"
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {height}" width="{_WIDTH:g}" '
        f'height="{height}" role="img" font-family="sans-serif" font-size="11" fill="{_INK}">',
        f"<title>{words}</title>",
    ]
    for number, (name, counts) in enumerate(rows):
        y = _TOP + number * _ROW
        lines.append(f'<text x="{_LEFT - 6}" y="{y + 11}" text-anchor="end">{_short(name)}</text>')
        lines += _bars(counts, y)
    bottom = _TOP + len(rows) * _ROW
    for mark in sorted(marks, key=lambda each: each.start_ns)[:_MAX_EVENTS]:
        lines += _mark(mark, start_ns, max(end_ns - start_ns, 1), bottom)
    lines.append(f'<text x="{_LEFT}" y="{bottom + 16}">{_time(start_ns)}</text>')
    lines.append(f'<text x="{_WIDTH - 10:g}" y="{bottom + 16}" text-anchor="end">{_time(end_ns)}</text></svg>')
    return "\n".join(lines)


def _bars(counts: Sequence[int], y: int) -> list[str]:
    """Return the bars of a topic: parts of one shade in a row are one bar."""
    most = max(counts, default=0)
    shades = [0 if not count else 1 + min(2, int(3 * count / (most + 1))) for count in counts]
    bars: list[str] = []
    at = 0
    for shade, run in groupby(shades):
        length = len(list(run))
        if shade:
            x, width = _LEFT + at * _PART, length * _PART
            bars.append(
                f'<rect x="{x:g}" y="{y + 2}" width="{width:g}" height="{_ROW - 4}" fill="{_BAR}" '
                f'fill-opacity="{_SHADES[shade]}"/>'
            )
        at += length
    return bars


def _mark(mark: Mark, start_ns: int, span: int, bottom: int) -> list[str]:
    first, last = ((at - start_ns) / span for at in (mark.start_ns, mark.end_ns or mark.start_ns))
    if last < 0 or first > 1:
        return []
    left, right = (_LEFT + min(max(each, 0), 1) * PARTS * _PART for each in (first, last))
    title = f"<title>{_short(mark.name)}</title>"
    return [
        f'<rect x="{left:.1f}" y="18" width="{max(right - left, 1.5):.1f}" height="{bottom - 18}" fill="{_MARK}" '
        f'fill-opacity="{0.25 if right - left > 1.5 else 0.9}">{title}</rect>',
        f'<text x="{left:.1f}" y="13" fill="{_MARK}">{_short(mark.name)}</text>',
    ]


def _short(text: str) -> str:
    cut = text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
    return str(escape(escape_controls(cut)))


def _time(time_ns: int) -> str:
    try:
        return datetime.fromtimestamp(time_ns // 10**9, timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (OverflowError, ValueError, OSError):
        return f"{time_ns / 1e9:g} s"
