"""Release of a stop, as by a person who reads its page."""

from __future__ import annotations

import re

import httpx


def shown_id(http: httpx.Client) -> str | None:
    """Return the id that the page of the stop shows, None while the robot is not stopped."""
    page = http.get("/stop", headers={"Accept": "text/html"}).text
    found = re.search(r'name="[?]confirm" value="([^"]+)"', page)
    return None if found is None else found[1]


def release(http: httpx.Client, **params: str) -> httpx.Response:
    """Send a DELETE of the stop, confirmed with the id that its page shows."""
    id = shown_id(http)
    return http.delete("/stop", params=params if id is None else {"confirm": id, **params})
