"""All formats listed in a refusal of `?format=` are served."""

from __future__ import annotations

import re

import httpx
import pytest

pytestmark = pytest.mark.slow

PLACES = (
    "/queries/inventory", "/queries/node?node=/nodes/aircraft", "/queries/graph", "/graphs?default", "/topics/",
    "/topics/cockpit/display", "/graphs?graph=/topics/cockpit/display",
)  # fmt: skip


def asked(http: httpx.Client, place: str, format: str) -> httpx.Response:
    return http.get(f"{place}{'&' if '?' in place else '?'}format={format}")


def test_each_format_that_is_listed_is_served(http: httpx.Client) -> None:
    for place in PLACES:
        answer = asked(http, place, "zzz")
        assert answer.status_code == 406, answer.text
        listed = re.findall(r"[a-z0-9]+", answer.json()["detail"].partition("choose from ")[2])
        assert {"ttl", "jsonld"} <= set(listed) or "csv" in listed
        for format in listed:
            assert asked(http, place, format).status_code == 200, (place, format)
        if "csv" not in listed:
            assert asked(http, place, "csv").status_code == 406
