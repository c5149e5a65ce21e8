"""A reader with no rights but one walks everything, and nothing that they are told speaks of anything else."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import chain

import pytest

from tests.server.auth.conftest import Guarded
from tests.server.auth.marked import (
    ADMIN,
    VIEWS,
    asked_of_the_dataset,
    everywhere,
    fill,
    markers,
    said_to,
    streamed_to,
)

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Case:
    """One right, and the secrets that are what it is about."""

    paths: tuple[str, ...]
    modes: tuple[str, ...] = ("read",)
    own: frozenset[str] = field(default_factory=frozenset)


CASES = {
    "entry": Case(("/",)),
    "topic": Case(("/topics/aircraft/engine/speed",)),
    "topics": Case(("/topics/",)),
    "holder": Case(("/topics/zebratopic",), ("read", "control"), frozenset({"zebratopic", "zebravalue", "zebraheld"})),
    "complex": Case(("/resources/aircraft/",)),
    "complex-and-member": Case(("/resources/aircraft/", "/resources/aircraft/power"), ("read", "control")),
    "member": Case(("/resources/aircraft/engine/speed",), own=frozenset({"765.25"})),
    "action": Case(("/resources/aircraft/zebraturn",), ("read", "control"), frozenset({"zebraturn"})),
    "resources": Case(("/resources/",)),
    "container": Case(("/data/open/",)),
    "document": Case(("/data/open/plan",)),
    "parameters": Case(("/parameters/open/",)),
    "parameter": Case(("/parameters/open/number",)),
    "stop": Case(("/stop",)),
    "node": Case(("/nodes/aircraft",)),
    "service": Case(("/services/aircraft/start",), ("read", "control")),
    "goals": Case(("/goals/",)),
    "calls": Case(("/calls/",)),
    "holds": Case(("/holds/",)),
    "receipts": Case(("/activity/",)),
    "mappings": Case(("/mappings/",)),
    "queries": Case(("/queries/",)),
    "shapes": Case(("/shapes/",)),
    "limits": Case(("/shapes/limits",)),
}
ASKED = (
    "/resources/aircraft/", "/resources/aircraft/zebraturn", "/zebranever", "/data/open/", "/data/zebradocument",
    "/data/zebragone", "/parameters/zebratree/zebraleaf", "/topics/zebratopic", "/stop", "/mappings/zebramapping",
    "/activity/",
)  # fmt: skip
"""What is asked for by queries, updates and the graph store."""


def rules() -> str:
    """The administrator's rule, and one for each case."""

    def rule(agent: str, modes: tuple[str, ...], paths: tuple[str, ...]) -> str:
        return f"[[rule]]\nagents = ['{agent}']\nmodes = {list(modes)}\npaths = {list(paths)}\n"

    own = [rule(name, case.modes, case.paths) + rule(name, ("read",), VIEWS) for name, case in CASES.items()]
    return rule(ADMIN, ("read", "write", "control", "administer"), ("/**",)) + "".join(own)


@pytest.fixture(scope="module")
def secretive(guard: Callable[..., Guarded], tmp_path_factory: pytest.TempPathFactory) -> Guarded:
    """An aircraft full of secrets."""
    found = guard(rules(), ADMIN, *CASES, options=("--data", str(tmp_path_factory.mktemp("secrets"))))
    fill(found[ADMIN])
    return found


@pytest.fixture(scope="module")
def paths(secretive: Guarded) -> list[str]:
    """The paths of everything there is."""
    found = everywhere(secretive)
    assert {"/topics/zebratopic", "/holds/", "/data/open/zebraplan", "/mappings/zebramapping"} <= set(found)
    assert any(path.startswith("/holds/") and path != "/holds/" for path in found)
    return found


def share(name: str, everything: list[str]) -> list[str]:
    """Return a third of these paths, another for the next case, and all in the folders of the case's own."""
    folders = {re.split("[/?]", path)[1] for path in CASES[name].paths}
    turn = list(CASES).index(name)
    return [
        path
        for number, path in enumerate(everything)
        if (number + turn) % 3 == 0 or re.split("[/?]", path)[1] in folders
    ]


@pytest.mark.parametrize("name", CASES)
def test_who_has_one_right_is_told_nothing_of_anything_else(secretive: Guarded, paths: list[str], name: str) -> None:
    told: dict[str, set[str]] = {}
    failed: list[str] = []
    asked = chain(
        said_to(secretive, name, share(name, paths), CASES[name].paths),
        asked_of_the_dataset(secretive, name, share(name, list(ASKED))),
        streamed_to(secretive, name, [*CASES[name].paths, "/zebranever", "/data/zebradocument", "/data/zebragone"]),
    )
    for words, request, answer in asked:
        secrets = markers(answer.said, request) - CASES[name].own
        if secrets:
            told[words] = secrets
        if answer.status >= 500:
            failed.append(f"{words}: {answer.status} {answer.text}")
    assert not told
    assert not failed


def test_the_walk_recognises_secrets_where_they_may_be_read(secretive: Guarded, paths: list[str]) -> None:
    found: set[str] = set()
    for _, _, answer in chain(said_to(secretive, ADMIN, READABLE), asked_of_the_dataset(secretive, ADMIN, [])):
        found |= markers(answer.said)
    assert found >= EXPECTED, EXPECTED - found


READABLE = [
    "/resources/aircraft/", "/resources/aircraft/engine/speed", "/stop", "/openapi.json", "/.well-known/wot", "/holds/",
    "/parameters/open/", "/queries/zebraquery.meta", "/topics/zebratopic",
]  # fmt: skip
EXPECTED = {
    "zebrastopcontent", "zebraspeed", "zebraparameter", "zebraleafvalue", "zebrastart", "zebratopic", "zebravalue",
    "zebraheld", "zebrapurpose", "zebraplanned", "zebratext", "zebraadmin", "zebralabel", "765.25", "4321.125",
    "7654.375",
}  # fmt: skip
