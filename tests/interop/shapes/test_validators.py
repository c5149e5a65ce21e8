"""The server accepts exactly the bodies that conform to its linked shapes according to TopBraid and Jena."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.vocab import rdf, ros
from tests.interop.shapes.validators import VALIDATORS
from tests.shapes.limited_robot import (
    TYPES,
    VALUES,
    difference,
    is_malformed,
    is_taken,
    linked_shape,
    point,
    put_together,
    served_robot,
    stamped,
)

ANYTHING = "parameters/lamp/anything"
"""A parameter without a declaration: its shape does not check the elements of arrays."""
PATHS = (
    *("resources/arm/grip", "resources/arm/label", "topics/speed", "topics/aim"),
    *("parameters/lamp/gain", "parameters/lamp/lit", "parameters/lamp/counts", ANYTHING),
)


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    with served_robot(tmp_path_factory.mktemp("limits")) as http:
        yield http


def sample(client: httpx.Client, path: str) -> tuple[NamedNode, list[list[Triple]]]:
    """Return bodies for a resource, and the node that they are about."""
    url = str(client.base_url.join(f"/{path}"))
    if path == "topics/aim":
        whole = stamped(url)
        bodies = [whole, *([*whole[:number], *whole[number + 1 :]] for number in range(1, len(whole)))]
        bodies += [[*whole, Triple(one.subject, one.predicate, Literal("another"))] for one in whole[1:]]
        bodies += [
            [*whole[:-3], *point(BlankNode("p"), *values)] for values in (("1001", "0", "0"), ("0", "NaN", "INF"))
        ]
        return NamedNode(f"{url}#message"), bodies
    if path.startswith("topics/"):
        node, class_ = NamedNode(f"{url}#message"), f"{TYPES}std_msgs/msg/Float64"
        is_one = Triple(node, rdf.type, NamedNode(class_))
        return node, [[is_one, Triple(node, NamedNode(f"{class_}#data"), value)] for value in VALUES]
    predicate = ros.value if path.startswith("parameters/") else rdf.value
    values = [value for value in VALUES if not (path == ANYTHING and is_malformed(value))]
    return NamedNode(url), [[Triple(NamedNode(url), predicate, value)] for value in values]


@pytest.mark.parametrize("validator", VALIDATORS)
def test_a_body_is_taken_where_it_conforms(client: httpx.Client, tmp_path: Path, validator: str) -> None:
    """All bodies are validated together, as starting the JVM takes most of the time."""
    judged, data, shapes = {}, tmp_path / "data.nt", tmp_path / "shapes.nt"
    with data.open("w") as all_data, shapes.open("w") as all_shapes:
        for number, path in enumerate(PATHS):
            node, bodies = sample(client, path)
            url = node.value.partition("#")[0]
            judged[path] = together = put_together(linked_shape(client, url), bodies, node, f"{number}-")
            all_data.write(together.data.serialize(format="nt"))
            all_shapes.write(together.shapes.serialize(format="nt"))
    report = VALIDATORS[validator](data, shapes)
    for path, together in judged.items():
        node, bodies = sample(client, path)
        by_server = [is_taken(client, node.value.partition("#")[0], body) for body in bodies]
        assert not difference(bodies, by_server, together.conforming(report)), path
        assert 0 < sum(by_server) < len(bodies), path
