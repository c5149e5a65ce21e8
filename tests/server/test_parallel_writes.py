"""Many writes at once that harm nobody, over 24 connections, in memory and in a folder.

Writes without a condition are applied in turn; of those with one exactly as many succeed as RFC 9110 13.1 allows.
"""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

import httpx
import pytest

from tests.server.robots.made_up import Serving

CONNECTIONS = 24
REQUESTS = 3 * CONNECTIONS
MANY = 4 * CONNECTIONS
TURTLE = {"Content-Type": "text/turtle"}
UPDATE = {"Content-Type": "application/sparql-update"}
N3 = {"Content-Type": "text/n3"}
MERGE = {"Content-Type": "application/merge-patch+json"}
BINARY = {"Content-Type": "application/octet-stream"}
P = "http://example.org/p"
SOLID = "@prefix solid: <http://www.w3.org/ns/solid/terms#> ."

Ask = Callable[[httpx.AsyncClient, int], Awaitable[httpx.Response]]


@pytest.fixture(params=["in memory", "in a folder"])
def http(request: pytest.FixtureRequest, serving: Serving, tmp_path: Path) -> httpx.Client:
    return serving(data=None if request.param == "in memory" else tmp_path)


def parallel(http: httpx.Client, ask: Ask, requests: int = REQUESTS) -> list[httpx.Response]:
    """The answers to numbered requests, of which as many are under way as there are connections."""

    async def run() -> list[httpx.Response]:
        limits = httpx.Limits(max_connections=CONNECTIONS, max_keepalive_connections=CONNECTIONS)
        async with httpx.AsyncClient(base_url=http.base_url, limits=limits, timeout=60) as client:
            return await asyncio.gather(*(ask(client, number) for number in range(requests)))

    return asyncio.run(run())


def statuses(answers: Sequence[httpx.Response]) -> Counter[int]:
    return Counter(answer.status_code for answer in answers)


def values(http: httpx.Client, url: str) -> set[str]:
    """The objects of `P` that a resource states."""
    answer = http.get(url, headers={"Accept": "application/n-triples"})
    assert answer.status_code == 200, answer.text
    return {line.split('"')[1] for line in answer.text.splitlines() if f"<{P}>" in line}


EVERY = {str(number) for number in range(REQUESTS)}


def test_resources_put_below_one_new_container_are_all_made(http: httpx.Client) -> None:
    answers = parallel(
        http, lambda c, n: c.put(f"/data/new/deep/{n}", content=f'<> <{P}> "{n}" .', headers=TURTLE), requests=MANY
    )
    assert statuses(answers) == {201: MANY}
    listed = http.get("/data/new/deep/", headers={"Accept": "application/n-triples"}).text
    assert listed.count("<http://www.w3.org/ns/ldp#contains>") == MANY


def test_files_put_below_one_new_container_are_all_made(http: httpx.Client) -> None:
    answers = parallel(http, lambda c, n: c.put(f"/data/files/{n}", content=b"%d" % n, headers=BINARY))
    assert statuses(answers) == {201: REQUESTS}
    assert {http.get(f"/data/files/{n}").content for n in range(REQUESTS)} == {b"%d" % n for n in range(REQUESTS)}


@pytest.mark.parametrize("headers", [TURTLE, BINARY], ids=["RDF sources", "files"])
def test_members_posted_with_one_slug_get_different_names(http: httpx.Client, headers: dict[str, str]) -> None:
    answers = parallel(
        http, lambda c, n: c.post("/data/", content=b"", headers={**headers, "Slug": "same"}), requests=MANY
    )
    assert statuses(answers) == {201: MANY}
    assert len({answer.headers["location"] for answer in answers}) == MANY


def test_containers_posted_with_one_slug_get_different_names(http: httpx.Client) -> None:
    link = '<http://www.w3.org/ns/ldp#BasicContainer>; rel="type"'
    answers = parallel(http, lambda c, n: c.post("/data/", headers={**TURTLE, "Slug": "same", "Link": link}))
    assert statuses(answers) == {201: REQUESTS}
    assert len({answer.headers["location"] for answer in answers}) == REQUESTS


