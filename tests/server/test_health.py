"""`/healthz` and `/readyz`: for probes of containers and of systemd, which know only an address."""

from __future__ import annotations

from pathlib import Path

import httpx

from rosld.server.app import create_app
from rosld.server.settings import Settings
from tests.server.auth.conftest import rule, token, tokens
from tests.server.robots.made_up import MadeUp, Serving, served
from tests.waiting import until

JSON = {"Accept": "application/json"}


def test_a_server_is_healthy_and_ready_in_text_and_in_json(serving: Serving) -> None:
    http = serving()
    assert (http.get("healthz").text, http.get("readyz").text) == ("ok\n", "ready\n")
    assert http.get("healthz", headers=JSON).json() == {"status": "ok"}
    assert http.get("readyz", headers=JSON).json() == {"status": "ready", "robot": "live", "queries": "up"}
    for path in ("healthz", "readyz"):
        assert http.get(path).headers["cache-control"] == "no-store"
        assert (http.head(path).status_code, http.head(path).content) == (200, b"")
        assert http.post(path).status_code == 405
        assert http.options(path).headers["allow"] == "GET, HEAD, OPTIONS"
        assert http.get("openapi.json").json()["paths"][f"/{path}"]["get"]


def test_a_server_whose_robot_is_away_is_healthy_but_not_ready_and_does_not_say_why(
    robot: MadeUp, serving: Serving
) -> None:
    http = serving()
    robot.goes_stale("the host secret.example does not answer")
    until(lambda: http.get("readyz").status_code == 503, "the robot is away")
    refusal = http.get("readyz")
    assert refusal.headers["content-type"] == "application/problem+json"
    assert (refusal.json()["robot"], refusal.json()["queries"]) == ("stale", "up")
    assert refusal.json()["detail"] == "Not ready: robot stale, queries up."
    assert "secret" not in refusal.text
    assert http.get("readyz", headers={"Accept": "text/plain"}).text == "not ready: robot stale, queries up\n"
    assert http.get("healthz").text == "ok\n"


def test_probes_need_no_token_no_name_and_leave_no_trace(tmp_path: Path, robot: MadeUp) -> None:
    auth = tmp_path / "auth.toml"
    auth.write_text(rule("admin", "read", "/**") + tokens("admin"))
    with served(robot, auth=auth) as http:
        by_address = {"Host": "10.1.2.3:8080", "Origin": "http://elsewhere.example"}
        for path in ("healthz", "readyz"):
            assert http.get(path, headers=by_address).status_code == 200
            assert http.post(path).status_code == 401
        assert http.get("topics/", headers=by_address).status_code == 421
        as_admin = {"Authorization": f"Bearer {token('admin')}", **JSON}
        assert "healthz" not in http.get("activity/", headers=as_admin).text
        counted = http.get("metrics", headers=as_admin | {"Accept": "text/plain"}).text
        assert 'method="POST",route="/healthz"' in counted
        assert 'method="GET",route="/healthz"' not in counted


async def test_a_server_is_not_ready_while_its_query_process_is_away(robot: MadeUp) -> None:
    transport = httpx.ASGITransport(create_app(robot, Settings()))
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8080/") as http:
        refusal = await http.get("readyz")
        assert (refusal.status_code, refusal.json()["queries"]) == (503, "down")
        assert (await http.get("healthz")).status_code == 200
