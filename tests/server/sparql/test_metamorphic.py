"""Random queries compared to each other, on embedded robots."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.made_up import served
from tests.server.sparql.laws import LAWS, Asked, keep

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["aircraft", "rover"])
def http(request: pytest.FixtureRequest) -> Iterator[httpx.Client]:
    with served(adapter_for(request.param, AdapterOptions())) as client:
        yield client


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_queries_keep_the_laws_of_sparql(http: httpx.Client, law: Callable[[Asked], None]) -> None:
    keep(http, law, turns=15)
