"""What is not there allows no GET that would be answered 404 (RFC 9110 10.2.1)."""

from __future__ import annotations

import httpx

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


def test_what_is_absent_allows_no_get(http: httpx.Client) -> None:
    wrong = {
        path: (http.get(path).status_code, allowed(http, path))
        for path in ABSENT
        if http.get(path).status_code != 404 or not allowed(http, path).isdisjoint({"GET", "HEAD"})
    }
    assert not wrong, wrong


def test_what_is_gone_allows_no_get(own_aircraft: httpx.Client) -> None:
    http = own_aircraft
    made = [
        http.post("/services/aircraft/start").headers["location"],
        http.post("/topics/cockpit/display?rate=1&lease=5", json={"data": "x"}).headers["location"],
    ]
    for url in made:
        assert {"GET", "HEAD", "DELETE"} <= set(http.options(url).headers["allow"].split(", "))
        assert http.delete(url).status_code == 204
        assert http.get(url).status_code == 410
        assert allowed(http, url).isdisjoint({"GET", "HEAD"})
