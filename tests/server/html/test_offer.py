"""Pages of resources: the state, what can be done now, and where each form posts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from types import ModuleType

from rosld.server.html import Page, Site, ValueForm, forms_of, render_page
from rosld.server.hypermedia.views import ComplexView, PropertyView
from rosld.shapes.value import ScalarShape

FORM = re.compile(r"<form.*?</form>", re.DOTALL)


def forms(body: str) -> dict[tuple[str, str], str]:
    """The forms of a page by where they post (empty for the page's own URL) and the verb they mean."""
    found = {}
    for form in FORM.findall(below_header(body)):
        action = re.search(r'action="([^"]*)"', form)
        method = re.search(r'name="method" value="([^"]*)"', form)
        assert method is not None
        found[(action[1] if action else "", method[1])] = form
    return found


def drawn(page: Page) -> str:
    return render_page(page).decode()


def below_header(body: str) -> str:
    """The page without what is at the top of every page: the search, and the stop."""
    return body.partition("<main")[2]


def test_a_complex_resource_shows_what_can_be_done_now_and_nothing_else(pages: Mapping[str, bytes]) -> None:
    stopped, started = pages["aircraft_stopped"].decode(), pages["aircraft_started"].decode()
    assert forms(stopped).keys() == {("/resources/aircraft/power", "PUT"), ("/resources/aircraft/start", "POST")}
    assert forms(started).keys() == {("/resources/aircraft/power", "PUT"), ("/resources/aircraft/stop", "POST")}
    assert "/resources/aircraft/engine/" not in stopped
    assert '<a class="way" href="/resources/aircraft/engine/">' in started


def test_each_form_carries_the_token_of_where_it_posts(gallery: ModuleType) -> None:
    page = replace(gallery.aircraft_stopped(), csrf=lambda action: f"token of {action}")
    for (action, _), form in forms(drawn(page)).items():
        assert f'name="csrf" value="token of http://127.0.0.1:8080{action}"' in form
    (own,) = forms(drawn(replace(gallery.press(), csrf=lambda action: f"token of {action or 'itself'}"))).values()
    assert 'value="token of itself"' in own
    assert "action=" not in own


def test_an_action_that_takes_nothing_is_a_button(pages: Mapping[str, bytes]) -> None:
    form = forms(pages["aircraft_stopped"].decode())[("/resources/aircraft/start", "POST")]
    assert '<button type="submit">Start</button>' in form
    assert len(re.findall("<input", form)) == 2


def test_a_read_only_server_offers_no_forms(gallery: ModuleType) -> None:
    page = gallery.aircraft_stopped()
    body = drawn(replace(page, site=replace(page.site, read_only=True), allow=("GET",)))
    assert "<form" not in below_header(body)
    assert "/resources/aircraft/start" in body


def test_values_have_their_units_and_limits(pages: Mapping[str, bytes]) -> None:
    body = pages["engine"].decode()
    assert re.search(r'500\.0</bdi>\s*<a class="unit" href="http://qudt.org/vocab/unit/REV-PER-MIN"', body)
    speed = forms(body)[("/resources/aircraft/engine/speed", "PUT")]
    assert 'min="0" max="1000" step="any"' in speed
    assert "From 0 to 1000." in speed
    direction = forms(body)[("/resources/aircraft/engine/direction", "PUT")]
    assert "At least 0, less than 360." in direction


def test_a_choice_is_a_select_of_what_may_be_sent(pages: Mapping[str, bytes]) -> None:
    (form,) = forms(pages["select"].decode()).values()
    assert re.findall(r"<option([^>]*)>([^<]*)", form) == [("", "on"), (" selected", "off")]


def test_a_present_value_that_is_no_choice_is_never_chosen_unasked(pages: Mapping[str, bytes]) -> None:
    form = forms(pages["unmapped"].decode())[("/resources/turtle1/gear", "PUT")]
    assert re.findall(r"<option([^>]*)>", form) == [' value="" selected', "", ""]
    assert "<select" in form
    assert " required" in form


def test_what_cannot_be_read_says_why_and_the_rest_is_whole(pages: Mapping[str, bytes]) -> None:
    body = pages["unmapped"].decode()
    assert re.search(r"cannot be read</span> <bdi class=\"why\">/get_battery is gone", body)
    assert "no value yet" in body
    assert "can only be written" in body
    assert "Leonardo" in body
    assert "has not answered within 1 s" in pages["unreadable"].decode()


def test_only_single_scalars_are_set_in_place(pages: Mapping[str, bytes]) -> None:
    body = pages["unmapped"].decode()
    posted = {action for action, method in forms(body) if method == "PUT"}
    assert posted == {f"/resources/turtle1/{name}" for name in ("awake", "gear", "lamp")}
    changed = re.findall(r'<a href="([^"]+)">Change<', body)
    assert changed == [f"/resources/turtle1/{name}" for name in ("name", "limits", "height")]


def test_an_action_of_unknown_type_has_no_form(pages: Mapping[str, bytes]) -> None:
    body = pages["unmapped"].decode()
    assert ("/resources/turtle1/dance", "POST") not in forms(body)
    assert 'href="/resources/turtle1/dance"' in body


def test_a_property_that_must_not_be_written_now_has_no_form(gallery: ModuleType) -> None:
    page = gallery.number()
    assert len(forms(drawn(page))) == 1
    assert isinstance(page.offer, PropertyView)
    locked = replace(page.offer, affordance=replace(page.offer.affordance, write=False))
    assert forms_of(locked) == ()
    assert not forms(drawn(replace(page, offer=locked)))


def test_what_is_behind_a_property_is_linked(pages: Mapping[str, bytes]) -> None:
    body = pages["number"].decode()
    behind = body[body.index("In ROS") :]
    assert re.search(r'href="/topics/aircraft/engine/speed".*?topic.*?get_speed".*?service', behind, re.DOTALL)
    assert 'href="/services/aircraft/engine/set_speed"' in behind


def test_affordances_in_rdf_are_folded_away(pages: Mapping[str, bytes]) -> None:
    body = pages["aircraft_started"].decode()
    before, folded = body.split('<details class="folded">')
    assert "action affordance" in folded
    assert "affordance" not in before
    assert "<details open" not in body


def test_a_complex_resource_can_be_read_as_a_thing_description(pages: Mapping[str, bytes]) -> None:
    assert 'href="?format=td"' in pages["engine"].decode()
    assert 'href="?format=td"' not in pages["number"].decode()


def test_a_refused_value_stands_beside_its_reason(pages: Mapping[str, bytes]) -> None:
    (form,) = forms(pages["limited"].decode()).values()
    assert 'value="1200"' in form
    assert "must be at most 1000" in form
    assert 'aria-invalid="true"' in form


def test_a_namespace_of_thousands_has_forms_for_some(gallery: ModuleType) -> None:
    one = gallery.power("on")
    view = ComplexView("http://127.0.0.1:8080/resources/x/", "/x/", (one,) * 1000)
    assert len(forms_of(view)) == 100


def test_a_scalar_without_a_value_is_asked_for_empty(gallery: ModuleType) -> None:
    shape = gallery.SPEED
    assert isinstance(shape, ScalarShape)
    (control,) = ValueForm(shape).controls
    assert control.kind == "input"
    assert control.value == ""
    assert control.required


def test_a_form_to_a_foreign_place_is_not_drawn(gallery: ModuleType) -> None:
    page = gallery.press()
    (form,) = page.forms
    body = drawn(replace(page, forms=(replace(form, action="https://elsewhere.example/"),)))
    assert "<form" not in below_header(body)
    below = Site("http://127.0.0.1:8080/robots/one/", "one")
    there = replace(form, action=f"{below.base}resources/a/start")
    assert forms(drawn(replace(page, site=below, forms=(there,)))).keys() == {("/robots/one/resources/a/start", "POST")}
