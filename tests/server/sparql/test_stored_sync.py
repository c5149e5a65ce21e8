"""What clients keep is in the dataset as soon as it is written, and costs what has changed of it."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import httpx
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import CanonicalizationAlgorithm, Dataset, NamedNode, Quad, QuerySolutions, RdfFormat, Triple, parse

from rosld.ontology.vocab import ldp
from rosld.server.resources.ldp.record_graphs import RecordGraphs
from rosld.server.rest.interaction import membership_declaration, membership_triples
from rosld.server.sparql.change_source import Changes
from rosld.server.sparql.graph_source import GraphEntry
from rosld.server.sparql.materializer import Materializer
from rosld.server.sparql.needs import Demand, Needs
from rosld.server.storage import Difference, Member, Membership, Model, Put, Record, Remove, SqliteRecords, open_records
from rosld.server.storage.record_documents import META, record_document
from tests.server.sparql.local import LocalStore

BASE = "http://robot/"
P = "http://h/p"

EVERYTHING = Needs((Demand(parameters=True),), resources=True, records=True, trees=True)


class NoRobot:
    """A source of no graphs."""

    revision = 0
    writes = 0

    def descriptions(self) -> Mapping[str, GraphEntry]:
        return {}

    async def documents_of(self, terms: Collection[str]) -> Collection[str]:
        return ()

    async def live(self, needs: Needs, *, deadline: float) -> Sequence[GraphEntry]:
        return ()


class Index:
    """Records, and a store that is kept in step with them."""

    def __init__(self, records: SqliteRecords | None = None) -> None:
        self.records = records or open_records(None)
        self.store = LocalStore()
        self.changes = RecordGraphs(self.records, BASE)
        self.materializer = Materializer(self.store, NoRobot(), self.changes)

    async def query(self, text: str) -> QuerySolutions:
        async with self.materializer.materialize(EVERYTHING, deadline=asyncio.get_running_loop().time() + 30):
            found = self.store.query(text)
        assert isinstance(found, QuerySolutions)
        return found

    async def graph(self, path: str) -> set[Quad]:
        """A graph, with its blank nodes named by what is said of them."""
        found = await self.query(f"SELECT * {{ GRAPH <{BASE}{path}> {{ ?s ?p ?o }} }}")
        return canonical(Triple(row["s"], row["p"], row["o"]) for row in found)

    def said(self, record: Record) -> set[Quad]:
        """What a GET says."""
        members: list[Member] = []
        while page := self.records.members(record.path, after=members[-1].number if members else 0):
            members += page
        url, membership = BASE + record.path, list[Triple]()
        if record.membership is not None:
            membership = membership_declaration(record.membership, url)
            membership += membership_triples(record.membership, [one.member or BASE + one.path for one in members])
        return canonical(record_document(record, url, [BASE + one.path for one in members], membership).triples)

    async def differences(self) -> list[str]:
        """The graphs that are not as a GET says, too many or too few."""
        records = [
            record
            for changed in self.records.changes_since(0)
            if not changed.is_removed and (record := self.records.get(changed.path)) is not None
        ]
        graphs = {one.path + (META if one.model is Model.NON_RDF_SOURCE else ""): self.said(one) for one in records}
        await self.query("SELECT * {}")
        there = {name.removeprefix(BASE) for name in self.store.graphs()}
        wrong = [path for path, said in graphs.items() if await self.graph(path) != said]
        return wrong + [path for path in there - graphs.keys() if await self.graph(path)]


def canonical(triples: Iterable[Triple]) -> set[Quad]:
    """As the store has it: integers and times are spelt in one way."""
    store = LocalStore()
    store.replace({BASE: "".join(f"{triple} .\n" for triple in triples)})
    found = store.query("SELECT * { ?s ?p ?o }")
    assert isinstance(found, QuerySolutions)
    dataset = Dataset(Quad(row["s"], row["p"], row["o"]) for row in found)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return set(dataset)


def source(path: str, value: object) -> Put:
    return Put(path, Model.RDF_SOURCE, f'<{BASE}{path}> <{P}> "{value}" .\n'.encode())


def running(scenario: Callable[[Index], Any]) -> Callable[[], None]:
    """A test over an index that is in memory."""

    def test() -> None:
        async def run() -> None:
            index = Index()
            await scenario(index)
            await index.records.close()

        asyncio.run(asyncio.wait_for(run(), 120))

    test.__name__, test.__doc__ = scenario.__name__, scenario.__doc__
    return test


@running
async def test_what_is_removed_and_made_again_between_two_queries_is_as_it_is_now(index: Index) -> None:
    async def chunks() -> Any:
        yield b"x"

    blob = await index.records.receive(chunks(), "text/plain", limit=10)
    await index.records.write(Put("data/a", Model.NON_RDF_SOURCE, blob=blob), source("data/b", 1))
    assert await index.differences() == []
    await index.records.write(Remove("data/a"))
    await index.records.write(Remove("data/b"))
    await index.records.write(source("data/a", 2), Put("data/b/", Model.BASIC_CONTAINER))
    assert await index.differences() == []
    await index.records.write(source("data/b/c", 3), Remove("data/a"))
    await index.records.write(source("data/a", 4))
    assert await index.differences() == []


@running
async def test_a_query_sees_what_was_written_just_before_it(index: Index) -> None:
    for turn in range(3):
        await index.records.write(source("data/a", turn))
        assert [row["o"].value for row in await index.query(f"SELECT ?o {{ ?s <{P}> ?o }}")] == [str(turn)]
    await index.records.write(Remove("data/a"))
    assert list(await index.query(f"SELECT ?o {{ ?s <{P}> ?o }}")) == []
    assert BASE + "data/a" not in index.store.graphs()


@running
async def test_a_query_after_no_write_changes_nothing(index: Index) -> None:
    await index.records.write(source("data/a", 1))
    await index.query("SELECT * {}")
    version = index.store.version
    await index.query("SELECT * {}")
    assert index.store.version == version


@running
async def test_blank_nodes_of_one_label_stay_apart_and_together_within_one_graph(index: Index) -> None:
    text = f"<http://h/s> <{P}> _:b .\n_:b <{P}> <http://h/o> .\n".encode()
    await index.records.write(*(Put(f"data/{name}", Model.RDF_SOURCE, text) for name in "abc"))
    assert len(list(await index.query(f"SELECT DISTINCT ?b {{ ?b <{P}> <http://h/o> }}"))) == 3
    assert await index.differences() == []


@running
async def test_a_file_is_in_the_dataset_by_its_description_and_goes_with_it(index: Index) -> None:
    async def chunks() -> Any:
        yield b"bytes"

    blob = await index.records.receive(chunks(), "image/png", limit=10)
    await index.records.write(Put("data/f", Model.NON_RDF_SOURCE, blob=blob))
    assert await index.differences() == []
    assert BASE + "data/f.meta" in index.store.graphs()
    await index.records.write(Remove("data/f"))
    assert await index.differences() == []
    assert BASE + "data/f.meta" not in index.store.graphs()


@running
async def test_one_record_that_cannot_be_stored_hides_no_other(index: Index) -> None:
    await index.records.write(source("data/a", 1), Put("data/b", Model.RDF_SOURCE, b"} ; DROP ALL"))
    assert [row["o"].value for row in await index.query(f"SELECT ?o {{ ?s <{P}> ?o }}")] == ["1"]
    assert {row["o"].value for row in await index.query(f"SELECT ?o {{ ?s {ldp.contains} ?o }}")} == {
        BASE + "data/a",
        BASE + "data/b",
    }


@running
async def test_no_query_sees_a_part_of_a_write_however_much_was_written(index: Index) -> None:
    names = [f"data/r{number}" for number in range(1500)]
    await index.records.write(*(source(name, 0) for name in names))
    ended = asyncio.Event()

    async def writing() -> None:
        for turn in range(1, 6):
            await index.records.write(*(source(name, turn) for name in names))
            await asyncio.sleep(0)
        ended.set()

    writer = asyncio.ensure_future(writing())
    while True:
        last = ended.is_set()
        text = f"SELECT ?o (COUNT(*) AS ?n) {{ ?s <{P}> ?o }} GROUP BY ?o"
        answers = await asyncio.gather(*(index.query(text) for _ in range(3)))
        for answer in answers:
            assert [row["n"].value for row in answer] == ["1500"]
        if last:
            break
    await writer
    assert [row["o"].value for row in await index.query(f"SELECT DISTINCT ?o {{ ?s <{P}> ?o }}")] == ["5"]


class ToldIndex(Index):
    """An index whose store is told by the test alone."""

    async def query(self, text: str) -> QuerySolutions:
        found = self.store.query(text)
        assert isinstance(found, QuerySolutions)
        return found

    def tell(self, part: Changes) -> None:
        self.store.replace({iri: make and make() for iri, make in part.graphs.items()}, part.edits)


@running
async def test_what_is_written_while_a_backlog_is_told_is_not_lost(index: Index) -> None:
    index = ToldIndex(index.records)
    membership = Membership(BASE + "data/c/", P)
    await index.records.write(
        Put("data/c/", Model.DIRECT_CONTAINER, membership=membership),
        *(source(f"data/c/r{number}", 0) for number in range(2500)),
    )
    version = index.records.version
    for turn, part in enumerate(index.changes.changes(0)):
        index.tell(part)
        if turn < 30:  # now and then a page, the container itself, a page of its members lies between
            writes = [source(f"data/c/n{turn}", 0), Remove(f"data/c/r{turn}"), source(f"data/c/r{2400 + turn}", turn)]
            if turn % 7 == 3:
                writes.append(Put("data/c/", Model.DIRECT_CONTAINER, b"", membership=Membership(f"{P}{turn}", P)))
            await index.records.write(*writes)
    for part in index.changes.changes(version):  # what was not told would be lost now
        index.tell(part)
    assert await index.differences() == []


@running
async def test_a_search_that_came_to_nothing_is_made_up_for(index: Index) -> None:
    await index.records.write(source("data/a", 0))
    await index.query("SELECT * {}")
    version = index.changes.version
    for number in range(3):
        await index.records.write(source(f"data/b{number}", 0))
        list(index.changes.changes(version))
    await index.records.write(Remove("data/b1"))
    assert await index.differences() == []


class Watched:
    """A source that notes at which turn of the loop each part of its changes was found, and where it was rendered."""

    def __init__(self, source: RecordGraphs) -> None:
        self._source = source
        self.turn = 0
        self.found: list[int] = []
        self.threads: set[threading.Thread] = set()

    @property
    def version(self) -> int:
        return self._source.version

    def last_change(self, graph: str) -> int:
        return self._source.last_change(graph)

    def changes(self, after: int) -> Iterator[Changes]:
        for part in self._source.changes(after):
            self.found.append(self.turn)
            yield part._replace(
                graphs={iri: render and partial(self._render, render) for iri, render in part.graphs.items()}
            )

    def _render(self, render: Callable[[], str]) -> str:
        self.threads.add(threading.current_thread())
        return render()


@running
async def test_a_large_backlog_is_told_in_parts_and_holds_nobody_up(index: Index) -> None:
    await index.records.write(*(source(f"data/r{number}", "x" * 100) for number in range(10_000)))
    watched = Watched(RecordGraphs(index.records, BASE))
    loaded = asyncio.ensure_future(Materializer(index.store, NoRobot(), watched).stored.sync())
    while not loaded.done():
        watched.turn += 1
        await asyncio.sleep(0)
    await loaded
    assert len(watched.found) > 20
    assert len(set(watched.found)) == len(watched.found), "the loop had no turn between two parts"
    assert watched.threads
    assert threading.current_thread() not in watched.threads
    assert len(index.store.graphs()) == 10_001


@running
async def test_much_that_was_written_is_in_the_store_before_anybody_asks(index: Index) -> None:
    keeping = asyncio.ensure_future(index.materializer.stored.run())
    for start in (0, 2000):
        await index.records.write(*(source(f"data/r{number}", 0) for number in range(start, start + 2000)))
        while len(index.store.graphs()) <= start + 2000:  # noqa: ASYNC110 - nobody is told
            await asyncio.sleep(0.01)
    keeping.cancel()
    await asyncio.wait([keeping])
    assert keeping.cancelled()


@running
async def test_one_write_among_many_costs_a_query_only_what_has_changed(index: Index) -> None:
    async def seconds(path: str) -> float:
        best = float("inf")
        for turn in range(20):
            writes = [source(path, turn), source(f"data/big/n{path[-1]}{turn}", turn)]
            await index.records.write(*writes)
            begun = time.perf_counter()
            assert len(list(await index.query(f"SELECT ?o {{ <{BASE}{path}> <{P}> ?o }}"))) == 1
            best = min(best, time.perf_counter() - begun)
        return best

    await index.records.write(Put("data/big/", Model.BASIC_CONTAINER))
    alone = await seconds("data/a")
    for start in range(0, 20_000, 1000):
        await index.records.write(*(source(f"data/big/r{number}", 0) for number in range(start, start + 1000)))
    await index.materializer.stored.sync()
    await index.query("SELECT * {}")
    assert await seconds("data/b") < 4 * alone + 0.002


# Whatever is written, the graphs say what a GET says

_NAMES = st.sampled_from(["data/a", "data/b", "data/c/", "data/d/", "data/i/", "data/c/a", "data/c/b", "data/d/a"])
_MORE = st.sampled_from(["data/i/a", "data/i/b", "data/i/c", "data/d/c/", "data/d/c/a", "data/c/a"])
_MEMBERSHIPS = {
    "data/d/": [Membership(BASE + "data/d/", P), Membership(BASE + "data/a#it", P, inverse=True)],
    "data/i/": [Membership(BASE + "data/i/", P, False, "http://h/is"), Membership("http://h/all", P, False, "http://h/is")],
}  # fmt: skip


@st.composite
def writes(draw: st.DrawFn) -> Put | Remove:
    path = draw(st.one_of(_NAMES, _MORE))
    if draw(st.integers(0, 3)) == 0:
        return Remove(path)
    said = f'<{BASE}{path}> <http://h/said> "{draw(st.integers(0, 3))}" .\n'.encode()
    if draw(st.booleans()):
        said += f"<{BASE}{path}> <http://h/said> _:b .\n_:b <{P}> _:c .\n".encode()
    if not path.endswith("/"):
        member = draw(st.sampled_from([None, "http://h/one", "http://h/two"])) if path.startswith("data/i/") else None
        return Put(path, Model.RDF_SOURCE, said, member=member)
    if path not in _MEMBERSHIPS:
        return Put(path, Model.BASIC_CONTAINER, said)
    membership = draw(st.sampled_from(_MEMBERSHIPS[path]))
    model = Model.INDIRECT_CONTAINER if membership.content else Model.DIRECT_CONTAINER
    return Put(path, model, said, membership=membership)


@given(st.lists(st.lists(writes(), max_size=8), max_size=6))
def test_graphs_say_what_a_get_says_whatever_is_written(batches: list[list[Put | Remove]]) -> None:
    async def scenario() -> None:
        index = Index()
        for batch in batches:
            for write in batch:
                try:
                    await index.records.write(write)
                except Exception as error:
                    assert type(error).__name__ == "Conflict"  # noqa: PT017 - not what this is about
            assert await index.differences() == []
        await index.records.close()

    asyncio.run(scenario())


_LINES = st.frozensets(st.integers(0, 5), max_size=4)
_STEPS = st.lists(
    st.tuples(
        st.sampled_from(["patch", "patch", "patch", "patch", "put", "remove", "ask", "replay"]),
        st.sampled_from(["data/a", "data/b"]),
        _LINES,
    ),
    max_size=30,
)


def said_of(path: str, numbers: Iterable[int]) -> bytes:
    return "".join(f'<{BASE}{path}> <{P}> "{number}" .\n' for number in sorted(numbers)).encode()


@given(_STEPS, _LINES)
def test_a_graph_that_is_told_what_changed_says_what_a_get_says(
    steps: Sequence[tuple[str, str, frozenset[int]]], times: frozenset[int]
) -> None:
    """Whichever writes tell what they changed, whenever somebody asks, and if what was told is told once more."""

    async def write(
        index: Index, what: str, path: str, numbers: frozenset[int], now: dict[str, frozenset[int]]
    ) -> None:
        before = index.records.get(path)
        if what == "remove":
            if before is not None:
                await index.records.write(Remove(path))
            return
        change = None
        if what == "patch" and before is not None:
            removed, added = now[path] - numbers, numbers - now[path]
            change = Difference(before, b"", said_of(path, removed), said_of(path, added))
        expected = None if change is None else change.before.version
        put = Put(path, Model.RDF_SOURCE, said_of(path, numbers), expected=expected, difference=change)
        await index.records.write(put)
        now[path] = numbers

    async def scenario() -> None:
        index, now, versions = Index(), dict[str, frozenset[int]](), [0]
        late = Index(index.records)
        for what, path, numbers in steps:
            if what == "ask":
                assert await late.differences() == []
            elif what == "replay":
                for part in RecordGraphs(index.records, BASE).changes(versions[len(times) % len(versions)]):
                    late.store.change({iri: text and text() for iri, text in part.graphs.items()}, part.edits)
                assert await late.differences() == []
            else:
                await write(index, what, path, numbers, now)
                versions.append(index.records.version)
                assert await index.differences() == []
        assert await late.differences() == []
        await index.records.close()

    asyncio.run(scenario())


@running
async def test_few_triples_of_many_are_told_alone(index: Index) -> None:
    await index.records.write(Put("data/a", Model.RDF_SOURCE, said_of("data/a", range(2000))))
    assert await index.differences() == []
    before = index.records.get("data/a")
    assert before is not None
    change = Difference(before, b"", said_of("data/a", [7]), said_of("data/a", [2000]))
    triples = said_of("data/a", {*range(2001)} - {7})
    await index.records.write(Put("data/a", Model.RDF_SOURCE, triples, expected=before.version, difference=change))
    (part,) = RecordGraphs(index.records, BASE).changes(before.version)
    assert not part.graphs
    assert part.size < 1000
    assert await index.differences() == []


# Over HTTP


def test_a_patch_of_a_large_document_is_in_the_dataset_as_its_get_says_it(http: httpx.Client) -> None:
    many = "".join(f'<http://h/{number}> <{P}> "{number:0100}" .\n' for number in range(4000))
    patches = (
        f'DELETE DATA {{ <http://h/1> <{P}> "{1:0100}" }} ; INSERT DATA {{ <http://h/1> <{P}> 01, "x"@en }}',
        f"DELETE WHERE {{ <http://h/1> <{P}> ?o }}",
        f"INSERT DATA {{ <> <{P}> [ <{P}> 2 ] }}",
        f"INSERT DATA {{ <http://h/3> <{P}> 3 }}",
    )
    body = {"Content-Type": "application/n-triples"}
    assert http.put("data/large", content=many, headers=body).status_code == 201
    url = http.base_url.join("data/large")
    for patch in ("INSERT DATA {}", *patches):
        update = {"Content-Type": "application/sparql-update"}
        assert http.patch("data/large", content=patch, headers=update).status_code == 204
        query = {"query": f"CONSTRUCT {{ ?s ?p ?o }} WHERE {{ GRAPH <{url}> {{ ?s ?p ?o }} }}"}
        accept = {"Accept": "application/n-triples"}
        found = http.get("sparql", params=query, headers=accept).content
        said = http.get("data/large", headers=accept).content
        one, other = (Dataset(parse(each, RdfFormat.N_TRIPLES)) for each in (found, said))
        for each in (one, other):
            each.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
        assert set(one) == set(other)
    assert http.delete("data/large").status_code == 204


def test_what_is_put_is_found_at_once_in_the_graph_of_its_url(http: httpx.Client) -> None:
    body = "<> <http://h/p> [ <http://h/q> 07 ] ."
    turtle = {"Content-Type": "text/turtle"}
    assert http.put("data/kept", content=body, headers=turtle).status_code == 201
    for path in ("data/kept", "data/"):
        url = str(http.base_url.join(path))
        found = http.get(
            "sparql",
            params={"query": f"CONSTRUCT {{ ?s ?p ?o }} WHERE {{ GRAPH <{url}> {{ ?s ?p ?o }} }}"},
            headers={"Accept": "application/n-triples"},
        )
        said = http.get(path, headers={"Accept": "application/n-triples"})
        one, other = (
            canonical(quad.triple for quad in parse(each.content, RdfFormat.N_TRIPLES)) for each in (found, said)
        )
        assert one == other
        assert one
    assert http.delete("data/kept").status_code == 204
    ask = {"query": f"ASK {{ ?s {ldp.contains} {NamedNode(str(http.base_url.join('data/kept')))} }}"}
    assert http.get("sparql", params=ask, headers={"Accept": "text/csv"}).text.split()[-1] == "false"
