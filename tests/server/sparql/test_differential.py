"""Narrowing against everything: queries at random answer over what they need as over all there is.

What a query says that it did not look at (`Needs.resources`, `Needs.records`) is left out of everything, too.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Iterator
from random import Random

import pytest
from pyoxigraph import Quad

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from rosld.server.http.problem import Problem
from rosld.server.routing.services import Services
from rosld.server.settings import Settings
from tests.server.sparql import frozen, recorded
from tests.server.sparql.frozen import Comparison, Frozen, TooMany, freeze, quads_of
from tests.server.sparql.queries_at_random import Maker

KEPT = {
    "nothing": lambda robot: {},
    "notes": frozen.notes,
    "contradictions": lambda robot: {**frozen.notes(robot), **frozen.claims(robot)},
    "triples about the empty list": lambda robot: {**frozen.claims(robot), **frozen.empty_list(robot)},
}
QUERIES = 400
"""Queries of each robot beside each kind of what clients keep."""


@pytest.fixture(scope="module", params=["the aircraft", "a recording"])
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Frozen]:
    """A robot that stands still, all of whose topics are subscribed to."""
    source = "aircraft"
    if request.param == "a recording":
        source = str(recorded.record(tmp_path_factory.mktemp("recorded") / "run"))
    loop = asyncio.new_event_loop()
    served = Services(adapter_for(source, AdapterOptions()), Settings(subscribe=("*",)))
    loop.run_until_complete(served.start())
    yield loop.run_until_complete(freeze(served))
    loop.run_until_complete(served.stop())
    loop.close()


@pytest.mark.parametrize("kept", KEPT)
def test_a_query_answers_over_what_it_needs_as_over_everything(robot: Frozen, kept: str) -> None:
    comparison = Comparison(robot, KEPT[kept](robot))
    always = {(quad.triple, quad.graph_name) for quad in quads_of(robot.described)}
    kinds: dict[str, list[Quad]] = defaultdict(list)
    everything = sorted(quads_of({**robot.described, **robot.live, **comparison.kept}), key=str)
    for quad in everything:
        if (quad.triple, quad.graph_name) not in always:
            kinds[robot.kind(quad.graph_name.value)].append(quad)
    maker = Maker(everything, list(kinds.values()), Random(0))
    refused = 0
    for seed in range(QUERIES):
        query = maker.query(seed)
        try:
            narrowed, full = comparison.differences(query)
        except (SyntaxError, ValueError, Problem, TooMany):
            refused += 1
            continue
        assert narrowed == full, f"{query} (seed {seed}) needs {comparison.needs(query)}"
    assert refused < QUERIES / 20
