"""The final message of a hold is read with the permissions of its holder."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.server.auth.conftest import Guarded, rule

pytestmark = pytest.mark.slow

RULES = rule("pilot", "read control", "/topics/cockpit/**", "/holds/**")


def test_what_the_holder_may_not_read_is_not_published_at_the_end(guard: Callable[..., Guarded]) -> None:
    pilot = guard(RULES, "pilot")["pilot"]
    held: dict[str, Any] = {"json": {"data": "held"}, "params": {"rate": 1, "lease": 1}}
    answers = []
    for there in ("aircraft/engine/speed", "aircraft/engine/none"):
        then = f"{pilot.base_url}topics/{there}"
        answer = pilot.post("/topics/cockpit/display", **{**held, "params": {**held["params"], "then": then}})
        assert answer.status_code == 422, answer.text
        answers.append(answer.json()["detail"].replace(there, ""))
    assert answers[0] == answers[1]
    hold = pilot.post("/topics/cockpit/display", **held)
    assert hold.status_code == 201
    assert pilot.delete(hold.headers["location"]).status_code == 204


def test_a_hold_is_changed_kept_and_ended_by_its_holder_alone(guard: Callable[..., Guarded]) -> None:
    both = guard(RULES.replace('["pilot"]', '["pilot", "mate"]'), "pilot", "mate")
    body: dict[str, Any] = {"json": {"data": "held"}}
    hold = both["pilot"].post("/topics/cockpit/display", params={"rate": 10, "lease": 5}, **body).headers["location"]
    stream = {"Accept": "text/event-stream"}
    for answer in (
        both["mate"].patch(hold, json={"data": "mine"}),
        both["mate"].delete(hold),
        both["mate"].get(hold, params={"keep": "true"}, headers=stream),
    ):
        assert answer.status_code == 403, answer.text
        assert "belongs to pilot" in answer.json()["detail"]
    assert both["mate"].get(hold, headers={"Accept": "application/json"}).json()["message"] == {"data": "held"}
    assert both["pilot"].patch(hold, json={"data": "still mine"}).status_code == 204
    assert both["pilot"].delete(hold).status_code == 204
