"""Pages of resources: the state, the operations on offer, and the target of each form."""

from __future__ import annotations

import re
from collections.abc import Mapping

import pytest

pytestmark = pytest.mark.slow

FORM = re.compile(r"<form.*?</form>", re.DOTALL)


def forms(body: str) -> dict[tuple[str, str], str]:
    """Return the forms of a page by target (empty for the page's own URL) and method."""
    found = {}
    for form in FORM.findall(below_header(body)):
        action = re.search(r'action="([^"]*)"', form)
        method = re.search(r'name="method" value="([^"]*)"', form)
        assert method is not None
        found[(action[1] if action else "", method[1])] = form
    return found


def below_header(body: str) -> str:
    """Return the page without the header of every page: the search, and the stop."""
    return body.partition("<main")[2]


def test_values_have_their_units_and_limits(pages: Mapping[str, bytes]) -> None:
    wing, body = pages["wing"].decode(), pages["engine"].decode()
    assert re.search(r'5</bdi>\s*<a class="unit" href="http://qudt.org/vocab/unit/REV-PER-MIN"', wing)
    speed = forms(body)[("/resources/aircraft/engine/speed", "PUT")]
    assert 'min="0" max="1000" step="any"' in speed
    assert "From 0 to 1000." in speed
    direction = forms(body)[("/resources/aircraft/engine/direction", "PUT")]
    assert "From 0 to 360." in direction


def test_a_choice_is_a_select_in_which_a_value_that_is_no_choice_is_never_chosen(pages: Mapping[str, bytes]) -> None:
    (form,) = forms(pages["select"].decode()).values()
    assert re.findall(r"<option([^>]*)>([^<]*)", form) == [("", "on"), (" selected", "off")]
    form = forms(pages["unmapped"].decode())[("/resources/turtle1/gear", "PUT")]
    assert re.findall(r"<option([^>]*)>", form) == [' value="" selected', "", ""]
    assert "<select" in form
    assert " required" in form


def test_what_cannot_be_read_says_why_and_only_single_scalars_are_set_in_place(pages: Mapping[str, bytes]) -> None:
    body = pages["unmapped"].decode()
    for source in ("get_battery", "distance"):
        assert re.search(rf'cannot be read</span> <bdi class="why">/turtle1/{source} did not respond', body)
    assert "can only be written" in body
    assert "Leonardo" in body
    posted = forms(body)
    assert {action for action, method in posted if method == "PUT"} == {
        f"/resources/turtle1/{name}" for name in ("gear", "lamp")
    }
    changed = re.findall(r'<a href="([^"]+)">Change<', body)
    assert changed == [f"/resources/turtle1/{name}" for name in ("awake", "limits", "name", "pen")]
    assert ("/resources/turtle1/dance", "POST") not in posted, "its type is unknown"
    assert 'href="/resources/turtle1/dance"' in body


def test_a_resource_links_what_is_behind_it_and_folds_its_rdf(pages: Mapping[str, bytes]) -> None:
    number, engine = pages["number"].decode(), pages["engine"].decode()
    behind = number[number.index("In ROS") :]
    assert re.search(r'href="/topics/aircraft/engine/speed".*?topic', behind, re.DOTALL)
    assert 'href="/services/aircraft/engine/set_speed"' in behind
    body = pages["aircraft_started"].decode()
    before, folded = body.split('<details class="folded">')
    assert "action affordance" in folded
    assert "affordance" not in before
    assert "<details open" not in body
    assert ('href="?format=td"' in engine, 'href="?format=td"' in number) == (True, False)
