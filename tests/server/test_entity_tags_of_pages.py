"""A page depends on more than the state of its resource: its entity-tag guards no write (RFC 9110 13.1.2)."""

from __future__ import annotations

import httpx

TURTLE = {"Content-Type": "text/turtle"}


def test_the_entity_tag_of_a_page_matches_nothing_in_a_write_and_that_of_a_syntax_does(http: httpx.Client) -> None:
    url = "/data/of-a-page"
    assert http.put(url, content="<> <x:p> 1 .", headers=TURTLE).status_code == 201
    page = http.get(url, headers={"Accept": "text/html"}).headers["etag"]
    said = http.get(url, headers={"Accept": "application/ld+json"}).headers["etag"]
    two, three = "<> <x:p> 2 .", "<> <x:p> 3 ."
    assert http.put(url, content=two, headers=TURTLE | {"If-None-Match": said}).status_code == 412
    assert http.put(url, content=two, headers=TURTLE | {"If-Match": page}).status_code == 412
    assert http.put(url, content=two, headers=TURTLE | {"If-None-Match": page}).status_code == 204
    assert http.put(url, content=three, headers=TURTLE | {"If-None-Match": f"{page}, {said}"}).status_code == 204
    now = http.get(url, headers={"Accept": "application/trig"}).headers["etag"]
    assert http.put(url, content=three, headers=TURTLE | {"If-None-Match": f"{page}, {now}"}).status_code == 412
    assert http.put(url, content=two, headers=TURTLE | {"If-Match": f"{page}, {now}"}).status_code == 204
    assert http.delete(url).status_code == 204
