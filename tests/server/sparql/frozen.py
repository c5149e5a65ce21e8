"""A robot that stands still, with all that its dataset can hold: what a query needs is compared with everything."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from pyoxigraph import NamedNode, Quad, QueryBoolean, QuerySolutions, RdfFormat, Store, parse

from rosld.ontology.vocab import PREFIXES
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.mappings import relations
from rosld.server.resources.namespaces import namespaces
from rosld.server.routing.live_graphs import RobotGraphs
from rosld.server.routing.resource_factory import ResourceFactory
from rosld.server.routing.services import Services
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.change_source import Changes
from rosld.server.sparql.materializer import Materializer
from rosld.server.sparql.mentions import MentionRecorder, Mentions
from rosld.server.sparql.needs import Demand, Needs
from tests.server.sparql.local import LocalStore

MAX_ROWS = 2000
"""Of queries with more rows nothing is compared: their joins are cross products."""
_STATIC = ("nodes", "topics", "services", "parameters", "actions", "bags", "calls", "goals", "stop", "")
_MESSAGES = 40
"""Recorded messages that are looked at."""


class TooMany(Exception):
    """A query has more rows than are compared."""


@dataclass(frozen=True)
class Frozen:
    """The graphs of a robot at one moment, as N-Triples: what is always there, and the live ones as they are in full.

    `loop` is the one the robot runs on.
    """

    services: Services
    dataset: RobotGraphs
    loop: asyncio.AbstractEventLoop
    described: Mapping[str, str]
    live: Mapping[str, str]

    @property
    def base(self) -> str:
        return self.services.session.space.base

    def kind(self, iri: str) -> str:
        """The container that a graph lies in."""
        kind = iri.removeprefix(self.base).partition("/")[0]
        return "trees" if kind == "parameters" and iri.endswith("/") else kind


async def freeze(services: Services) -> Frozen:
    """All that a robot's dataset holds, every topic being subscribed to."""
    robot = services.session
    dataset, space = RobotGraphs(ResourceFactory(services)), robot.space
    tree = await services.affordances.tree()
    below = {url_of(path, space) for path in (*tree.paths, *tree.properties, *tree.actions)}
    recorded = {
        space.bag_message(name, index)
        for name, recording in robot.adapter.recordings.items()
        for index in range(min(_MESSAGES, recording.count))
    }
    loop = asyncio.get_running_loop()
    trees = frozenset(space.container("parameters", path) for path in namespaces(robot.graph, "parameters"))
    everything = Needs((Demand(parameters=True),), frozenset(below | recorded), graph_names=trees)
    for topic in robot.graph.topics:
        await robot.topics.read(topic)
    entries = await dataset.live(everything, deadline=loop.time() + 20)
    described = {
        iri: entry.ntriples()
        for iri, entry in dataset.descriptions().items()
        if iri.removeprefix(space.base).partition("/")[0] in _STATIC
    }
    return Frozen(services, dataset, loop, described, {entry.iri: entry.ntriples() for entry in entries})


class _Kept:
    """Graphs that clients keep: a `ChangeSource`."""

    version = 1

    def __init__(self, texts: Mapping[str, str]) -> None:
        self._texts = texts

    def changes(self, after: int) -> Iterator[Changes]:
        graphs: dict[str, Callable[[], str] | None] = {
            iri: (lambda text=text: text)
            for iri, text in self._texts.items()  # type: ignore[misc]
        }
        yield Changes(graphs, (), 0)


