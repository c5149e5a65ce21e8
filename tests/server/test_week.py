"""Days of service in seconds: a restart, new tokens, a new certificate and a jump of the clock on each day.

Robots that go away are in `tests/adapters/ros1/test_survival.py`, full disks in `tests/server/disks`.
"""

from __future__ import annotations

import ssl
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner

from rosld.server.auth import authenticator
from rosld.server.cli.main import main
from rosld.server.serving import http_server
from tests.server.auth.test_files import certificate
from tests.server.disks.server import free_port
from tests.waiting import until

pytestmark = pytest.mark.slow

SPEED = "/topics/aircraft/engine/speed"
ALL = '[[rule]]\nagents = ["anna"]\nmodes = ["read", "write", "control", "administer"]\npaths = ["/**"]\n'
JUMPS = (3600, 30 * 86400, -365 * 86400)
"""Seconds by which the clock of the computer is wrong, for each day."""


def new_token(auth: Path) -> str:
    """Replace the token of anna."""
    for words in (("remove", "anna"), ("add", "anna")):
        result = CliRunner().invoke(main, ["token", *words, "--file", str(auth)])
    assert result.exit_code == 0, result.output
    return result.stdout.strip()


def test_days_of_restarts_rotations_and_wrong_clocks_lose_no_write_and_need_nobody(
    serve: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(http_server, "CERTIFICATE_SECONDS", 0.05)
    monkeypatch.setattr(authenticator, "_POLL_SECONDS", 0.05)
    now, now_ns = time.time, time.time_ns
    port, auth = free_port(), tmp_path / "auth.toml"
    cert, key = certificate(tmp_path)
    auth.write_text(ALL)
    token = new_token(auth)
    options = ("--tls-cert", str(cert), "--tls-key", str(key), "--auth", str(auth), "--data", str(tmp_path / "data"))
    for day, jump in enumerate(JUMPS):
        served = serve("aircraft", "--port", str(port), "--history", SPEED.removeprefix("/topics"), *options)
        base = f"https://localhost:{port}"

        def client(trusted: Path = cert, base: str = base) -> httpx.Client:
            return httpx.Client(base_url=base, verify=ssl.create_default_context(cafile=str(trusted)))

        monkeypatch.setattr(time, "time", lambda jump=jump: now() + jump)
        monkeypatch.setattr(time, "time_ns", lambda jump=jump: now_ns() + jump * 10**9)
        former, token = token, new_token(auth)
        with client() as before:
            assert before.get("/healthz").status_code == 200
            certificate(tmp_path)
            until(lambda: accepts(client), "the new certificate")
            until(lambda token=token: answer(before, token) == 200, "the new token")
            assert answer(before, former) == 401
            before.headers["Authorization"] = f"Bearer {token}"
            assert before.put(f"/data/day{day}", content=f"<> <urn:day> {day} .", headers=TURTLE).status_code == 201
            for each in range(day + 1):
                assert f"<urn:day> {each} " in before.get(f"/data/day{each}", headers={"Accept": "text/turtle"}).text
            assert before.post("/services/aircraft/start").status_code == 201
            assert before.put(SPEED, json={"data": 1.0}).status_code == 405
            assert before.get(SPEED, headers={"Accept": "application/json"}).json() == {"data": 0.0}
            assert before.get("/readyz").status_code == 200
        assert served.stop() == 0
    errors = [each.getMessage() for each in caplog.records if each.levelname == "ERROR"]
    assert not [each for each in errors if "--tls-key" not in each], errors  # a key is written after its certificate


TURTLE = {"Content-Type": "text/turtle"}


def accepts(client: Callable[[], httpx.Client]) -> bool:
    """Whether the server has the certificate that the client trusts."""
    try:
        with client() as fresh:
            return fresh.get("/healthz").status_code == 200
    except httpx.ConnectError:
        return False


def answer(client: httpx.Client, token: str) -> int:
    return client.get("/", headers={"Authorization": f"Bearer {token}"}).status_code
