"""Pages about very many resources: short, complete without scripts, and searchable with them."""

from __future__ import annotations

import re
from typing import Any

import httpx
import pytest

from rosld.ontology.modules import CORE, served_triples

pytestmark = pytest.mark.slow

TALL = "document.documentElement.scrollHeight"
SHOWN = "[...document.querySelectorAll('details.thing')].filter((each) => each.checkVisibility()).length"


def test_the_vocabulary_is_folded_by_kind_and_all_of_it_is_there(http: httpx.Client) -> None:
    page = http.get("/ontology", headers={"Accept": "text/html"}).text
    counts = [int(found) for found in re.findall(r'<summary><bdi>[^<]+</bdi> <span class="count">(\d+)</span>', page)]
    assert len(counts) < 20
    assert sum(counts) == page.count('<details class="thing">') > 200
    assert not re.search(r'<details class="(?:thing|group)"[^>]* open', page)
    terms = {
        triple.subject.value.partition("#")[2]
        for triple in served_triples(CORE)
        if getattr(triple.subject, "value", "").startswith("https://w3id.org/rosld#")
    }
    assert len(terms) > 200
    assert {term for term in terms if f'id="{term}"' not in page} == set()
    assert '<p class="filter" hidden>' in page, "a field that does nothing without scripts is not shown"


def test_the_vocabulary_is_short_found_in_by_typing_and_unfolded_by_a_link(tab: Any, http: httpx.Client) -> None:
    tab.open(f"{http.base_url}ontology")
    assert tab.run(TALL) < 4000
    assert tab.run(SHOWN) == 0
    tab.run("document.querySelector('.filter input').focus()")
    tab.type("lifecycle state")
    tab.until(f"{SHOWN} > 0")
    assert tab.run(SHOWN) < 40
    words = "[...document.querySelectorAll('details.thing')].filter((each) => each.checkVisibility())"
    assert tab.run(f"{words}.every((each) => /lifecycle/i.test(each.textContent) && /state/i.test(each.textContent))")
    tab.run("document.querySelector('.filter input').select()")
    tab.type("no such thing anywhere")
    tab.until(f"{SHOWN} === 0")
    tab.open("about:blank")
    tab.open(f"{http.base_url}ontology#Topic")
    tab.until("document.getElementById('Topic').checkVisibility()")
    assert tab.run(SHOWN) > 1
    assert tab.run("document.querySelectorAll('details.thing[open]').length") == 1
