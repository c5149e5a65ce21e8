"""Everything that a server says: every URL that can be reached from its entry by following links."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import httpx
from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.vocab import ros, xsd

MAX_URLS = 3_000
ACCEPT = {"Accept": "application/n-triples;q=1, */*;q=0.1"}


@dataclass(frozen=True)
class Crawl:
    """What was found: the triples of each URL, and the status of each that is no RDF."""

    graphs: dict[str, list[Triple]] = field(default_factory=dict)
    others: dict[str, int] = field(default_factory=dict)

    def triples(self) -> list[Triple]:
        """All triples, each once."""
        return list(dict.fromkeys(triple for graph in self.graphs.values() for triple in graph))


def crawl(http: httpx.Client, *beside: str) -> Crawl:
    """Follow every link below the base from its entry on, and from the paths `beside` that nothing links to."""
    base = str(http.base_url)
    found = Crawl()
    ahead = deque([base, *(base + path for path in beside)])
    known = {*ahead, base + "graphs"}  # which copies every graph, as it is at another moment
    while ahead:
        assert len(known) <= MAX_URLS, f"more than {MAX_URLS} URLs"
        url = ahead.popleft()
        answer = http.get(url, headers=ACCEPT, follow_redirects=True)
        if answer.headers.get("content-type", "").partition(";")[0] != "application/n-triples":
            found.others[url] = answer.status_code
            continue
        graph = [
            Triple(quad.subject, quad.predicate, quad.object)
            for quad in parse(answer.content, format=RdfFormat.N_TRIPLES, rename_blank_nodes=True)
        ]
        found.graphs[url] = [each for each in graph if not _is_of_another_moment(each, url)]
        new = [link for link in links(graph) if link.startswith(base) and link not in known]
        known.update(new)
        ahead.extend(dict.fromkeys(new))
    return found


def _is_of_another_moment(triple: Triple, url: str) -> bool:
    """Whether a listing says how one of its members is, which says for itself how it is when it is read."""
    return (
        triple.predicate in (ros.state, ros.status, ros.statusWord)
        and isinstance(triple.subject, NamedNode)
        and triple.subject.value.partition("#")[0] != url
    )


def links(graph: Iterable[Triple]) -> Iterable[str]:
    """The URLs that triples mention, without fragments; of those in literals not what a query makes of another."""
    for term in (term for triple in graph for term in (triple.subject, triple.object)):
        is_url = isinstance(term, Literal) and term.datatype == xsd.anyURI and "?" not in term.value
        if isinstance(term, NamedNode) or is_url:
            yield term.value.partition("#")[0]
