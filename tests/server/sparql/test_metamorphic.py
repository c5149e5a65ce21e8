"""Random queries compared to each other, on embedded robots: laws of SPARQL that must hold for derived queries.

The results of a live robot grow with time, so a query that must have all results of a set runs before or after it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from random import Random

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.made_up import served

pytestmark = pytest.mark.slow

Rows = set[tuple[str, ...]]
_ATTEMPTS = 3
"""Number of times that queries may contradict each other: the next message may have more or fewer nodes."""
_BULKY = ("Image", "PointCloud", "OccupancyGrid", "Mesh")
"""Types of values that are only in queries that name them: on the rover those of its camera and map."""


@dataclass
class Asked:
    """A robot for random queries. All queries are about ?x, whose IRIs do not change with the values."""

    http: httpx.Client
    random: Random

    def __post_init__(self) -> None:
        def said(query: str) -> list[str]:
            found = [row[0].strip("<>") for row in self.rows(query)]
            return sorted(one for one in found if not any(word in one for word in _BULKY))

        self.predicates = said("SELECT DISTINCT ?p { ?s ?p ?o }")
        self.classes = said("SELECT DISTINCT ?c { ?s a ?c FILTER(ISIRI(?c)) }")
        self.subjects = said("SELECT DISTINCT ?s { ?s a ?c FILTER(ISIRI(?s) && !CONTAINS(STR(?s), '/shapes')) }")

    def rows(self, query: str) -> Rows:
        """Return the rows that begin with an IRI: values change meanwhile, and a new list has new nodes."""
        return {tuple(line.split("\t")) for line in self.lines(query) if line.startswith("<")}

    def lines(self, query: str) -> list[str]:
        """Return the rows of a SELECT. Raises TimeoutError if it takes too long."""
        answer = self.http.post("/sparql", data={"query": query}, headers={"Accept": "text/tab-separated-values"})
        if answer.status_code == 503 and answer.json().get("reason") == "time":
            raise TimeoutError
        assert answer.status_code == 200, (query, answer.text)
        return answer.text.split("\n")[1:-1]

    def pattern(self, depth: int = 0) -> str:
        """Return a random pattern about ?x."""
        one, other = f"?o{depth}", f"?n{depth}"
        predicate = f"<{self.random.choice(self.predicates)}>"
        field = f"<{self.random.choice([each for each in self.predicates if '/types/' in each] or self.predicates)}>"
        return self.random.choice(
            [
                f"?x {predicate} {one} .",
                f"?x {predicate} {one} .",
                f"?x a <{self.random.choice(self.classes)}> .",
                f"?x ?p{depth} <{self.random.choice(self.subjects)}> .",
                f"?x {predicate} {one} . {one} <{self.random.choice(self.predicates)}> {other} .",
                f"?x ros:latest {one} . {one} {field} {other} .",
                f"?x ros:latest/{field} {one} .",
                f"{one} {predicate} ?x .",
                f"GRAPH ?g{depth} {{ ?x {predicate} {one} }}",
                f"?x {predicate}|a {one} .",
            ]
        )


def adding(asked: Asked) -> None:
    """Check that adding a pattern adds no solutions."""
    one, other = asked.pattern(), asked.pattern(1)
    more = asked.rows(f"SELECT DISTINCT ?x {{ {one} {other} }}")
    assert more <= asked.rows(f"SELECT DISTINCT ?x {{ {one} }}"), (one, other)


def parting(asked: Asked) -> None:
    """Check that EXISTS and NOT EXISTS partition the rows."""
    one, other = asked.pattern(), asked.pattern(1)
    least = asked.rows(f"SELECT DISTINCT ?x {{ {one} }}")
    found = [
        asked.rows(f"SELECT DISTINCT ?x {{ {one} FILTER {word} {{ {other} }} }}") for word in ("NOT EXISTS", "EXISTS")
    ]
    assert least <= found[0] | found[1] <= asked.rows(f"SELECT DISTINCT ?x {{ {one} }}"), (one, other)


def joining(asked: Asked) -> None:
    """Check that UNION is the union of its parts."""
    one, other = asked.pattern(), asked.pattern(1)
    ask_parts = [f"SELECT DISTINCT ?x {{ {part} }}" for part in (one, other)]
    least = asked.rows(ask_parts[0]) | asked.rows(ask_parts[1])
    both = asked.rows(f"SELECT DISTINCT ?x {{ {{ {one} }} UNION {{ {other} }} }}")
    assert least <= both <= asked.rows(ask_parts[0]) | asked.rows(ask_parts[1]), (one, other)


def counting(asked: Asked) -> None:
    """Check that COUNT is the number of rows, that OPTIONAL removes none, and that LIMIT returns a part."""
    one, other = asked.pattern(), asked.pattern(1)
    least = asked.rows(f"SELECT DISTINCT ?x {{ {one} }}")
    [count] = asked.lines(f"SELECT (COUNT(DISTINCT ?x) AS ?n) {{ {one} FILTER(ISIRI(?x)) }}")
    optional = asked.rows(f"SELECT DISTINCT ?x {{ {one} OPTIONAL {{ {other} }} }}")
    part = asked.rows(f"SELECT DISTINCT ?x {{ {one} FILTER(ISIRI(?x)) }} LIMIT 2")
    most = asked.rows(f"SELECT DISTINCT ?x {{ {one} }}")
    assert len(least) <= int(count) <= len(most), one
    assert least <= optional <= most, (one, other)
    assert part <= most, one
    assert len(part) == min(2, len(part | most)), one


def choosing(asked: Asked) -> None:
    """Check that naming all graphs equals naming none, and that a named graph has its part of all."""
    one = asked.pattern().replace("GRAPH ?g0", "")
    graphs = sorted(row[0].strip("<>") for row in asked.rows("SELECT DISTINCT ?g { GRAPH ?g { ?s ?p ?o } }"))
    least = asked.rows(f"SELECT DISTINCT ?x {{ {one} }}")
    named = " ".join(f"FROM <{graph}>" for graph in graphs)
    assert least <= asked.rows(f"SELECT DISTINCT ?x {named} {{ {one} }}"), one
    graph = asked.random.choice(graphs)
    inside = asked.rows(f"SELECT DISTINCT ?x {{ GRAPH <{graph}> {{ {one} }} }}")
    inside = {(x,) for (x,) in inside if not any(word in x for word in ("camera", "map"))}
    assert inside <= asked.rows(f"SELECT DISTINCT ?x {{ {one} }}"), (one, graph)


LAWS: list[Callable[[Asked], None]] = [adding, parting, joining, counting, choosing]


def keep(http: httpx.Client, law: Callable[[Asked], None], turns: int) -> None:
    """Check a law for random queries on a robot; few may take too long."""
    asked, late = Asked(http, Random(f"{law.__name__} 0")), 0
    for _ in range(turns):
        state = asked.random.getstate()
        for attempt in range(_ATTEMPTS):
            asked.random.setstate(state)
            try:
                law(asked)
            except TimeoutError:
                late += 1
            except AssertionError:
                if attempt == _ATTEMPTS - 1:
                    raise
                continue
            break
    assert late <= turns / 4


@pytest.fixture(scope="module", params=["aircraft", "rover"])
def http(request: pytest.FixtureRequest) -> Iterator[httpx.Client]:
    with served(adapter_for(request.param, AdapterOptions())) as client:
        yield client


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_queries_keep_the_laws_of_sparql(http: httpx.Client, law: Callable[[Asked], None]) -> None:
    keep(http, law, turns=10)
