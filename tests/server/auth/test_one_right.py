"""A reader with one permission crawls everything, and sees nothing outside of that permission."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from tests.server.auth.test_denied_everywhere import (
    RESULTS,
    RULES,
    Client,
    Crawl,
    ask_the_dataset,
    secretive_app,
    subscribe_to_denied,
)

pytestmark = pytest.mark.slow

VIEWS = ("/sparql", "/graphs", "/openapi.json", "/.well-known/**", "/channels/**", "/find")
"""Documents that describe everything that a reader may see."""
RIGHTS: dict[str, tuple[str, ...]] = {
    "entry": ("/",),
    "topic": ("/topics/open",),
    "topics": ("/topics/",),
    "complex": ("/resources/car/",),
    "member": ("/resources/car/", "/resources/open"),
    "action": ("/resources/car/turn",),
    "resources": ("/resources/",),
    "container": ("/data/box/",),
    "document": ("/data/plan",),
    "parameters": ("/parameters/open/",),
    "stop": ("/stop",),
    "node": ("/nodes/robot",),
    "service": ("/services/open_service",),
    "goals": ("/goals/",),
    "calls": ("/calls/",),
    "holds": ("/holds/",),
    "receipts": ("/activity/",),
    "mappings": ("/mappings/",),
    "queries": ("/queries/",),
    "limits": ("/shapes/", "/shapes/limits"),
    "recordings": ("/bags/", "/bags/done/"),
    "cockpit": ("/cockpit/kept",),
}
DATASET = ("/topics/zq7_words", "/data/zq7/document", "/resources/car/", "/activity/", "/topics/zq7_never")
"""Graphs that are requested by name."""


def rules() -> str:
    """The rules of the administrator, and one for each permission."""
    administrator = RULES.split("\n\n")[0]
    own = "".join(
        f"\n[[rule]]\nagents = ['{name}']\nmodes = ['read', 'control']\npaths = {[*paths, *VIEWS]}\n"
        for name, paths in RIGHTS.items()
    )
    return administrator + own


def test_who_has_one_right_is_told_nothing_of_anything_else(tmp_path: Path) -> None:
    asyncio.run(walk_with_each_right(tmp_path))


async def walk_with_each_right(folder: Path) -> None:
    async with secretive_app(folder, rules(), ("admin", *RIGHTS)) as (app, _):
        everything = Crawl(app, "admin")
        await everything.find_paths(["/", *DATASET])
        for turn, (name, paths) in enumerate(RIGHTS.items()):
            crawl = Crawl(app, name)
            crawl.in_full.update(paths)
            await crawl.walk([*paths, *list(everything.seen)[turn % 11 :: 11]])
            await ask_the_dataset(crawl, DATASET, [RESULTS[turn % len(RESULTS)]])
            await subscribe_to_denied(crawl)
            assert not crawl.leaks, name
            assert not crawl.failures, name
        assert (await Client(app, "admin")("GET", "/resources/car/")).leaks
