"""Times as people read them, always in UTC: a robot's day has no time zone."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

from rosld.server.html.view import TextView, TimeView, View

_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def time_view(nanoseconds: int, hint: str = "") -> View:
    """A wall-clock time given in nanoseconds since 1970: to the millisecond for people, exact for machines."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    try:
        when = _EPOCH + timedelta(seconds=seconds)
    except OverflowError:
        return TextView(f"{seconds}.{rest:09d} s", hint)
    day = when.strftime("%Y-%m-%d %H:%M:%S") if when.year >= 1000 else when.isoformat(" ")[:19]
    return TimeView(f"{day.replace(' ', 'T')}.{rest:09d}Z", f"{day}.{rest // 1_000_000:03d} UTC", hint)


def time_view_of_text(text: str, hint: str = "") -> View:
    """A time in the lexical form of xsd:dateTime; shown as it is where it cannot be read."""
    main, dot, rest = text.removesuffix("Z").partition(".")
    if text.endswith("Z") and len(main) == 19 and (not dot or rest.isdigit()):
        fraction = f".{rest[:3]:0<3}" if dot else ""
        return TimeView(text, f"{main.replace('T', ' ')}{fraction} UTC", hint)
    return TextView(text, hint)


def duration_view(seconds: int, nanoseconds: int, hint: str = "") -> View:
    """A duration of ROS: whole seconds and nanoseconds to be added to them."""
    total = seconds * 1_000_000_000 + nanoseconds
    whole, rest = divmod(abs(total), 1_000_000_000)
    digits = f"{rest:09d}".rstrip("0")
    return TextView(f"{'-' if total < 0 else ''}{whole}{'.' if digits else ''}{digits} s", hint)
