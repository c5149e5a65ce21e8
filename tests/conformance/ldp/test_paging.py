"""A container of 20,000 members: served in pages, and as fast to write to as an empty one (LDP Paging 1.0)."""

from __future__ import annotations

import re
import statistics
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import httpx
import pytest

from rosld.ontology.vocab import ldp
from rosld.server.storage.record import Model, Record
from rosld.server.storage.record_table import NumberedRecord, RecordTable
from rosld.server.storage.sqlite import connect
from tests.conformance.ldp.conftest import models, running

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

TURTLE = "text/turtle"
MEMBERS = 20_000
PAGE = 1000


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    """A served container of 20,000 members, restored as by `rosld load`, and an empty `/data/empty/`."""
    folder = tmp_path_factory.mktemp("large")
    connection = connect(folder)
    records = [Record(path, Model.BASIC_CONTAINER, 1, 0, 0) for path in ("data/", "data/many/", "data/empty/")]
    records += [Record(f"data/many/m{number}", Model.RDF_SOURCE, 1, 0, 0) for number in range(MEMBERS)]
    table = RecordTable(connection)
    table.begin()
    table.restore((NumberedRecord(*each) for each in enumerate(records, 1)), (), time.time_ns())
    table.commit()
    connection.close()
    with running("aircraft", "--data", str(folder)) as served:
        yield served.at("data/many/")


def contained(page: httpx.Response) -> list[str]:
    """Return the URLs of the members on a page of N-Triples, in order."""
    assert page.status_code == 200, page.text
    return re.findall(r"<http://www.w3.org/ns/ldp#contains> <([^>]*)>", page.text)


def read(place: Place, url: str) -> httpx.Response:
    return place.get(url, Accept="application/n-triples")


def test_paging_many_members_are_walked_page_by_page(large: Place) -> None:
    answer = large.get()
    assert answer.status_code == 303
    first = read(large, answer.headers["location"])
    walked = [first]
    for _ in range(3):
        walked.append(read(large, walked[-1].links["next"]["url"]))
    told = [url for page in walked for url in contained(page)]
    assert told == [large.at(f"m{number}") for number in range(4 * PAGE)]
    back = [walked[-1]]
    while "prev" in back[-1].links:
        back.append(read(large, back[-1].links["prev"]["url"]))
    assert [str(page.url) for page in back] == [str(page.url) for page in reversed(walked)]
    assert [page.text for page in back] == [page.text for page in reversed(walked)]
    for page in walked:
        assert {"Page", "Resource", "BasicContainer"} <= models(page)
        assert page.links["first"]["url"] == answer.headers["location"]
        assert page.links["canonical"]["url"] == large.url
    assert len({page.headers["etag"] for page in walked}) == len(walked)
    minimal = large.get(Prefer=f'return=representation; include="{ldp.iri}PreferMinimalContainer"')
    assert (minimal.status_code, minimal.headers["preference-applied"]) == (200, "return=representation")


def test_paging_a_new_member_is_on_the_last_page_until_it_is_deleted(large: Place) -> None:
    first = large.http.get(large.url, follow_redirects=True)
    last = read(large, first.links["last"]["url"])
    assert contained(last)[-1] == large.at(f"m{MEMBERS - 1}")
    assert read(large, last.links["prev"]["url"]).links["next"]["url"] == str(last.url)
    made = large.post()
    last = read(large, str(last.url))
    if "next" in last.links:  # the page was full
        last = read(large, last.links["next"]["url"])
    assert contained(last)[-1] == made
    assert large.send("DELETE", made).status_code == 204
    last = read(large, large.http.get(large.url, follow_redirects=True).links["last"]["url"])
    assert made not in contained(last)


def test_paging_writes_to_many_are_not_slower_than_to_none(large: Place) -> None:
    empty = large.at("../empty/")

    def seconds(to: str, **headers: str) -> float:
        begun = time.perf_counter()
        made = large.post(to=to, Prefer="return=minimal", **headers)
        assert large.send("DELETE", made).status_code == 204
        return time.perf_counter() - begun

    pairs = [(seconds(large.url), seconds(large.url, If_Match="*"), seconds(empty)) for _ in range(20)]
    many, guarded, none = (statistics.median(each) for each in zip(*pairs, strict=True))
    assert many < 3 * none
    assert guarded < 3 * none