def test_of_puts_of_one_new_url_without_a_condition_the_last_one_wins(http: httpx.Client) -> None:
    answers = parallel(
        http, lambda c, n: c.put("/data/one", content=f'<> <{P}> "{n}" .', headers=TURTLE), requests=MANY
    )
    assert statuses(answers) == {201: 1, 204: MANY - 1}
    assert len(values(http, "/data/one")) == 1


def test_of_puts_of_one_new_file_without_a_condition_the_last_one_wins(http: httpx.Client) -> None:
    answers = parallel(http, lambda c, n: c.put("/data/one", content=b"%d" % n, headers=BINARY))
    assert statuses(answers) == {201: 1, 204: REQUESTS - 1}
    assert http.get("/data/one").content.decode() in EVERY


def test_of_puts_of_one_new_container_without_a_condition_the_last_one_wins(http: httpx.Client) -> None:
    answers = parallel(http, lambda c, n: c.put("/data/one/", content=f'<> <{P}> "{n}" .', headers=TURTLE))
    assert statuses(answers) == {201: 1, 204: REQUESTS - 1}
    assert len(values(http, "/data/one/")) == 1


@pytest.mark.parametrize("headers", [TURTLE, BINARY], ids=["an RDF source", "a file"])
def test_of_puts_that_demand_that_nothing_is_there_exactly_one_succeeds(
    http: httpx.Client, headers: dict[str, str]
) -> None:
    asked = {**headers, "If-None-Match": "*"}
    answers = parallel(http, lambda c, n: c.put("/data/new/one", content=b"", headers=asked), requests=MANY)
    assert statuses(answers) == {201: 1, 412: MANY - 1}


def test_a_put_that_demands_that_nothing_is_there_never_follows_one_that_demands_nothing(http: httpx.Client) -> None:
    """Of ten at a time, one in two with the condition: at most one of these succeeds, and then it made the resource."""

    def ask(client: httpx.AsyncClient, number: int) -> Awaitable[httpx.Response]:
        headers = {**TURTLE, "If-None-Match": "*"} if number % 2 else TURTLE
        return client.put(f"/data/{number // 10}", content=f'<> <{P}> "{number}" .', headers=headers)

    answers = parallel(http, ask)
    for first in range(0, REQUESTS, 10):
        group = answers[first : first + 10]
        assert statuses(group)[201] == 1
        assert {answer.status_code for answer in group[1::2]} <= {201, 412}
        assert {answer.status_code for answer in group[::2]} <= {201, 204}


@pytest.mark.parametrize("path", ["/data/patched", "/data/patched/"])
def test_sparql_patches_without_a_condition_are_all_applied(http: httpx.Client, path: str) -> None:
    assert http.put(path, content="", headers=TURTLE).status_code == 201
    answers = parallel(
        http, lambda c, n: c.patch(path, content=f'INSERT DATA {{ <> <{P}> "{n}" }}', headers=UPDATE), requests=MANY
    )
    assert statuses(answers) == {204: MANY}
    assert values(http, path) == {str(number) for number in range(MANY)}


def test_n3_patches_without_a_condition_are_all_applied(http: httpx.Client) -> None:
    assert http.put("/data/patched", content="", headers=TURTLE).status_code == 201

    def ask(client: httpx.AsyncClient, number: int) -> Awaitable[httpx.Response]:
        patch = f'{SOLID} <#patch> a solid:InsertDeletePatch; solid:inserts {{ <> <{P}> "{number}" . }} .'
        return client.patch("/data/patched", content=patch, headers=N3)

    assert statuses(parallel(http, ask)) == {204: REQUESTS}
    assert values(http, "/data/patched") == EVERY


def test_graphs_merged_into_one_resource_are_all_there(http: httpx.Client) -> None:
    assert http.put("/data/merged", content="", headers=TURTLE).status_code == 201
    answers = parallel(http, lambda c, n: c.post("/data/merged", content=f'<> <{P}> "{n}" .', headers=TURTLE))
    assert statuses(answers) == {204: REQUESTS}
    assert values(http, "/data/merged") == EVERY


