"""Releasing a stop as a person does who reads its page."""

from __future__ import annotations

import re

import httpx


def release(http: httpx.Client, **params: str) -> httpx.Response:
    """DELETE the stop, confirmed with the id that its page shows."""
    page = http.get("/stop", headers={"Accept": "text/html"}).text
    found = re.search(r'name="[?]confirm" value="([^"]+)"', page)
    return http.delete("/stop", params=params if found is None else {"confirm": found[1], **params})