def test_paging_a_large_container_is_patched_without_its_members(large: Place) -> None:
    patch = 'INSERT DATA { <> <http://purl.org/dc/terms/title> "Many" }'
    assert large.send("PATCH", "", patch, "application/sparql-update").status_code == 204
    page = read(large, "?page=0")
    assert '"Many"' in page.text
    assert len(contained(page)) == PAGE
    wrong = f"INSERT DATA {{ <> <{ldp.iri}contains> <m-1> }}"
    assert large.send("PATCH", "", wrong, "application/sparql-update").status_code == 409


# Containers of any size in pages, on a client's preference


@pytest.fixture
def few(place: Place) -> Place:
    """A container of seven."""
    for number in range(7):
        place.put(f"m{number}", "")
    return place


def small(limit: int) -> dict[str, str]:
    return {"Prefer": f'return=representation; max-member-count="{limit}"'}


def test_paging_a_page_tells_the_state_of_the_whole(few: Place) -> None:
    """LDP Paging 1.0, 5.2: the canonical link shows clients that follow pages that the container has changed."""

    def state() -> str:
        links = few.http.get(few.url, headers=small(3), follow_redirects=True).headers["link"]
        return re.findall(r'rel="canonical"; etag="([^"]+)"', links)[0]

    before = state()
    assert state() == before
    assert few.get().headers["etag"].strip('"').partition(".")[0] == before.partition(".")[0]
    few.post()
    assert state() != before


def test_paging_what_a_query_asks_for_is_asked_of_the_page(few: Place) -> None:
    answer = few.http.get(f"{few.url}?format=nt", headers={**small(3), "Accept": "text/html"}, follow_redirects=True)
    assert answer.headers["content-type"].startswith("application/n-triples")
    assert len(contained(answer)) == 3


# The robot's containers, ordered by name


PARAMETERS = {f"p{number:04}": number for number in range(2500)} | {"a:b": {"deep": True}}


@pytest.fixture(scope="module")
def robot(served: Served) -> Iterator[Place]:
    """A tree of 2,501 parameters, one of them a tree."""
    place = served.at("parameters/paged/")
    made = place.http.patch(f"{served.url}parameters/", json={"paged": PARAMETERS}, headers=MERGE)
    assert made.status_code == 204, made.text
    yield place
    assert place.send("DELETE").status_code == 204


MERGE = {"Content-Type": "application/merge-patch+json"}


def test_paging_thousands_of_parameters_come_in_pages(robot: Place) -> None:
    answer = robot.get(Accept=TURTLE)
    assert answer.status_code == 303
    walked = [read(robot, answer.headers["location"])]
    while "next" in walked[-1].links:
        walked.append(read(robot, walked[-1].links["next"]["url"]))
    told = [url for page in walked for url in contained(page) if not url.endswith("deep")]
    assert told == [robot.at("a%3Ab/"), *(robot.at(name) for name in sorted(PARAMETERS)[1:])]
    assert walked[0].links["last"]["url"] == str(walked[-1].url)
    assert len({page.headers["etag"] for page in walked}) == len(walked)


def test_paging_a_tree_is_one_json_value_and_only_named_in_the_tree_above(robot: Place) -> None:
    answer = robot.get(Accept="application/json")
    assert answer.status_code == 200
    assert answer.json() == PARAMETERS
    assert list(robot.get("?page=:p0000", Accept="application/json").json()) == sorted(PARAMETERS)[2:1002]
    above = robot.get("../", Accept="application/n-triples")
    assert robot.url in contained(above)
    assert "paged/p0000" not in above.text


def test_paging_each_container_of_names_comes_in_pages_where_a_client_prefers_it(served: Served) -> None:
    for path in ("topics/", "services/", "nodes/", "parameters/"):
        place = served.at(path)
        whole = contained(read(place, place.url))
        page = place.http.get(place.url, headers={**small(1), "Accept": "application/n-triples"}, follow_redirects=True)
        told = contained(page)[:1]
        while "next" in page.links:
            page = read(place, page.links["next"]["url"])
            told += contained(page)[:1]
        direct = [url for url in whole if "/" not in url.removeprefix(place.url).rstrip("/")]
        assert sorted(told) == sorted(direct)
        assert place.get("?page=4711").status_code == 404
