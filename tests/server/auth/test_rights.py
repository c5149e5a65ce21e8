"""Permissions over HTTP: refusals, their form, and that they reveal nothing."""

from __future__ import annotations

import base64
import time
from collections.abc import Callable

import httpx
import pytest

from tests.server.auth.conftest import AGENTS, RULES, TURTLE, Guarded, token, tokens

JSON = {"Content-Type": "application/json"}
HIDDEN = [
    "/topics/cockpit/display",
    "/data/secret/plan",
    "/services/aircraft/start",
    "/nodes/aircraft",
    "/acl",
    "/types/",
]
NOT_THERE = [
    "/topics/cockpit/nothing",
    "/data/secret/no",
    "/services/aircraft/no",
    "/nodes/no",
    "/nowhere",
    "/types/no/",
]
ODD = ["/topics/cockpit/..%2Fx", "/topics//cockpit/display", "/services/%zz", "/%74opics/cockpit/display"]


def seen(answer: httpx.Response) -> tuple[int, bytes, list[tuple[str, str]]]:
    """Return a response without its varying parts."""
    return (
        answer.status_code,
        answer.content,
        sorted((name, value) for name, value in answer.headers.items() if name not in ("date", "x-request-id")),
    )


@pytest.mark.slow
def test_what_one_may_not_know_of_is_refused_in_the_same_bytes_whether_it_is_there_or_not(guarded: Guarded) -> None:
    for method in ("GET", "HEAD", "OPTIONS", "PUT", "POST", "PATCH", "DELETE"):
        for agent, status in (("anybody", 401), ("reader", 404)):
            answers = {
                str(
                    seen(guarded[agent].request(method, path, headers=JSON, content=b"{}" if method != "GET" else None))
                )
                for path in HIDDEN + NOT_THERE + ODD
            }
            assert len(answers) == 1, (method, agent, answers)
            assert answers.pop().startswith(f"({status},")


def test_what_is_not_there_where_one_may_know_is_told_in_the_same_bytes_as_what_rules_about_types_hide(
    guarded: Guarded,
) -> None:
    there = seen(guarded["typist"].get("/services/aircraft/engine/set_speed"))
    absent = seen(guarded["typist"].get("/services/aircraft/engine/get_nothing"))
    assert there == absent
    assert there[0] == 404
    assert guarded["typist"].get("/services/aircraft/start").status_code == 200


def test_what_proves_nothing_is_refused_even_where_anybody_may_read(guarded: Guarded) -> None:
    for field in (
        "Bearer wrong",
        "Bearer",
        "Bearer a b",
        "Basic !!!",
        "Basic " + base64.b64encode(b"reader").decode(),
        "Basic " + base64.b64encode(f"admin:{token('reader')}".encode()).decode(),
        "Digest x",
        "token-of-admin",
        "Bearer token-of-admin, Bearer token-of-reader",
        "Bearer " + "x" * 20000,
        "Bearer a.b.c",
        "Bearer eyJhbGciOiJub25lIn0.eyJpc3MiOiJ4In0.",
    ):
        answer = guarded["anybody"].get("/", headers={"Authorization": field})
        assert answer.status_code in (401, 431)
        if answer.status_code == 401:
            assert 'error="invalid_token"' in answer.headers["www-authenticate"]
            assert "wac-allow" not in answer.headers


def test_401_asks_for_a_token_which_is_also_the_password_of_basic_for_browsers(guarded: Guarded) -> None:
    asked = guarded["anybody"].get("/topics/").headers["www-authenticate"]
    assert asked == 'Bearer realm="rosld", Basic realm="rosld", charset="UTF-8"'
    for name in ("reader", ""):
        answer = guarded["anybody"].get("/topics/", auth=(name, token("reader")))
        assert answer.status_code == 200


def test_405_is_for_what_the_resource_cannot_and_403_for_what_the_agent_may_not(guarded: Guarded) -> None:
    sensor, command = "/topics/aircraft/engine/speed", "/services/aircraft/start"
    assert guarded["admin"].put(sensor, json={"data": 1}).status_code == 405
    assert guarded["reader"].put(sensor, json={"data": 1}).status_code == 405
    assert guarded["reader"].put(f"{sensor}x", json={"data": 1}).status_code in (403, 404)
    assert guarded["commander"].delete(command).status_code == 405
    assert guarded["commander"].put("/data/open/plan", content="", headers=TURTLE).status_code == 403
    assert guarded["anybody"].delete("/").status_code == 405


@pytest.mark.slow
def test_allow_and_wac_allow_say_what_this_agent_may_do(guarded: Guarded) -> None:
    topic = "/services/aircraft/start"
    assert guarded["commander"].head(topic).headers["allow"] == "GET, HEAD, OPTIONS, POST"
    assert guarded["commander"].head("/data/open/plan").headers["allow"] == "GET, HEAD, OPTIONS"
    assert "accept-patch" not in guarded["commander"].head("/data/open/plan").headers
    reading = guarded["reader"].head("/data/open/plan").headers
    assert reading["wac-allow"] == 'user="read append write", public=""'
    assert "DELETE" in reading["allow"]
    assert guarded["anybody"].head("/").headers["wac-allow"] == 'user="read", public="read"'
    assert f'<{guarded.url}acl>; rel="acl"' in reading["link"]
    assert "Authorization" in reading["vary"]


def test_the_rules_are_there_for_those_who_administer_without_what_agents_prove_themselves_with(
    guarded: Guarded,
) -> None:
    answer = guarded["admin"].get("/acl", headers={"Accept": "text/turtle"})
    assert answer.status_code == 200
    assert "acl:Authorization" in answer.text
    assert "sha256" not in answer.text
    assert guarded["commander"].get("/acl").status_code == 403


def test_a_write_to_a_tree_takes_the_right_to_everything_below_it(guarded: Guarded) -> None:
    patch = {"Content-Type": "application/merge-patch+json"}
    assert guarded["reader"].patch("/parameters/", content=b'{"a": 1}', headers=patch).status_code == 403
    assert guarded["admin"].patch("/parameters/", content=b'{"a": 1}', headers=patch).status_code == 204
    assert guarded["reader"].put("/parameters/a", json=2).status_code == 204
    assert guarded["reader"].delete("/parameters/a").status_code == 204


def test_a_preflight_says_nothing_of_what_is_there(guard: Callable[..., Guarded]) -> None:
    shared = guard(RULES, *AGENTS, options=("--cors-origin", "https://app.example"))
    asked = {"Origin": "https://app.example", "Access-Control-Request-Method": "PUT"}
    there, absent = (shared["anybody"].options(path, headers=asked) for path in ("/topics/cockpit/display", "/no/no"))
    assert seen(there) == seen(absent)
    assert "Authorization" in there.headers["access-control-allow-headers"]
    assert "allow" not in there.headers


@pytest.mark.slow
def test_rights_are_read_again_when_the_file_changes_and_stay_when_it_cannot_be_read(
    guard: Callable[..., Guarded],
) -> None:
    found = guard('[[rule]]\nagents = ["reader"]\nmodes = ["read"]\npaths = ["/topics/**"]\n', "reader")
    assert found["reader"].get("/topics/").status_code == 200
    found.file.write_text("[[rule]]\nagents = nonsense")
    time.sleep(2.5)
    assert found["reader"].get("/topics/").status_code == 200
    found.file.write_text(tokens("reader"))
    deadline = time.monotonic() + 10
    while found["reader"].get("/topics/").status_code != 404 and time.monotonic() < deadline:
        time.sleep(0.1)
    assert found["reader"].get("/topics/").status_code == 404
