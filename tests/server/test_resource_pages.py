"""The aircraft flown by hand: pages of resources as requested and submitted by a browser, over HTTP."""

from __future__ import annotations

import re

import httpx
import pytest

HTML = {"Accept": "text/html"}
AIRCRAFT, ENGINE = "/resources/aircraft/", "/resources/aircraft/engine/"


@pytest.fixture
def http(own_aircraft: httpx.Client) -> httpx.Client:
    """A browser at an aircraft that has not been started."""
    own_aircraft.headers.update(HTML)
    return own_aircraft


def forms(page: str) -> dict[str, str]:
    """Return the tokens of a page's forms by target; empty for the page's own URL."""
    found = {}
    for form in re.findall(r"<form.*?</form>", page.partition("<main")[2], re.DOTALL):
        action = re.search(r'action="([^"]*)"', form)
        token = re.search(r'name="csrf" value="([^"]+)"', form)
        assert token is not None
        found[action[1] if action else ""] = token[1]
    return found


def test_a_button_of_an_old_page_is_told_why_it_is_gone(http: httpx.Client) -> None:
    token = forms(http.get(AIRCRAFT).text)[f"{AIRCRAFT}start"]
    fields = {"csrf": token, "method": "POST"}
    assert http.post(f"{AIRCRAFT}start", data=fields).status_code == 303
    again = http.post(f"{AIRCRAFT}start", data=fields)
    assert again.status_code == 409
    assert "is not on offer now" in again.text
    assert f'<a href="{AIRCRAFT}">' in again.text


def test_a_token_is_for_one_action_only(http: httpx.Client) -> None:
    tokens = forms(http.get(AIRCRAFT).text)
    fields = {"csrf": tokens[f"{AIRCRAFT}power"], "method": "POST"}
    assert http.post(f"{AIRCRAFT}start", data=fields).status_code == 403
    assert http.get(f"{AIRCRAFT}power", headers={"Accept": "application/json"}).json() == "off"
    token = forms(http.get(f"{AIRCRAFT}start").text)[""]
    assert http.post(AIRCRAFT, data={"csrf": token, "method": "POST"}).status_code == 403


def test_no_form_leads_elsewhere(http: httpx.Client) -> None:
    token = forms(http.get("/resources/cockpit/brightness").text)[""]
    fields = {"csrf": token, "method": "PUT", "type": "number", "value": "0.5"}
    for referer in ("http://[", "https://elsewhere.example/x", "javascript:alert(1)", "//x/y"):
        sent = http.post("/resources/cockpit/brightness", data=fields, headers={"Referer": referer})
        assert sent.status_code == 303
        assert sent.headers["location"].startswith(str(http.base_url)), referer


def test_the_entry_page_leads_to_the_cockpit_first_and_then_to_the_resources(http: httpx.Client) -> None:
    cards = re.findall(r'<li[^>]*><a href="([^"]+)"><span class="number">', http.get("/").text)
    assert cards[:2] == ["/cockpit/default", "/resources/"]
    missing = http.get(f"{ENGINE}speed")
    assert missing.status_code == 404
    assert f'<a href="{AIRCRAFT}">' in missing.text, "the way back"