def test_updates_of_one_graph_are_all_applied(http: httpx.Client) -> None:
    graph = f"{http.base_url}data/updated"
    answers = parallel(
        http,
        lambda c, n: c.post(
            "/sparql", content=f'INSERT DATA {{ GRAPH <{graph}> {{ <{graph}> <{P}> "{n}" }} }}', headers=UPDATE
        ),
    )
    assert statuses(answers) == {204: REQUESTS}
    assert values(http, "/data/updated") == EVERY


def test_updates_and_patches_of_one_graph_are_all_applied(http: httpx.Client) -> None:
    graph = f"{http.base_url}data/updated"
    assert http.put("/data/updated", content="", headers=TURTLE).status_code == 201

    def ask(client: httpx.AsyncClient, number: int) -> Awaitable[httpx.Response]:
        if number % 2:
            return client.patch("/data/updated", content=f'INSERT DATA {{ <> <{P}> "{number}" }}', headers=UPDATE)
        update = f'INSERT DATA {{ GRAPH <{graph}> {{ <{graph}> <{P}> "{number}" }} }}'
        return client.post("/sparql", content=update, headers=UPDATE)

    assert statuses(parallel(http, ask)) == {204: REQUESTS}
    assert values(http, "/data/updated") == EVERY


def test_merge_patches_of_a_file_are_all_applied(http: httpx.Client) -> None:
    assert http.put("/data/file", json={}).status_code == 201
    answers = parallel(http, lambda c, n: c.patch("/data/file", content=json.dumps({str(n): n}), headers=MERGE))
    assert statuses(answers) == {204: REQUESTS}
    assert http.get("/data/file").json() == {str(number): number for number in range(REQUESTS)}


def test_a_file_can_be_read_while_it_is_replaced(http: httpx.Client) -> None:
    assert http.put("/data/file", content=b"0" * 300_000, headers=BINARY).status_code == 201

    def ask(client: httpx.AsyncClient, number: int) -> Awaitable[httpx.Response]:
        if number % 2:
            return client.get("/data/file")
        return client.put("/data/file", content=b"%d" % (number % 10) * 300_000, headers=BINARY)

    answers = parallel(http, ask)
    assert statuses(answers) == {200: REQUESTS // 2, 204: REQUESTS // 2}
    assert all(len(answer.content) == 300_000 and len(set(answer.content)) == 1 for answer in answers[1::2])


def test_of_conditional_patches_on_one_state_exactly_one_succeeds(http: httpx.Client) -> None:
    assert http.put("/data/patched", content="", headers=TURTLE).status_code == 201
    etag = http.get("/data/patched", headers={"Accept": "text/turtle"}).headers["etag"]
    answers = parallel(
        http,
        lambda c, n: c.patch(
            "/data/patched", content=f'INSERT DATA {{ <> <{P}> "{n}" }}', headers={**UPDATE, "If-Match": etag}
        ),
    )
    assert statuses(answers) == {204: 1, 412: REQUESTS - 1}
    assert len(values(http, "/data/patched")) == 1


def test_graphs_posted_to_one_new_name_of_the_graph_store_are_all_there(http: httpx.Client) -> None:
    graph = f"{http.base_url}data/new/graph"
    answers = parallel(
        http, lambda c, n: c.post(f"/graphs?graph={graph}", content=f'<{graph}> <{P}> "{n}" .', headers=TURTLE)
    )
    assert statuses(answers) == {201: 1, 204: REQUESTS - 1}
    assert values(http, "/data/new/graph") == EVERY


def test_of_containers_and_resources_of_one_name_only_one_is_made(http: httpx.Client) -> None:
    def ask(client: httpx.AsyncClient, number: int) -> Awaitable[httpx.Response]:
        return client.put(f"/data/{number // 2}" + "/" * (number % 2), content="", headers=TURTLE)

    answers = parallel(http, ask)
    for pair in zip(answers[::2], answers[1::2], strict=True):
        assert sorted(answer.status_code for answer in pair) == [201, 409]


def test_of_deletions_of_one_resource_one_is_done(http: httpx.Client) -> None:
    assert http.put("/data/one", content="", headers=TURTLE).status_code == 201
    found = statuses(parallel(http, lambda c, n: c.delete("/data/one")))
    assert found[204] == 1
    assert set(found) <= {204, 404, 410}
