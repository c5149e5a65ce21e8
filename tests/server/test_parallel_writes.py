"""Many concurrent writes, each on its own connection, in a folder and in memory: none is lost and none is torn.

Writes without a condition are applied in turn; of those with one, exactly as many succeed as RFC 9110 13.1 allows.
"""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence

import httpx
import pytest

from tests.server.robots.made_up import MadeUp, served

pytestmark = pytest.mark.slow

REQUESTS = 24
TURTLE = {"Content-Type": "text/turtle"}
UPDATE = {"Content-Type": "application/sparql-update"}
BINARY = {"Content-Type": "application/octet-stream"}
CONTAINER = {**TURTLE, "Link": '<http://www.w3.org/ns/ldp#BasicContainer>; rel="type"'}
P = "http://example.org/p"
SOLID = "@prefix solid: <http://www.w3.org/ns/solid/terms#> ."
EVERY = {str(number) for number in range(REQUESTS)}

Ask = Callable[[httpx.AsyncClient, int], Awaitable[httpx.Response]]


@pytest.fixture(scope="module")
def http(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A server with a data folder."""
    with served(MadeUp(), data=tmp_path_factory.mktemp("data")) as client:
        yield client


@pytest.fixture(scope="module")
def both(http: httpx.Client) -> Iterator[tuple[httpx.Client, httpx.Client]]:
    """That server, and one without a data folder, which writes without a thread."""
    with served(MadeUp()) as client:
        yield http, client


def parallel(http: httpx.Client, ask: Ask, requests: int = REQUESTS) -> list[httpx.Response]:
    """Return the answers to numbered requests, as many at once as there are connections."""

    async def run() -> list[httpx.Response]:
        limits = httpx.Limits(max_connections=REQUESTS)
        async with httpx.AsyncClient(base_url=http.base_url, limits=limits, timeout=60) as client:
            return await asyncio.gather(*(ask(client, number) for number in range(requests)))

    return asyncio.run(run())


def statuses(answers: Sequence[httpx.Response]) -> Counter[int]:
    return Counter(answer.status_code for answer in answers)


def stated(number: int) -> str:
    """A Turtle document that states a number."""
    return f'<> <{P}> "{number}" .'


def values(http: httpx.Client, url: str) -> set[str]:
    """Return the objects of `P` in a resource."""
    answer = http.get(url, headers={"Accept": "application/n-triples"})
    assert answer.status_code == 200, answer.text
    return {line.split('"')[1] for line in answer.text.splitlines() if f"<{P}>" in line}


def test_everything_put_below_one_new_container_is_created(http: httpx.Client) -> None:
    assert statuses(parallel(http, lambda c, n: c.put(f"/data/new/deep/{n}", content=stated(n), headers=TURTLE))) == {
        201: REQUESTS
    }
    listed = http.get("/data/new/deep/", headers={"Accept": "application/n-triples"}).text
    assert listed.count("<http://www.w3.org/ns/ldp#contains>") == REQUESTS
    answers = parallel(http, lambda c, n: c.put(f"/data/files/{n}", content=b"%d" % n, headers=BINARY))
    assert statuses(answers) == {201: REQUESTS}
    assert {http.get(f"/data/files/{n}").text for n in range(REQUESTS)} == EVERY


@pytest.mark.parametrize("headers", [TURTLE, BINARY, CONTAINER], ids=["RDF sources", "files", "containers"])
def test_members_posted_with_one_slug_get_different_names(
    both: tuple[httpx.Client, ...], headers: Mapping[str, str]
) -> None:
    for http in both:
        answers = parallel(http, lambda c, n: c.post("/data/", content=b"", headers={**headers, "Slug": "same"}))
        assert statuses(answers) == {201: REQUESTS}
        assert len({answer.headers["location"] for answer in answers}) == REQUESTS


@pytest.mark.parametrize(("path", "headers"), [("one", TURTLE), ("file", BINARY), ("container/", TURTLE)])
def test_the_last_of_unconditional_puts_wins(http: httpx.Client, path: str, headers: Mapping[str, str]) -> None:
    url = f"/data/last/{path}"
    answers = parallel(http, lambda c, n: c.put(url, content=stated(n), headers=headers))
    assert statuses(answers) == {201: 1, 204: REQUESTS - 1}
    found = {http.get(url).text.split('"')[1]} if headers is BINARY else values(http, url)
    assert len(found) == 1
    assert found <= EVERY


@pytest.mark.parametrize("headers", [TURTLE, BINARY], ids=["an RDF source", "a file"])
def test_exactly_one_put_that_demands_absence_succeeds(
    both: tuple[httpx.Client, ...], headers: Mapping[str, str]
) -> None:
    url = f"/data/absent/{'file' if headers is BINARY else 'source'}"
    for http in both:
        answers = parallel(http, lambda c, n: c.put(url, content=b"", headers={**headers, "If-None-Match": "*"}))
        assert statuses(answers) == {201: 1, 412: REQUESTS - 1}


def test_a_put_that_demands_absence_never_follows_an_unconditional_one(http: httpx.Client) -> None:
    """Of ten at a time, one in two with the condition: at most one of these succeeds, and then it made the resource."""

    def ask(client: httpx.AsyncClient, number: int) -> Awaitable[httpx.Response]:
        headers = {**TURTLE, "If-None-Match": "*"} if number % 2 else TURTLE
        return client.put(f"/data/mixed/{number // 10}", content=stated(number), headers=headers)

    answers = parallel(http, ask)
    for first in range(0, REQUESTS, 10):
        group = answers[first : first + 10]
        assert statuses(group)[201] == 1
        assert {answer.status_code for answer in group[1::2]} <= {201, 412}
        assert {answer.status_code for answer in group[::2]} <= {201, 204}


def patch(client: httpx.AsyncClient, url: str, number: int) -> Awaitable[httpx.Response]:
    return client.patch(url, content=f'INSERT DATA {{ <> <{P}> "{number}" }}', headers=UPDATE)


def n3_patch(client: httpx.AsyncClient, url: str, number: int) -> Awaitable[httpx.Response]:
    text = f'{SOLID} <#patch> a solid:InsertDeletePatch; solid:inserts {{ <> <{P}> "{number}" . }} .'
    return client.patch(url, content=text, headers={"Content-Type": "text/n3"})


def merge(client: httpx.AsyncClient, url: str, number: int) -> Awaitable[httpx.Response]:
    return client.post(url, content=stated(number), headers=TURTLE)


def update(client: httpx.AsyncClient, url: str, number: int) -> Awaitable[httpx.Response]:
    text = f'INSERT DATA {{ GRAPH <{url}> {{ <{url}> <{P}> "{number}" }} }}'
    return client.post("/sparql", content=text, headers=UPDATE)


@pytest.mark.parametrize(
    ("name", "ways"),
    [
        ("patched", (patch,)),
        ("container/", (patch,)),
        ("n3", (n3_patch,)),
        ("merged", (merge,)),
        ("updated", (update,)),
        ("both", (update, patch)),
    ],
)
def test_unconditional_changes_of_one_graph_are_all_applied(
    both: tuple[httpx.Client, ...], name: str, ways: Sequence[Callable[..., Awaitable[httpx.Response]]]
) -> None:
    for http in both:
        url = f"{http.base_url}data/changed/{name}"
        assert http.put(url, content="", headers=TURTLE).status_code == 201
        answers = parallel(http, lambda c, n, url=url: ways[n % len(ways)](c, url, n))
        assert statuses(answers) == {204: REQUESTS}
        assert values(http, url) == EVERY


def test_a_file_is_merged_and_replaced_as_a_whole(http: httpx.Client) -> None:
    merge = {"Content-Type": "application/merge-patch+json"}
    assert http.put("/data/object", json={}).status_code == 201
    answers = parallel(http, lambda c, n: c.patch("/data/object", content=json.dumps({str(n): n}), headers=merge))
    assert statuses(answers) == {204: REQUESTS}
    assert http.get("/data/object").json() == {str(number): number for number in range(REQUESTS)}
    assert http.put("/data/large", content=b"0" * 300_000, headers=BINARY).status_code == 201

    def ask(client: httpx.AsyncClient, number: int) -> Awaitable[httpx.Response]:
        if number % 2:
            return client.get("/data/large")
        return client.put("/data/large", content=b"%d" % (number % 10) * 300_000, headers=BINARY)

    answers = parallel(http, ask, 3 * REQUESTS)
    assert statuses(answers) == {200: 3 * REQUESTS // 2, 204: 3 * REQUESTS // 2}
    assert all(len(answer.content) == 300_000 and len(set(answer.content)) == 1 for answer in answers[1::2])


def test_exactly_one_patch_conditional_on_one_state_succeeds(http: httpx.Client) -> None:
    url = "/data/conditional"
    assert http.put(url, content="", headers=TURTLE).status_code == 201
    headers = {**UPDATE, "If-Match": http.get(url, headers={"Accept": "text/turtle"}).headers["etag"]}
    answers = parallel(http, lambda c, n: c.patch(url, content=f'INSERT DATA {{ <> <{P}> "{n}" }}', headers=headers))
    assert statuses(answers) == {204: 1, 412: REQUESTS - 1}
    assert len(values(http, url)) == 1


def test_graphs_posted_to_one_new_name_of_the_graph_store_are_merged(http: httpx.Client) -> None:
    graph = f"{http.base_url}data/new/graph"
    answers = parallel(
        http, lambda c, n: c.post(f"/graphs?graph={graph}", content=f'<{graph}> <{P}> "{n}" .', headers=TURTLE)
    )
    assert statuses(answers) == {201: 1, 204: REQUESTS - 1}
    assert values(http, "/data/new/graph") == EVERY


def test_one_of_a_container_and_a_resource_of_one_name_is_created_and_deleted_once(http: httpx.Client) -> None:
    def ask(client: httpx.AsyncClient, number: int) -> Awaitable[httpx.Response]:
        return client.put(f"/data/pairs/{number // 2}" + "/" * (number % 2), content="", headers=TURTLE)

    answers = parallel(http, ask)
    for pair in zip(answers[::2], answers[1::2], strict=True):
        assert sorted(answer.status_code for answer in pair) == [201, 409]
    assert http.put("/data/deleted", content="", headers=TURTLE).status_code == 201
    found = statuses(parallel(http, lambda c, n: c.delete("/data/deleted")))
    assert found[204] == 1
    assert set(found) <= {204, 404, 410}
