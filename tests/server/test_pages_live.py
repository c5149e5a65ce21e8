"""Pages as requested and submitted by a browser, over HTTP."""

from __future__ import annotations

import re

import httpx

HTML = {"Accept": "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"}
DISPLAY = "/topics/cockpit/display"
AIRCRAFT = "/resources/aircraft/"


def hidden(page: str, method: str) -> str:
    """Return the token of the page's own form with this method."""
    for form in re.findall(r"<form.*?</form>", page, re.DOTALL):
        if f'name="method" value="{method}"' in form and " action=" not in form:
            return re.search(r'name="csrf" value="([^"]+)"', form)[1]  # type: ignore[index]
    raise AssertionError(f"no form for {method}")


def test_the_form_publishes_and_leads_back_to_a_page_that_says_so(http: httpx.Client) -> None:
    token = hidden(http.get(DISPLAY, headers=HTML).text, "PUT")
    fields = {"csrf": token, "method": "PUT", "data": "by hand"}
    page = http.post(DISPLAY, data=fields, headers=HTML, follow_redirects=True)
    assert (page.history[0].status_code, page.url.path) == (303, DISPLAY)
    assert http.get(DISPLAY, headers={"Accept": "application/json"}).json() == {"data": "by hand"}
    notice = re.search(r'<div class="notice good">.*?</div>', page.text, re.DOTALL)
    assert notice, page.text
    assert re.search(r"Done: publish .*/cockpit/display\S*\. It reached one subscriber\.", notice[0])
    assert "data-live" in page.text, "it is followed as usual"
    receipt = re.search(r'<a href="([^"]+)">Receipt</a>', notice[0])
    assert receipt
    assert http.get(page.url.join(receipt[1]), headers={"Accept": "application/json"}).json()["matched"] == 1
    assert '"notice good"' not in http.get(f"{DISPLAY}?receipt=unknown", headers=HTML).text
    with http.stream(
        "GET", page.url.copy_merge_params({"format": "html"}), headers={"Accept": "text/event-stream"}
    ) as stream:
        first = next(line for line in stream.iter_lines() if "It reached" in line)
    assert "one subscriber" in first, "the page goes on saying it while it is followed"


def test_a_form_calls_or_comes_back_as_it_was_typed(own_aircraft: httpx.Client) -> None:
    http = own_aircraft
    path = "/services/aircraft/engine/set_speed"
    token = hidden(http.get(path, headers=HTML).text, "POST")
    sent = http.post(path, data={"csrf": token, "method": "POST", "data": "very fast"}, headers=HTML)
    assert sent.status_code == 422
    assert "very fast" in sent.text
    assert "must be a number" in sent.text
    assert "Succeeded" not in http.get("/calls/", headers=HTML).text
    token = hidden(http.get("/services/aircraft/start", headers=HTML).text, "POST")
    sent = http.post("/services/aircraft/start", data={"csrf": token, "method": "POST"}, headers=HTML)
    assert sent.status_code == 303
    assert "/calls/" in sent.headers["location"]
    assert "started" in http.get(sent.headers["location"], headers=HTML).text


def test_forms_set_and_delete_a_parameter(http: httpx.Client) -> None:
    path = "/parameters/cockpit/brightness"
    token = hidden(http.get(path, headers=HTML).text, "PUT")
    fields = {"csrf": token, "method": "PUT", "type": "number", "value": "0.25"}
    assert http.post(path, data=fields, headers=HTML).status_code == 303
    assert http.get(path, headers={"Accept": "application/json"}).json() == 0.25
    token = hidden(http.get(path, headers=HTML).text, "DELETE")
    assert http.post(path, data={"csrf": token, "method": "DELETE"}, headers=HTML).status_code == 303
    assert http.get(path).status_code == 404


def browser(http: httpx.Client) -> httpx.Client:
    """Return the client, which asks for pages from now on."""
    http.headers.update(HTML)
    return http


def forms(page: str) -> dict[str, str]:
    """Return the tokens of a page's forms by target; empty for the page's own URL."""
    found = {}
    for form in re.findall(r"<form.*?</form>", page.partition("<main")[2], re.DOTALL):
        action = re.search(r'action="([^"]*)"', form)
        token = re.search(r'name="csrf" value="([^"]+)"', form)
        assert token is not None
        found[action[1] if action else ""] = token[1]
    return found


def test_a_button_of_an_old_page_is_told_why_it_is_gone(own_aircraft: httpx.Client) -> None:
    http = browser(own_aircraft)
    token = forms(http.get(AIRCRAFT).text)[f"{AIRCRAFT}start"]
    fields = {"csrf": token, "method": "POST"}
    assert http.post(f"{AIRCRAFT}start", data=fields).status_code == 303
    again = http.post(f"{AIRCRAFT}start", data=fields)
    assert again.status_code == 409
    assert "is not on offer now" in again.text
    assert f'<a href="{AIRCRAFT}">' in again.text


def test_a_token_is_for_one_action_only(own_aircraft: httpx.Client) -> None:
    http = browser(own_aircraft)
    tokens = forms(http.get(AIRCRAFT).text)
    fields = {"csrf": tokens[f"{AIRCRAFT}power"], "method": "POST"}
    assert http.post(f"{AIRCRAFT}start", data=fields).status_code == 403
    assert http.get(f"{AIRCRAFT}power", headers={"Accept": "application/json"}).json() == "off"
    token = forms(http.get(f"{AIRCRAFT}start").text)[""]
    assert http.post(AIRCRAFT, data={"csrf": token, "method": "POST"}).status_code == 403


def test_no_form_leads_elsewhere(own_aircraft: httpx.Client) -> None:
    http = browser(own_aircraft)
    token = forms(http.get("/resources/cockpit/brightness").text)[""]
    fields = {"csrf": token, "method": "PUT", "type": "number", "value": "0.5"}
    for referer in ("http://[", "https://elsewhere.example/x", "javascript:alert(1)", "//x/y"):
        sent = http.post("/resources/cockpit/brightness", data=fields, headers={"Referer": referer})
        assert sent.status_code == 303
        assert sent.headers["location"].startswith(str(http.base_url)), referer
