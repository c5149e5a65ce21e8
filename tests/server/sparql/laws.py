"""Random queries against each other: what SPARQL says of a query must hold of those that are made from it.

A live robot says more as time goes by, so what must hold all of a set is asked before the set or after it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random

import httpx

Rows = set[tuple[str, ...]]
_ATTEMPTS = 3
"""Times that the same queries may contradict each other: the next message has more or fewer nodes."""
_BULKY = ("Image", "PointCloud", "OccupancyGrid", "Mesh")
"""Types of values that only queries which name them have: on the rover those of its camera and map."""


@dataclass
class Asked:
    """A robot that is asked at random. All queries are about ?x, whose IRIs do not change with the values."""

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
        """The rows that begin with an IRI: values change meanwhile, and a list that comes anew has other nodes."""
        return {tuple(line.split("\t")) for line in self.lines(query) if line.startswith("<")}

    def lines(self, query: str) -> list[str]:
        """The rows of a SELECT. Raises TimeoutError where it takes too long."""
        answer = self.http.post("/sparql", data={"query": query}, headers={"Accept": "text/tab-separated-values"})
        if answer.status_code == 503 and answer.json().get("reason") == "time":
            raise TimeoutError
        assert answer.status_code == 200, (query, answer.text)
        return answer.text.split("\n")[1:-1]

    def pattern(self, depth: int = 0) -> str:
        """A random pattern about ?x."""
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
    """Adding a pattern adds no solutions."""
    one, other = asked.pattern(), asked.pattern(1)
    more = asked.rows(f"SELECT DISTINCT ?x {{ {one} {other} }}")
    assert more <= asked.rows(f"SELECT DISTINCT ?x {{ {one} }}"), (one, other)


def parting(asked: Asked) -> None:
    """EXISTS and NOT EXISTS part the rows."""
    one, other = asked.pattern(), asked.pattern(1)
    least = asked.rows(f"SELECT DISTINCT ?x {{ {one} }}")
    found = [
        asked.rows(f"SELECT DISTINCT ?x {{ {one} FILTER {word} {{ {other} }} }}") for word in ("NOT EXISTS", "EXISTS")
    ]
    assert least <= found[0] | found[1] <= asked.rows(f"SELECT DISTINCT ?x {{ {one} }}"), (one, other)


def joining(asked: Asked) -> None:
    """UNION is the union of its parts."""
    one, other = asked.pattern(), asked.pattern(1)
    ask_parts = [f"SELECT DISTINCT ?x {{ {part} }}" for part in (one, other)]
    least = asked.rows(ask_parts[0]) | asked.rows(ask_parts[1])
    both = asked.rows(f"SELECT DISTINCT ?x {{ {{ {one} }} UNION {{ {other} }} }}")
    assert least <= both <= asked.rows(ask_parts[0]) | asked.rows(ask_parts[1]), (one, other)


def counting(asked: Asked) -> None:
    """COUNT is the number of rows; OPTIONAL takes none away; a LIMIT gives a part."""
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
    """Naming all graphs is naming none; a graph that is named has what it has among all."""
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


def keep(http: httpx.Client, law: Callable[[Asked], None], turns: int, seed: int = 0) -> None:
    """Have a robot keep a law for queries at random; few may take too long."""
    asked, late = Asked(http, Random(f"{law.__name__} {seed}")), 0
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
