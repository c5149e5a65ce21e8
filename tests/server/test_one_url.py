"""Each resource has one URL: every readable URL is the one that its document states."""

from __future__ import annotations

import http.client
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.server.conftest import Served

pytestmark = pytest.mark.slow

ALSO = (
    "/ontology", "/sparql", "/style.css", "/live.js", "/icon.svg", "/favicon.ico", "/openapi.json", "/.well-known/wot",
)  # fmt: skip
"""Resources in no container."""
DOTS = ("", ".", "..", "~", "~.", "~..", "~~")
ESCAPED = ("%7E", "%7e", "%2F", "%2f", "%2E", "a%2Fb", "night%2F", "%20", "%00", "~%2F")
SEGMENTS = st.sampled_from(DOTS + ESCAPED)


@pytest.fixture(scope="module")
def get(start_server: Callable[..., Served]) -> Iterator[Callable[[str], tuple[int, str]]]:
    """Request a path exactly as it is written; return the status, and the body as N-Triples if it is RDF."""
    url = start_server("aircraft").url
    kinds = {"data/one/file": "image/png", "data/a%3Ab": "text/turtle", "data/~~": "text/turtle"}
    parameters = dict.fromkeys(("parameters/deep/er/est", "parameters/a%3Ab"), "application/json")
    for path, kind in (kinds | parameters).items():
        body = b"1" if path in parameters else b""
        assert httpx.put(url + path, content=body, headers={"Content-Type": kind}).status_code == 201
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=15)

    def read(path: str) -> tuple[int, str]:
        connection.putrequest("GET", path, skip_accept_encoding=True)
        connection.putheader("Accept", "application/n-triples, */*;q=0.1")
        connection.endheaders()
        answer = connection.getresponse()
        body = answer.read().decode("utf-8", "replace")
        return answer.status, body if answer.status == 200 else str(answer.headers["location"])

    yield read
    connection.close()


@pytest.fixture(scope="module")
def known(get: Callable[[str], tuple[int, str]]) -> list[str]:
    """Return the paths of all members of containers, found from the entry on."""
    found: dict[str, None] = {}
    due = ["/", "/data/", "/parameters/", "/topics/", "/nodes/", "/services/", "/resources/", "/types/", "/shapes/"]
    due += ["/calls/", "/mappings/", "/queries/", "/bags/", "/channels/", *ALSO]
    while due:
        path = due.pop(0)
        if path in found or (path.startswith("/queries/") and path != "/queries/"):
            continue
        found[path] = None
        status, body = get(path)
        if status == 200 and path.endswith("/") and path.count("/") < 5:
            contained = (line.split() for line in body.splitlines() if "ldp#contains>" in line)
            due += [urlsplit(words[2].strip("<>")).path for words in contained]
    return list(found)


def said(body: str) -> set[str]:
    """Return the paths of the URLs in RDF."""
    return {urlsplit(line.split()[0].strip("<>")).path for line in body.splitlines() if line.startswith("<")}


def test_what_containers_contain_is_read_at_the_urls_they_tell(
    get: Callable[[str], tuple[int, str]], known: list[str]
) -> None:
    assert len(known) > 60
    read = {path: get(path) for path in known}
    assert {path for path, (status, _) in read.items() if status != 200} == set()
    assert sum(path in said(body) for path, (_, body) in read.items()) > 50


def changed(path: str, at: int, segment: str, how: str) -> str:
    """Return a path with an additional segment, or in another spelling."""
    parts = path.split("/")
    place = 1 + at % max(1, len(parts) - 1)
    match how:
        case "inserted":
            return "/".join([*parts[:place], segment, *parts[place:]])
        case "replaced":
            return "/".join([*parts[:place], segment, *parts[place + 1 :]])
        case "appended":
            return "/".join([*parts[:place], parts[place] + segment, *parts[place + 1 :]])
        case "encoded":
            letter = parts[place][:1]
            escaped = f"%{ord(letter):02X}" if letter and letter != "%" else letter
            return "/".join([*parts[:place], escaped + parts[place][1:], *parts[place + 1 :]])
        case "decoded":
            return path.replace("%3A", ":").replace("%2F", "/").replace("%7E", "~")
        case "lowered":
            return path.replace("%3A", "%3a")
        case _:
            return path.rstrip("/") if path.endswith("/") and path != "/" else path + "/"


HOW = st.sampled_from(("inserted", "replaced", "appended", "encoded", "decoded", "lowered", "slashed"))


def test_whatever_is_read_is_read_at_its_own_url(get: Callable[[str], tuple[int, str]], known: list[str]) -> None:
    @settings(suppress_health_check=list(HealthCheck), derandomize=True)
    @given(st.sampled_from(known), st.lists(st.tuples(st.integers(0, 6), SEGMENTS, HOW), min_size=1, max_size=3))
    def attempt(path: str, changes: list[tuple[int, str, str]]) -> None:
        for change in changes:
            path = changed(path, *change)
        if path.startswith("/"):
            status, body = get(path)
            assert status != 200 or path in known or path in said(body), f"{path} is read"

    attempt()


def test_a_url_that_is_spelt_otherwise_leads_to_the_one_there_is_and_one_with_empty_parts_to_none(
    get: Callable[[str], tuple[int, str]],
) -> None:
    for path, own in (
        ("/data/a:b", "/data/a%3Ab"),
        ("/data/a%3ab?format=ttl", "/data/a%3Ab?format=ttl"),
        ("/%74opics/", "/topics/"),
        ("/parameters/a:b", "/parameters/a%3Ab"),
        ("/parameters/cockpit/%6Eight", "/parameters/cockpit/night"),
    ):
        status, location = get(path)
        assert status == 308
        assert location.endswith(own)
        assert urlsplit(location).path == own.partition("?")[0]
    parameters = ("~/", "~/~/", "~/cockpit/night", "cockpit/~/night", "cockpit/~")
    others = ("/resources/~/", "/resources/aircraft/~/", "/topics/~/~/", "/nodes/~/", "/data/~/")
    for path in (*(f"/parameters/{each}" for each in parameters), *others):
        assert get(path)[0] == 404, path


def test_no_parameter_is_made_beside_another(own_aircraft: httpx.Client) -> None:
    for path in ("/parameters/cockpit%2Fnight", "/parameters/~/new", "/parameters/new/~"):
        assert own_aircraft.put(path, json=1).status_code in (400, 404), path
    assert own_aircraft.get("/parameters/new").status_code == 404
    image = {"Content-Type": "image/png"}
    assert own_aircraft.put("/data/x:y", content=b"1", headers=image).status_code == 201
    assert own_aircraft.get("/data/x%3Ay").content == b"1"
