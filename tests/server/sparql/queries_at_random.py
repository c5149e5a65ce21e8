"""Random queries of every form, derived from the statements of a dataset, so that most of them find results."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from random import Random

from pyoxigraph import BlankNode, Literal, NamedNode, Quad, Triple

from rosld.ontology.vocab import rdf

Term = NamedNode | BlankNode | Literal | Triple


_MAX_PATTERNS = 4
"""Time limit of a query that nothing ends: the store has none."""
_BEGINNINGS = ("", "_", "0", "__")
"""Initial characters of the name of a variable (SPARQL 1.1 Query, 19.8, VARNAME)."""


KINDS = ("OPTIONAL", "OPTIONAL", "MINUS", "EXISTS", "NOT EXISTS", "UNION", "group", "GRAPH", "GRAPH", "SELECT", "COUNT")


class Maker:
    """Generator of a query: terms of the dataset stand for themselves, or for variables with a consistent meaning."""

    def __init__(self, quads: Sequence[Quad], interesting: Sequence[Sequence[Quad]], random: Random) -> None:
        self._quads, self._kinds, self._random = quads, interesting, random
        self._about: dict[Term, list[Quad]] = defaultdict(list)
        self._to: dict[Term, list[Quad]] = defaultdict(list)
        for quad in quads:
            self._about[quad.subject].append(quad)
            self._to[quad.object].append(quad)
        self._names: dict[Term, str] = {}

    @property
    def _interesting(self) -> Sequence[Quad]:
        """Return triples worth querying: each kind equally often."""
        return self._random.choice(self._kinds)

    def query(self, seed: int) -> str:
        """Return a query, the same for the same seed."""
        self._random.seed(seed)
        self._left = _MAX_PATTERNS
        self._names = {}
        random = self._random
        form = random.random()
        group = self._group(2)
        names = list(self._names.values()) or ["?none"]
        source = self._dataset() if random.random() < 0.06 else ""
        if form < 0.5:
            projection = random.choice(["*", "*", "*", "DISTINCT *", " ".join(sorted(set(random.choices(names, k=2))))])
            return f"SELECT {projection} {source}WHERE {group}"
        if form < 0.6:
            name = random.choice(names)
            having = " HAVING (COUNT(*) > 1)" if random.random() < 0.3 else ""
            return f"SELECT {name} (COUNT(*) AS ?count) {source}WHERE {group} GROUP BY {name}{having}"
        if form < 0.65:
            return f"SELECT (COUNT(DISTINCT {random.choice(names)}) AS ?count) {source}WHERE {group}"
        if form < 0.75:
            return f"ASK {source}{group}"
        if form < 0.85:
            return f"CONSTRUCT {{ {self._triple()} {self._triple()} }} {source}WHERE {group}"
        if form < 0.89:
            return f"CONSTRUCT {source}WHERE {{ {self._patterns(2, paths=False)} }}"
        if form < 0.95:
            return f"DESCRIBE {random.choice(names)} {source}WHERE {group}"
        return f"DESCRIBE {self._constant(random.choice(self._interesting).subject)}"

    def _dataset(self) -> str:
        graphs = self._random.sample(self._interesting, 2)
        return f"FROM {graphs[0].graph_name} FROM NAMED {graphs[1].graph_name} "

    def _group(self, depth: int) -> str:
        random = self._random
        members = [self._patterns(random.choice([1, 1, 2, 2, 3]))]
        for _ in range(random.choice([0, 0, 1, 1, 2])):
            members.insert(random.choice([len(members), len(members), 0]), self._member(depth))
        return "{ " + " ".join(members) + " }"

    def _member(self, depth: int) -> str:
        random = self._random
        if depth == 0 or self._left <= 0 or random.random() < 0.35:
            return self._data()
        inner = self._group(depth - 1)
        kind = random.choice(KINDS)
        names = list(self._names.values()) or ["?none"]
        if kind in ("EXISTS", "NOT EXISTS"):
            return f"FILTER {kind} {inner}"
        if kind == "UNION":
            return f"{inner} UNION {self._group(depth - 1)}"
        if kind == "GRAPH":
            graph = random.choice(self._interesting).graph_name
            return f"GRAPH {random.choice(['?g', '?g', str(graph), self._name(graph)])} {inner}"
        if kind == "SELECT":
            return f"{{ SELECT {random.choice(['*', 'DISTINCT *', random.choice(names)])} {inner} }}"
        if kind == "COUNT":
            name = random.choice(names)
            return f"{{ SELECT {name} (COUNT(*) AS ?n{random.randrange(9)}) {inner} GROUP BY {name} }}"
        return inner if kind == "group" else f"{kind} {inner}"

    def _data(self) -> str:
        random = self._random
        named = [(term, name) for term, name in self._names.items() if not isinstance(term, BlankNode | Triple)]
        if not named:
            return ""
        term, name = random.choice(named)
        other = random.choice(self._interesting).subject
        others = f" {other}" if isinstance(other, NamedNode) and random.random() < 0.4 else ""
        tests = (f"= {term}", f"!= {term}", f"IN ({term})") if isinstance(term, NamedNode) else ()
        return random.choice(
            [
                f"VALUES {name} {{ {term}{others} }}",
                f"VALUES ({name} ?more) {{ ({term} UNDEF) }}",
                f"BIND({term} AS ?bound{random.randrange(99)})",
                f"FILTER(sameTerm({name}, {term}))",
                *(f"FILTER({name} {test})" for test in tests),
                f"FILTER(isIRI({name}))",
                f"FILTER(BOUND({name}))",
            ]
        )

    def _patterns(self, count: int, paths: bool = True) -> str:
        """Return triple patterns that match connected triples."""
        random = self._random
        count = max(1, min(count, self._left))
        self._left -= count
        quad = self._start()
        found = [self._pattern(quad, paths)]
        while len(found) < count:
            near = [*self._about[quad.subject], *self._about.get(quad.object, []), *self._to.get(quad.subject, [])]
            quad = random.choice(near or self._interesting)
            found.append(self._pattern(quad, paths))
        return " ".join(found)

    def _start(self) -> Quad:
        """Return a triple, usually about a resource already in the query, so that its groups have an effect."""
        random = self._random
        known = [term for term in self._names if term in self._about or term in self._to]
        term = random.choice(known) if known and random.random() < 0.97 else None
        near = [] if term is None else self._about.get(term, []) + self._to.get(term, [])
        return random.choice(near or (self._interesting if random.random() < 0.9 else self._quads))

    def _pattern(self, quad: Quad, paths: bool) -> str:
        random = self._random
        subject = self._term(quad.subject, 0.75)
        object = self._term(quad.object, 0.2 if quad.predicate == rdf.type else 0.75)
        chance = random.random()
        if chance < 0.06:
            return f"{subject} {self._name(quad.predicate)} {object} ."
        if paths and chance < 0.35:
            return self._path(subject, quad, object)
        return f"{subject} {quad.predicate} {object} ."

    def _path(self, subject: str, quad: Quad, object: str) -> str:
        """Return a path of at least one step: in GRAPH, results of empty paths depend on the store's order of joins."""
        random = self._random
        step, other = str(quad.predicate), str(random.choice(self._interesting).predicate)
        onward = random.choice(self._about.get(quad.object) or [quad])
        path = random.choice(
            [
                f"{step}|{other}", f"{step}+", f"({step}|{other})+",
                f"!{other}", f"!({other}|^{step})", f"{step}/{onward.predicate}", f"{step}/{onward.predicate}*",
                f"{step}/({onward.predicate}|{other})?", f"({step}/{onward.predicate})+",
            ]
        )  # fmt: skip
        if random.random() < 0.15:
            return f"{object} ^({path}) {subject} ." if not object.startswith('"') else f"{subject} {path} {object} ."
        if "/" in path and random.random() < 0.7:
            object = self._term(onward.object, 0.8)
        return f"{subject} {path} {object} ."

    def _triple(self) -> str:
        names = list(self._names.values()) or ["?none"]
        return f"{self._random.choice(names)} {rdf.value} {self._random.choice(names)} ."

    def _constant(self, term: Term) -> str:
        return str(term) if isinstance(term, NamedNode) else str(rdf.nil)

    def _term(self, term: Term, chance: float) -> str:
        """Return a term or, with this probability, the variable that stands for it."""
        if isinstance(term, BlankNode | Triple) or term in self._names or self._random.random() < chance:
            if term in self._names and not isinstance(term, BlankNode | Triple) and self._random.random() < 0.15:
                return str(term)
            return self._name(term)
        return str(term)

    def _name(self, term: Term) -> str:
        return self._names.setdefault(term, f"?{_BEGINNINGS[len(self._names) % 4]}v{len(self._names)}")
