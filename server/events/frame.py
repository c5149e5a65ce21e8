"""Events as bytes: the event stream format (WHATWG HTML 9.2.5). Pure."""

from __future__ import annotations

KEEP_ALIVE = b":\n\n"
"""A comment: keeps proxies from ending a stream in which nothing happens (WHATWG HTML 9.2.7)."""


def opening(retry_seconds: float) -> bytes:
    """The first bytes of a stream: after how long a client that lost it comes back."""
    return b"retry: %d\n\n" % round(retry_seconds * 1000)


def skipped(count: int) -> bytes:
    """Return the comment that says how many messages were left out before an event."""
    return b": skipped %d\n" % count


def event(data: bytes, id: str | None = None, name: str | None = None) -> bytes:
    """One event. `id` is what a client sends as Last-Event-ID, `name` its type ("message" where there is none).

    Raises ValueError for an id or a name that would end its line.
    """
    lines = []
    for field, value in (("event", name), ("id", id)):
        if value is not None:
            if not value.isprintable():
                raise ValueError(f"{value!r} cannot be the {field} of an event")
            lines.append(f"{field}: {value}".encode())
    lines += [b"data: " + line for line in data.splitlines() or [b""]]
    return b"\n".join(lines) + b"\n\n"
