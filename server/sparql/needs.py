"""What a query needs: which live values must be in the store before it is asked.

The answer may be too much and never too little; `narrowing.py` finds it.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

_LISTINGS = re.compile(r"/(?:parameters/|(?:nodes|topics|services|actions)/(?:.*/)?$)")


def tells_of_members(graph: str) -> bool:
    """Whether a graph tells what others say, where it is named alone: a tree of parameters, a listing of names."""
    return _LISTINGS.search(graph) is not None


@dataclass(frozen=True, slots=True)
class Demand:
    """Live values that fit one part of a query: of `graphs` (None: any), of topics that use all of `types`.

    `messages` concerns the values of topics (messages, rate, what came when), `parameters` those of parameters.
    """

    graphs: frozenset[str] | None = None
    types: frozenset[str] = frozenset()
    messages: bool = True
    parameters: bool = False

    @property
    def is_anything(self) -> bool:
        """Whether it names no graph and no type."""
        return self.graphs is None and not self.types

    def covers(self, other: Demand) -> bool:
        """Whether all that the other asks for is asked for here."""
        return (
            (self.graphs is None or (other.graphs is not None and other.graphs <= self.graphs))
            and self.types <= other.types
            and self.messages >= other.messages
            and self.parameters >= other.parameters
        )


@dataclass(frozen=True)
class Needs:
    """All live values that a query could see: those that any of its `demands` asks for.

    `documents` are the IRIs (without fragment) of resources that the query names, live or not: what is in the dataset
    only when it is named (a recorded message, say) is to be put there. `terms` are the classes and predicates by which
    it names resources below `resources/`, whose URLs become documents (`GraphSource.documents_of`). `rests_on` are the
    predicates and classes that make the demands too little where clients say them of live values (`mentions.py`).
    `resources` and `records`: it can match what lies below `resources/`, or recorded messages, without naming them;
    `trees`: what trees of parameters say of their members. `graph_names` are the constants of GRAPH and FROM.
    """

    demands: tuple[Demand, ...] = ()
    documents: frozenset[str] = frozenset()
    terms: frozenset[str] = frozenset()
    rests_on: frozenset[str] = frozenset()
    resources: bool = False
    records: bool = False
    trees: bool = False
    graph_names: frozenset[str] = frozenset()

    @cached_property
    def is_everything(self) -> bool:
        """Whether it looks at the messages of any topic whatever: all that are subscribed to are to be there."""
        return any(demand.is_anything and demand.messages for demand in self.demands)

    @cached_property
    def needs_messages(self) -> bool:
        """Whether it needs values of topics at all."""
        return any(demand.messages for demand in self.demands)

    @cached_property
    def needs_parameters(self) -> bool:
        """Whether it needs values of parameters at all."""
        return any(demand.parameters for demand in self.demands)

    @cached_property
    def graphs(self) -> frozenset[str] | None:
        """The only graphs that its demands can concern; None where that is not known from the query alone."""
        if any(demand.graphs is None for demand in self.demands):
            return None
        return frozenset().union(*(demand.graphs or () for demand in self.demands))

    @cached_property
    def types(self) -> frozenset[str]:
        """The message types it names, as ROS names (`geometry_msgs/msg/Twist`)."""
        return frozenset().union(*(demand.types for demand in self.demands))

    def wants_topic(self, url: str, types: Collection[str]) -> bool:
        """Whether the values of the topic at `url` are needed; `types` are its type and all types nested in it."""
        return any(
            demand.messages
            and (demand.graphs is None or url in demand.graphs)
            and all(name in types for name in demand.types)
            for demand in self.demands
        )

    def wants_parameter(self, url: str) -> bool:
        """Whether the value of the parameter at `url` is needed."""
        return any(demand.parameters and (demand.graphs is None or url in demand.graphs) for demand in self.demands)

    def covers(self, other: Needs) -> bool:
        """Whether these needs include all of the other's, documents aside."""
        return all(any(_is_for(mine, one) for mine in self.demands) for one in other.demands)

    def restrict_to(self, graphs: Collection[str]) -> Needs:
        """The same query over these graphs alone (FROM, `default-graph-uri`), which it thereby names, and no others."""
        allowed = frozenset(graphs)
        narrowed = (
            replace(one, graphs=allowed if one.graphs is None else one.graphs & allowed) for one in self.demands
        )
        telling = frozenset(filter(tells_of_members, allowed))
        of_members = (Demand(telling, messages=False, parameters=True),) if telling else ()
        demands = (*(one for one in narrowed if one.graphs), *of_members)
        documents = self.documents | allowed
        return Needs(
            tuple(remove_covered(demands)), documents, rests_on=self.rests_on, graph_names=self.graph_names | allowed
        )

    def with_documents(self, documents: Collection[str]) -> Needs:
        """The same with the documents that its terms stand for."""
        return replace(self, documents=self.documents.union(documents), terms=frozenset())

    def with_mentions(self, documents: frozenset[str] | None) -> Needs:
        """The same with the resources of which clients say what it rests on; None: of any."""
        demands = tuple(remove_covered((*self.demands, Demand(documents, parameters=True))))
        if documents is None:
            return replace(self, demands=demands, rests_on=frozenset(), resources=True, records=True)
        return replace(self, demands=demands, rests_on=frozenset(), documents=self.documents | documents)


def remove_covered(demands: Iterable[Demand]) -> Iterator[Demand]:
    """The demands that no other stands for."""
    kept: list[Demand] = []
    for one in dict.fromkeys(demands):
        if not any(_is_for(other, one) for other in kept):
            kept = [other for other in kept if not _is_for(one, other)]
            kept.append(one)
    yield from kept


def _is_for(one: Demand, other: Demand) -> bool:
    """Whether a demand covers another. What names something has it subscribed to, which one for anything has not."""
    return one.covers(other) and (one.is_anything == other.is_anything or not other.messages)
