"""One address reads as many streams as may be, and leaves room for the others; also on this machine."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from typing import Any

import httpx

from tests.waiting import until

STREAM = {"Accept": "text/event-stream"}
TOPIC = "/topics/aircraft/engine/speed"


def streams(http: httpx.Client, stack: contextlib.ExitStack, number: int) -> list[httpx.Response]:
    return [stack.enter_context(http.stream("GET", TOPIC, headers=STREAM)) for _ in range(number)]


def test_one_stream_more_than_an_address_may_have_is_429_until_another_ends(serve: Callable[..., Any]) -> None:
    http = serve("aircraft", "--setting", "client_streams", "3").http
    with contextlib.ExitStack() as stack:
        assert {one.status_code for one in streams(http, stack, 3)} == {200}
        refused = http.get(TOPIC, headers=STREAM)
        assert refused.status_code == 429
        assert "client_streams" in refused.json()["detail"]
        assert int(refused.headers["retry-after"]) > 0

        def waiting() -> int:
            """What who waits for another state than now is answered; the topic changes ten times a second."""
            etag = json.dumps(http.get(TOPIC).headers["etag"].strip('"'))
            return http.get(TOPIC, params={"after": etag, "timeout": "0.01"}).status_code

        until(lambda: waiting() == 429, "that one who waits is one too many")
        assert http.get(TOPIC).status_code == 200
        assert http.post("/stop").status_code == 200
    until(lambda: waiting() != 429, "room")
