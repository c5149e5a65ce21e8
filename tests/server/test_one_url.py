"""Each resource has one URL: whatever can be read is read at the URL that it says is its own."""

from __future__ import annotations

import http.client
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

ALSO = (
    "/ontology",
    "/sparql",
    "/style.css",
    "/live.js",
    "/icon.svg",
    "/favicon.ico",
    "/openapi.json",
    "/.well-known/wot",
)
"""What no container contains."""
SEGMENTS = st.sampled_from(
    (
        "~",
        "~.",
        "~..",
        "~~",
        "%7E",
        "%7e",
        "%2F",
        "%2f",
        "%2E",
        ".",
        "..",
        "",
        "a%2Fb",
        "night%2F",
        "%20",
        "%00",
        "~%2F",
    )
)


@pytest.fixture(scope="module")
def get(start_server: Callable[..., object]) -> Iterator[Callable[[str], tuple[int, str]]]:
    """Reads a path exactly as it is written: the status, and the body as N-Triples where there is RDF."""
    served = start_server("aircraft")
    url = served.url  # type: ignore[attr-defined]
    for path in ("data/one/file", "data/a%3Ab", "data/~~", "parameters/deep/er/est", "parameters/a%3Ab"):
        media_type = {"data/one/file": "image/png", "data/a%3Ab": "text/turtle", "data/~~": "text/turtle"}
        body = b"" if path.startswith("data") else b"1"
        kind = media_type.get(path, "application/json")
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
    """Paths of everything that containers contain, found by following them from the entry on."""
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
    """The paths of the URLs that RDF tells of."""
    return {urlsplit(line.split()[0].strip("<>")).path for line in body.splitlines() if line.startswith("<")}


def test_what_containers_contain_is_read_at_the_urls_they_tell(
    get: Callable[[str], tuple[int, str]], known: list[str]
) -> None:
    assert len(known) > 60
    told = 0
    for path in known:
        status, body = get(path)
        assert status == 200, path
        told += path in said(body)
    assert told > 50


def changed(path: str, at: int, segment: str, how: str) -> str:
    """A path with a segment more, or spelt otherwise."""
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
    @settings(max_examples=400, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
    @given(st.sampled_from(known), st.lists(st.tuples(st.integers(0, 6), SEGMENTS, HOW), min_size=1, max_size=3))
    def attempt(path: str, changes: list[tuple[int, str, str]]) -> None:
        for change in changes:
            path = changed(path, *change)
        if path.startswith("/"):
            status, body = get(path)
            assert status != 200 or path in known or path in said(body), f"{path} is read"

    attempt()


@pytest.mark.parametrize(
    "path",
    [
        "/parameters/~/",
        "/parameters/~/~/",
        "/parameters/~/cockpit/night",
        "/parameters/cockpit/~/night",
        "/parameters/cockpit/~",
        "/resources/~/",
        "/resources/aircraft/~/",
        "/topics/~/~/",
        "/nodes/~/",
        "/data/~/",
    ],
)
def test_a_name_with_empty_parts_is_not_the_one_without(path: str, get: Callable[[str], tuple[int, str]]) -> None:
    assert get(path)[0] == 404


@pytest.mark.parametrize(
    ("path", "own"),
    [
        ("/data/a:b", "/data/a%3Ab"),
        ("/data/a%3ab?format=ttl", "/data/a%3Ab?format=ttl"),
        ("/%74opics/", "/topics/"),
        ("/parameters/a:b", "/parameters/a%3Ab"),
        ("/parameters/cockpit/%6Eight", "/parameters/cockpit/night"),
    ],
)
def test_a_url_that_is_spelt_otherwise_leads_to_the_one_there_is(
    path: str, own: str, get: Callable[[str], tuple[int, str]]
) -> None:
    status, location = get(path)
    assert status == 308
    assert location.endswith(own)
    assert urlsplit(location).path == own.partition("?")[0]


def test_no_parameter_is_made_beside_another(serve: Callable[..., object]) -> None:
    client: httpx.Client = serve("aircraft").http  # type: ignore[attr-defined]
    for path in ("/parameters/cockpit%2Fnight", "/parameters/~/new", "/parameters/new/~"):
        assert client.put(path, json=1).status_code in (400, 404), path
    assert client.get("/parameters/new").status_code == 404
    assert client.put("/data/x:y", content=b"1", headers={"Content-Type": "image/png"}).status_code == 201
    assert client.get("/data/x%3Ay").content == b"1"
