"""Recordings across kills and restarts: those that wait for triggers, their owners, and interrupted ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.server.auth.conftest import token, tokens
from tests.server.disks.server import Server, server_on
from tests.server.history.mcap_files import read
from tests.server.history.test_recordings import SPEED, count, value
from tests.server.history.test_triggers import HTML, JSON, POWER, power
from tests.waiting import until

pytestmark = pytest.mark.slow

ALL = '[[rule]]\nagents = ["anna"]\nmodes = ["read", "write", "control"]\npaths = ["/**"]\n'
BEN = '[[rule]]\nagents = ["ben", "carl"]\nmodes = ["read", "write"]\npaths = ["/bags/**"]\n'
TOPICS = '[[rule]]\nagents = ["ben", "carl"]\nmodes = ["read"]\npaths = ["/topics/**"]\n'


def order(server: Server, agent: str, name: str, **how: Any) -> None:
    how = {"topics": [SPEED], "trigger": {"resource": f"/topics{SPEED}", "condition": "data < -1"}, **how}
    headers = {**JSON, "Authorization": f"Bearer {token(agent)}"}
    answer = server.http.post("/bags/", json={"name": name, **how}, headers=headers)
    assert answer.status_code == 201, answer.text


def status(server: Server, name: str) -> str | None:
    return value(server.http, f"/bags/{name}/", "recordingStatus")


def problem(server: Server, name: str) -> str:
    return value(server.http, f"/bags/{name}/", "recordingProblem") or ""


def test_orders_and_what_was_interrupted_outlive_a_kill_and_a_stop_and_rights_are_judged_anew(tmp_path: Path) -> None:
    auth, bags, log = tmp_path / "auth.toml", tmp_path / "data" / "bags", tmp_path / "log"
    auth.write_text(ALL + BEN + TOPICS + tokens("anna", "ben", "carl"))
    with server_on(tmp_path / "data", log) as server:
        http = server.http
        http.headers["Authorization"] = f"Bearer {token('anna')}"
        server.start("--auth", str(auth))
        trigger = {"resource": POWER, "condition": "value = 'on'", "limit": 2}
        order(server, "anna", "flight", duration=0.2, trigger=trigger)
        order(server, "ben", "speed")
        order(server, "carl", "gone")
        order(server, "anna", "ended")
        assert http.delete("/bags/ended/").status_code == 204
        order(server, "anna", "cut", trigger=None)
        until(lambda: (bags / "cut.mcap.active").stat().st_size > 2000, "some chunks on the disk")
        server.kill()

        auth.write_text(ALL + BEN + tokens("anna", "ben"))
        server.start("--auth", str(auth))
        assert http.get("/bags/ended/").status_code == 404
        assert count(http, "/bags/cut/") > 20
        assert http.get("/bags/cut/messages/0", headers=JSON).json() == {"data": 0.0}
        assert len(read(bags / "cut.mcap")) > 20
        assert status(server, "cut") == "interrupted"
        assert "rosld was killed" in problem(server, "cut")
        assert value(http, "/bags/cut/", "end") is not None
        assert "interrupted" in http.get("/bags/cut/", headers=JSON).text
        assert "rosld was killed" in http.get("/bags/cut/", headers=HTML).text
        until(lambda: status(server, "speed") == "suspended", "the judgement of who ordered it")
        assert f"may no longer read /topics{SPEED}" in problem(server, "speed")
        until(lambda: status(server, "gone") == "suspended", "the judgement of who ordered it")
        assert "no longer known" in problem(server, "gone")
        assert "the recording speed, ordered by ben, is suspended" in log.read_text()
        assert "suspended" in http.get("/bags/speed/", headers=JSON).text
        assert "may no longer read" in http.get("/bags/speed/", headers=HTML).text
        assert status(server, "flight") == "armed"
        auth.write_text(ALL + BEN + TOPICS + tokens("anna", "ben"))
        until(lambda: status(server, "speed") == "armed", "the rights that are there again")
        power(http, is_on=True)
        until(lambda: value(http, "/bags/flight/", "triggerCount") == "1", "the trigger")
        until(lambda: http.get("/bags/flight-1/messages/").status_code == 200, "the end of the recording")
        assert status(server, "flight-1") is None
        order(server, "anna", "long", trigger=None)
        until(lambda: count(http, "/bags/long/") > 0, "a message")
        assert server.stop() == 0

        server.start("--auth", str(auth))
        assert status(server, "flight") == "armed"
        assert value(http, "/bags/flight/", "triggerCount") == "1"
        assert value(http, "/bags/flight/", "triggerLimit") == "2"
        assert status(server, "cut") == status(server, "long") == "interrupted"
        assert "rosld exited while it was being recorded" in problem(server, "long")
        for name in ("flight", "speed", "gone", "cut", "long", "flight-1"):
            assert http.delete(f"/bags/{name}/").status_code == 204
        assert list(bags.iterdir()) == []
        assert server.stop() == 0
