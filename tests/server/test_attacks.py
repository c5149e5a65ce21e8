"""Named attempts to circumvent permissions: refused, with the robot unchanged."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable, Iterator
from urllib.parse import quote

import httpx
import pytest

from rosld.server.html.forms import METHOD_FIELD
from rosld.server.http.origin import CSRF_FIELD
from tests.server.auth.conftest import RULES, TURTLE, Guarded, clients, guard, token, tokens
from tests.server.conftest import Served

pytestmark = pytest.mark.slow

__all__ = ["guard", "tokens"]

DENIED = "/topics/cockpit/display"
NOTHING = "Not found, or not visible to you."


@pytest.fixture(scope="module")
def guarded(guard: Callable[..., Guarded]) -> Iterator[Guarded]:
    found = guard(RULES, "reader", "commander", "admin")
    before = found["admin"].get("/resources/aircraft/power", headers={"Accept": "application/json"}).content
    yield found
    after = found["admin"].get("/resources/aircraft/power", headers={"Accept": "application/json"}).content
    assert after == before, "the robot was moved"


def raw(guarded: Guarded, request: bytes) -> bytes:
    """Return the beginning of the response to bytes that no client library would send."""
    host, port = guarded.url.removeprefix("http://").rstrip("/").split(":")
    with socket.create_connection((host, int(port)), timeout=5) as sock:
        sock.sendall(request)
        return sock.recv(65536)


SPELLINGS = (
    "/topics/cockpit%2Fdisplay", "/topics/cockpit%2fdisplay", "/topics/aircraft/../cockpit/display",
    "/topics/aircraft/%2e%2e/cockpit/display", "/topics/./cockpit/display", "/topics//cockpit/display",
    "//topics/cockpit/display", "/topics/cockpit//display", "/topics/~/cockpit/display", "/topics/cockpit/display/",
    "/topics/cockpit/display;x", "/topics/cockpit/display%00", "/%74opics/cockpit/display",
    "/topics/%63ockpit/display", "/topics/cockpit%5Cdisplay", "/Topics/cockpit/display", "/topics/Cockpit/display",
    "/topics/\u0441ockpit/display", "/topics/\uff43ockpit/display", "/topics/cockpit\u200b/display",
    "/topics/cockpit%252Fdisplay", "/topics/cockpit", "/topics/cockpit/display?format=json",
    "/topics/cockpit/display?field=data", "/topics/%E0%80%AF",
)  # fmt: skip


def test_no_spelling_of_a_path_leads_past_a_denial(guarded: Guarded) -> None:
    refused = {b"GET": (b"400", b"404"), b"PUT": (b"400", b"403", b"404", b"405", b"415")}
    refused[b"POST"] = refused[b"PUT"]
    wrong = []
    for path in SPELLINGS:
        target = quote(path, safe="/%?=;~").encode()
        for method, statuses in refused.items():
            sent = method + b" " + target + b" HTTP/1.1\r\nHost: " + guarded.url[7:-1].encode()
            sent += b"\r\nAuthorization: Bearer " + token("reader").encode() + b"\r\nConnection: close\r\n"
            answer = raw(guarded, sent + (b"\r\n" if method == b"GET" else b"Content-Length: 0\r\n\r\n"))
            if answer.split()[1] not in statuses or b"std_msgs" in answer:
                wrong.append((path, method, answer[:200]))
    assert not wrong, wrong


def test_headers_that_claim_another_path_host_method_or_user_change_nothing(guarded: Guarded) -> None:
    claims = {
        "X-Original-URL": "/topics/", "X-Rewrite-URL": "/topics/", "X-Forwarded-For": "127.0.0.1",
        "X-Forwarded-User": "admin",
        "X-HTTP-Method-Override": "DELETE", "Forwarded": "for=127.0.0.1;host=localhost", "X-Remote-User": "admin",
        "Remote-User": "admin", "Cookie": f"token={token('admin')}",
    }  # fmt: skip
    assert guarded["anybody"].get(DENIED, headers=claims).status_code == 401
    assert guarded["reader"].get(DENIED, headers=claims).json()["detail"] == NOTHING


def test_a_token_in_the_url_is_no_token(guarded: Guarded) -> None:
    for name in ("access_token", "token", "authorization"):
        assert guarded["anybody"].get("/topics/", params={name: token("admin")}).status_code == 401


def test_a_redirect_leads_nobody_to_what_they_may_not_know(guarded: Guarded) -> None:
    assert guarded["reader"].get("/topics/cockpit", follow_redirects=False).json()["detail"] == NOTHING
    assert guarded["reader"].get("/topics/aircraft/engine", follow_redirects=False).status_code == 308


def test_a_page_of_another_site_does_nothing_with_the_password_that_a_browser_remembers(guarded: Guarded) -> None:
    form = {"Content-Type": "application/x-www-form-urlencoded"}
    for path in ("/services/aircraft/start", "/resources/aircraft/start"):
        for origin in ("https://evil.example", guarded.url.rstrip("/")):  # the token of the page's own form is missing
            sent = guarded["anybody"].post(path, headers={**form, "Origin": origin}, auth=("admin", token("admin")))
            assert sent.status_code == 403


def test_the_token_of_one_agents_form_is_no_good_for_another(guarded: Guarded) -> None:
    page = guarded["commander"].get("/services/aircraft/start", headers={"Accept": "text/html"}).text
    value = re.findall(f'name="{CSRF_FIELD}" value="([^"]+)"', page)[-1]
    form = {"Content-Type": "application/x-www-form-urlencoded", "Origin": guarded.url.rstrip("/")}
    body = f"{CSRF_FIELD}={quote(value)}&{METHOD_FIELD}=POST"
    sent = guarded["admin"].post("/services/aircraft/start", headers=form, content=body)
    assert sent.status_code == 403


def test_what_one_may_not_read_is_not_read_by_way_of_others(guarded: Guarded) -> None:
    reader = guarded["reader"]
    secret = f"{guarded.url}data/secret/plan"
    kept = guarded["admin"].put("/data/secret/plan", content="<> <urn:p> 'gold' .", headers=TURTLE)
    assert kept.status_code == 201
    update = {"Content-Type": "application/sparql-update"}
    ways = [
        reader.get("/graphs", params={"graph": secret}),
        reader.get("/graphs", params={"graph": "/data/open/../secret/plan"}),
        reader.get("/graphs", params={"graph": f"{guarded.url}data/%73ecret/plan"}),
        reader.post("/sparql", data={"query": f"CONSTRUCT WHERE {{ GRAPH <{secret}> {{ ?s ?p ?o }} }}"}),
        reader.post("/sparql", data={"query": "SELECT * { ?s ?p 'gold' }"}),
        reader.post("/sparql", data={"query": f"DESCRIBE <{secret}>"}),
        reader.get("/sparql", params={"query": "SELECT * { ?s ?p ?o }", "default-graph-uri": secret}),
        reader.get("/sparql", params={"query": "SELECT * { GRAPH ?g { ?s ?p ?o } }", "named-graph-uri": secret}),
        reader.get("/data/", headers={"Prefer": "return=representation; max-member-count=1"}, follow_redirects=True),
        reader.post("/sparql", content=f"COPY <{secret}> TO </data/x>", headers=update),
        reader.post("/sparql", content=f"LOAD <{secret}> INTO GRAPH </data/x>", headers=update),
        reader.put("/data/link", content=f"<> <http://example.org/p> <{secret}> .", headers=TURTLE),
        reader.get("/data/link"),
    ]
    assert not any("gold" in answer.text for answer in ways)
    assert "secret" not in ways[-1].text


def test_guessing_tokens_gets_nobody_in_and_tells_nothing_apart(guarded: Guarded) -> None:
    near = token("admin")
    tries = [near[:-1], near + "x", near.upper(), near[:3], "rosld_" + "A" * 43]
    answers = {guarded["anybody"].get("/", headers={"Authorization": f"Bearer {each}"}).text for each in tries}
    assert len(answers) == 1


def test_without_auth_a_server_takes_no_heed_of_tokens(aircraft: Served) -> None:
    with httpx.Client(base_url=aircraft.url, headers={"Authorization": "Bearer x"}) as client:
        answer = client.get("/")
        assert answer.status_code == 200
        assert "wac-allow" not in answer.headers
        assert client.get("/acl").status_code == 404
    assert set(clients(aircraft.url)) == {"anybody"}
