"""The edges of the computation graph described: which node publishes, subscribes to, provides what."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set

from pyoxigraph import NamedNode, Triple

from rosld.ontology.describe_graph import NodeView
from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, Statement, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, rdfs, ros


def edges_document(
    url: str, views: Mapping[str, NodeView], space: Space, shown: Set[str], problems: Iterable[tuple[str, str]]
) -> Document:
    """The nodes among the URLs `shown`, each with those of them that it publishes, subscribes to, provides, asks.

    `problems` are URLs with what is wrong with the things there, in words.
    """
    triples: list[Triple] = [*triples_about(NamedNode(url), *RDF_SOURCE, (dcterms.title, text("Who talks to whom")))]

    def links(predicate: NamedNode, urls: Iterable[str]) -> list[Statement]:
        return statements(predicate, [NamedNode(each) for each in urls if each in shown])

    for name, view in views.items():
        if space.node(name) in shown:
            triples += triples_about(
                NamedNode(space.node(name)),
                *links(ros.publishes, (space.topic(topic.name) for topic, _ in view.publishes)),
                *links(ros.subscribes, (space.topic(topic.name) for topic, _ in view.subscribes)),
                *links(ros.provides, (*map(space.service, view.provides), *map(space.action, view.serves))),
                *links(ros.sendsGoalsTo, map(space.action, view.sends_goals_to)),
            )
    for thing, words in problems:
        triples += triples_about(NamedNode(thing), (rdfs.comment, text(words)))
    return Document(url, tuple(triples))
