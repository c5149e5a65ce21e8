"""RDF sources that are put back: the client's statements are stored, and the server's are not duplicated."""

from __future__ import annotations

import httpx
import pytest

from tests.server.robots.made_up import Serving

TURTLE = {"Content-Type": "text/turtle"}
TITLE = "<http://purl.org/dc/terms/title>"
CREATED = "<http://purl.org/dc/terms/created>"
LDP = "http://www.w3.org/ns/ldp#"


def kept(http: httpx.Client, path: str) -> list[str]:
    """Return a resource as N-Triples."""
    answer = http.get(path, headers={"Accept": "application/n-triples"})
    assert answer.status_code == 200, answer.text
    return answer.text.splitlines()


@pytest.fixture
def http(serving: Serving) -> httpx.Client:
    return serving()


def test_words_that_look_like_the_servers_are_kept_where_they_are_none(http: httpx.Client) -> None:
    url = f"{http.base_url}data/x"
    said = [
        f'<{url}> {TITLE} "<{LDP}contains> {CREATED} << >>" .',
        f'<{url}#part> {CREATED} "yesterday" .',
        f"<{url}#part> <{LDP}contains> <{url}> .",
    ]
    for status in (201, 204):
        assert http.put("/data/x", content="\n".join(said), headers=TURTLE).status_code == status
        assert set(said) <= set(kept(http, "/data/x"))


def test_containment_and_triples_about_triples_are_refused(http: httpx.Client) -> None:
    assert http.put("/data/x", content="", headers=TURTLE).status_code == 201
    assert http.put("/data/x", content=f"<> <{LDP}contains> <#y> .", headers=TURTLE).status_code == 409
    for path in ("/data/x", "/data/y"):
        answer = http.put(path, content=f"<> {TITLE} <<( <#a> <#b> <#c> )>> .", headers=TURTLE)
        assert answer.status_code == 422
        assert "constrainedBy" in answer.headers["link"]
