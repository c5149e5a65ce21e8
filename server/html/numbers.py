"""Numbers as people read them: six significant digits, and all of them for who asks."""

from __future__ import annotations

from rosld.server.html.view import TextView, escape_controls

_DIGITS = 6
_LONGEST = 9
"""Characters of a number that is shown as it is."""


def number_view(text: str, hint: str = "") -> TextView:
    """A number by its text: one of many digits behind the point is shown with few, and has all of them beside."""
    shown = shorten_number(text)
    return TextView(escape_controls(shown), hint, tone="number", exact=escape_controls(text) if shown != text else "")


def shorten_number(text: str) -> str:
    """A number with six significant digits where it has more and is no integer; anything else as it is."""
    if len(text) <= _LONGEST or not ("." in text or "e" in text.lower()):
        return text
    try:
        return f"{float(text):.{_DIGITS}g}"
    except ValueError:
        return text