@dataclass
class Comparison:
    """A robot's queries over what they need and over everything, beside the graphs that clients keep."""

    frozen: Frozen
    kept: Mapping[str, str]
    stores: dict[frozenset[str], Store] = field(default_factory=dict)
    found: dict[Needs, frozenset[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        services = self.frozen.services
        space = services.session.space
        mentions = Mentions(space.base, space.types)
        self.analyser = Analyser(space.base, space.types, relations=lambda: relations(services.mappings.mapping_set))
        self._materializer = Materializer(
            LocalStore(),
            self.frozen.dataset,
            MentionRecorder(_Kept(self.kept), mentions),
            mentioned=mentions.documents_of,
        )

    def needs(self, text: str) -> Needs:
        """What a query needs, resolved."""
        analysis = self.analyser.analyse_once(text)
        assert analysis.form is not None, "the query is not understood"
        named = analysis.default_graphs + analysis.named_graphs
        needs = analysis.needs.restrict_to(named) if named else analysis.needs
        return self.frozen.loop.run_until_complete(self._materializer.resolve_documents(needs))

    def wanted(self, needs: Needs) -> frozenset[str]:
        """The live graphs that the dataset brings for it."""
        if needs not in self.found:
            loop = self.frozen.loop
            entries = loop.run_until_complete(self.frozen.dataset.live(needs, deadline=loop.time() + 20))
            self.found[needs] = frozenset(entry.iri for entry in entries if entry.iri in self.frozen.live)
        return self.found[needs]

    def unread(self, needs: Needs) -> frozenset[str]:
        """The containers that it says it did not look into, where it could."""
        unread = {"resources": needs.resources, "bags": needs.records, "trees": needs.trees}
        return frozenset(name for name, is_so in unread.items() if is_so)

    def store(self, live: frozenset[str]) -> Store:
        """The dataset with these live graphs; its default graph is the set of their triples (RDF 1.1 Semantics 4.1)."""
        if live not in self.stores:
            texts = {**self.frozen.described, **{iri: self.frozen.live[iri] for iri in live}, **self.kept}
            quads = quads_of(texts)
            self.stores[live] = Store()
            self.stores[live].extend(quads)
            self.stores[live].extend(Quad(*quad.triple) for quad in quads)
        return self.stores[live]

    def differences(self, text: str) -> tuple[list[str], list[str]]:
        """The answers over what a query needs, and over everything but what it says it did not look at.

        Raises SyntaxError, ValueError and TooMany.
        """
        needs = self.needs(text)
        wanted, unread = self.wanted(needs), self.unread(needs)
        everything = frozenset(iri for iri in self.frozen.live if iri in wanted or self.frozen.kind(iri) not in unread)
        if wanted == everything:
            return [], []
        return self.answer(self.store(wanted), text), self.answer(self.store(everything), text)

    def answer(self, store: Store, text: str) -> list[str]:
        """All results, in an order of their own; labels of blank nodes left out."""
        analysis = self.analyser.analyse_once(text)
        named = [NamedNode(iri) for iri in analysis.named_graphs]
        default = [NamedNode(iri) for iri in analysis.default_graphs]
        dataset = {"default_graph": default, "named_graphs": named} if default or named else {}
        found = store.query(text, base_iri=self.frozen.base, prefixes=dict(PREFIXES), **dataset)
        if isinstance(found, QueryBoolean):
            return [str(bool(found))]
        rows: list[str] = []
        names = sorted(each.value for each in found.variables) if isinstance(found, QuerySolutions) else []
        for row in found:
            terms = [row[name] for name in names] if isinstance(found, QuerySolutions) else list(row)
            rows.append(" ".join("_:b" if str(term).startswith("_:") else str(term) for term in terms))
            if len(rows) > MAX_ROWS:
                raise TooMany
        return sorted(rows if isinstance(found, QuerySolutions) else set(rows))


def quads_of(texts: Mapping[str, str]) -> list[Quad]:
    """All triples, with the graphs they stand in (as their graph name)."""
    found = []
    for iri, text in texts.items():
        found += [
            Quad(*each.triple, NamedNode(iri)) for each in parse(text, RdfFormat.N_TRIPLES, rename_blank_nodes=True)
        ]
    return found


def notes(frozen: Frozen) -> Mapping[str, str]:
    """What clients keep of a robot in good faith: notes about its resources, lists of them, messages of their own."""
    data, topics, others = f"{frozen.base}data/", *_resources(frozen)
    about = [f'<{data}notes> <{EX}about> <{one}> .\n<{one}> <{EX}place> "hangar" .\n' for one in (*topics, *others)]
    listed = f"<{data}list> <{EX}members> _:a .\n_:a <{RDF}first> <{topics[0]}> .\n_:a <{RDF}rest> _:b .\n"
    listed += f"_:b <{RDF}first> <{topics[-1]}#message> .\n_:b <{RDF}rest> <{RDF}nil> .\n"
    copies = "".join(
        line.replace(f"<{topic}", f"<{data}copy") + "\n"
        for topic in topics
        for line in frozen.live[topic].splitlines()
        if f"<{topic}#message" in line
    )
    return {f"{data}notes": "".join(about), f"{data}list": listed, f"{data}copy": copies}


def claims(frozen: Frozen) -> Mapping[str, str]:
    """What contradicts a robot: each resource is given the classes, types, messages and fields of another."""
    data, topics, others = f"{frozen.base}data/", *_resources(frozen)
    found: dict[str, str] = {}
    nodes = [*topics, *others, f"{data}thing", *(f"{topic}#message" for topic in topics)]
    said = [line for topic in topics for line in frozen.live[topic].splitlines() if line.startswith(f"<{topic}")]
    said += [line for other in others for line in frozen.live[other].splitlines() if line.startswith(f"<{other}")]
    for number, line in enumerate(said):
        rest = line.partition("> ")[2]
        for step, node in enumerate(nodes):
            if (number + 3 * step) % 11 == 0:
                graph = f"{data}claims/{step % 4}"
                found[graph] = found.get(graph, "") + f"<{node}> {rest}\n"
    return found


def empty_list(frozen: Frozen) -> Mapping[str, str]:
    """What clients say of the list that all empty lists are."""
    topic = _resources(frozen)[0][0]
    fields = [line for line in frozen.live[topic].splitlines() if line.startswith(f"<{topic}#message")]
    return {f"{frozen.base}data/empty": "".join(f"<{RDF}nil> {line.partition('> ')[2]}\n" for line in fields)}


EX, RDF = "http://example.org/", "http://www.w3.org/1999/02/22-rdf-syntax-ns#"


def _resources(frozen: Frozen) -> tuple[list[str], list[str]]:
    """The topics, and one each of the other kinds."""
    kinds: dict[str, list[str]] = {}
    for iri in sorted(frozen.live):
        kinds.setdefault(frozen.kind(iri), []).append(iri)
    return kinds["topics"], [iris[len(iris) // 2] for kind, iris in kinds.items() if kind != "topics"]
