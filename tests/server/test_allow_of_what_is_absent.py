"""What is not there allows no GET that would be answered 404 (RFC 9110 10.2.1)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest

ABSENT = (
    "/nodes/absent", "/topics/absent", "/services/absent", "/actions/absent", "/calls/absent", "/goals/absent",
    "/holds/absent", "/activity/absent", "/bags/absent", "/parameters/absent", "/types/absent/msg/Absent",
    "/shapes/absent/msg/Absent", "/shapes/absent", "/queries/absent", "/mappings/absent", "/data/absent",
    "/data/absent/", "/resources/absent", "/resources/absent/", "/channels/absent", "/.well-known/absent", "/absent",
    "/nodes/absent/", "/services/absent/", "/parameters/absent/",
)  # fmt: skip


def allowed(http: httpx.Client, path: str) -> set[str]:
    """What the answers to OPTIONS and to GET allow at a URL; nothing where they do not say."""
    answers = (http.options(path), http.get(path))
    return {each for answer in answers for each in answer.headers.get("allow", "").split(", ")} - {""}


@pytest.mark.parametrize("path", ABSENT)
def test_what_is_absent_allows_no_get(http: httpx.Client, path: str) -> None:
    assert http.get(path).status_code == 404
    assert allowed(http, path).isdisjoint({"GET", "HEAD"})


def test_what_is_gone_allows_no_get(serve: Callable[..., Any]) -> None:
    http = serve("aircraft").http
    made = [
        http.post("/services/aircraft/start").headers["location"],
        http.post("/topics/cockpit/display?rate=1&lease=5", json={"data": "x"}).headers["location"],
    ]
    for url in made:
        assert {"GET", "HEAD", "DELETE"} <= set(http.options(url).headers["allow"].split(", "))
        assert http.delete(url).status_code == 204
        assert http.get(url).status_code == 410
        assert allowed(http, url).isdisjoint({"GET", "HEAD"})


def test_what_is_there_allows_get(http: httpx.Client) -> None:
    there = ("/nodes/aircraft", "/services/aircraft/start", "/actions/aircraft/fly", "/topics/cockpit/display")
    for path in there:
        assert {"GET", "HEAD", "OPTIONS"} <= set(http.options(path).headers["allow"].split(", "))
