"""Values of parameters and their names: what lies in a tree, what a tree comes to parameter by parameter."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping

from rosld.adapters.model import Graph, ParameterValue
from rosld.ontology.parameters import parameter_json


def omit_parameters(name: str, tree: dict[str, ParameterValue], omitted: Container[str]) -> dict[str, ParameterValue]:
    """The tree of a name without these parameters, and without the trees that hold no others.

    Where nothing is omitted it is the same object, which tells so without a comparison of all values.
    """
    kept: dict[str, ParameterValue] = {}
    for key, value in tree.items():
        path = f"{name.rstrip('/')}/{key}"
        shown = omit_parameters(path, value, omitted) if isinstance(value, dict) else value
        if path not in omitted and (shown is value or shown):
            kept[key] = shown
    return tree if len(kept) == len(tree) and all(kept[key] is tree[key] for key in tree) else kept


def names_below(name: str, graph: Graph) -> list[str]:
    """The names of the parameters that lie in the tree of this name now, at any depth."""
    prefix = name.rstrip("/") + "/"
    return [each for each in graph.parameters if each.startswith(prefix)]


def leaf_values(name: str, value: ParameterValue) -> Iterator[tuple[str, ParameterValue]]:
    """The parameters that a tree written at `name` comes to, each with its value; of no tree, this one."""
    if not isinstance(value, dict):
        yield name, value
        return
    for key, inner in value.items():
        yield from leaf_values(f"{name.rstrip('/')}/{key}", inner)


def leaf_names(name: str, value: ParameterValue) -> Iterator[str]:
    """The names of the parameters that a tree written at `name` comes to."""
    return (leaf for leaf, _ in leaf_values(name, value))


def changed_values(
    before: Mapping[str, ParameterValue], after: Mapping[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Those of the values after a write that are not written as before: 1, 1.0 and true are three."""
    return {
        name: value
        for name, value in after.items()
        if name not in before or parameter_json(before[name]) != parameter_json(value)
    }


def overlaps(one: str, other: str) -> bool:
    """Whether two names are the same, or one is a tree that holds the other."""
    ones, others = one.rstrip("/") + "/", other.rstrip("/") + "/"
    return ones.startswith(others) or others.startswith(ones)
