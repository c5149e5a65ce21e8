"""LDP 5.3: Basic containers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import httpx

from rosld.ontology.vocab import ldp, rdf

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served


def test_5_3_1_1_a_basic_container_is_a_container(
    containers: list[Place], models: Callable[[httpx.Response], set[str]]
) -> None:
    for container in containers:
        assert {"Resource", "RDFSource", "BasicContainer"} <= models(container.get()), container.url
        assert {ldp.Container.value, ldp.BasicContainer.value} <= container.objects("", rdf.type), container.url


def test_5_3_1_1_the_root_of_what_is_kept_is_one(served: Served, models: Callable[[httpx.Response], set[str]]) -> None:
    assert "BasicContainer" in models(served.at("data/").get())
    assert f"{served.url}data/" in served.at("").contained()


def test_5_3_1_1_members_are_linked_by_containment_only(place: Place) -> None:
    made = place.post()
    links = {each.predicate for each in place.graph() if getattr(each.object, "value", None) == made}
    assert links == {ldp.contains}
