"""Pages as requested and submitted by a browser, over HTTP."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import httpx

HTML = {"Accept": "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"}
DISPLAY = "/topics/cockpit/display"


def hidden(page: str, method: str) -> str:
    """Return the token of the page's own form with this method."""
    for form in re.findall(r"<form.*?</form>", page, re.DOTALL):
        if f'name="method" value="{method}"' in form and " action=" not in form:
            return re.search(r'name="csrf" value="([^"]+)"', form)[1]  # type: ignore[index]
    raise AssertionError(f"no form for {method}")


def test_style_and_icon_are_served(http: httpx.Client) -> None:
    assert http.get("/style.css").headers["content-type"].startswith("text/css")
    assert http.get("/icon.svg").headers["content-type"] == "image/svg+xml"


def test_an_error_is_a_page_too(http: httpx.Client) -> None:
    page = http.get("/topics/none", headers=HTML)
    assert page.status_code == 404
    assert "There is no topic /none" in page.text


def test_the_form_publishes_and_leads_back(http: httpx.Client) -> None:
    token = hidden(http.get(DISPLAY, headers=HTML).text, "PUT")
    sent = http.post(DISPLAY, data={"csrf": token, "method": "PUT", "data": "by hand"}, headers=HTML)
    assert sent.status_code == 303, sent.text
    assert httpx.URL(sent.headers["location"]).path == DISPLAY
    assert http.get(DISPLAY, headers={"Accept": "application/json"}).json() == {"data": "by hand"}


def test_the_page_after_a_form_says_what_became_of_it(http: httpx.Client) -> None:
    token = hidden(http.get(DISPLAY, headers=HTML).text, "PUT")
    fields = {"csrf": token, "method": "PUT", "data": "said"}
    page = http.post(DISPLAY, data=fields, headers=HTML, follow_redirects=True)
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


def test_a_form_that_does_not_fit_comes_back_as_it_was_typed(serve: Callable[..., Any]) -> None:
    http = serve("aircraft").http
    path = "/services/aircraft/engine/set_speed"
    token = hidden(http.get(path, headers=HTML).text, "POST")
    sent = http.post(path, data={"csrf": token, "method": "POST", "data": "very fast"}, headers=HTML)
    assert sent.status_code == 422
    assert "very fast" in sent.text
    assert "must be a number" in sent.text
    assert "Succeeded" not in http.get("/calls/", headers=HTML).text


def test_the_form_calls_and_leads_to_the_call(serve: Callable[..., Any]) -> None:
    http = serve("aircraft").http
    token = hidden(http.get("/services/aircraft/start", headers=HTML).text, "POST")
    sent = http.post("/services/aircraft/start", data={"csrf": token, "method": "POST"}, headers=HTML)
    assert sent.status_code == 303
    assert "/calls/" in sent.headers["location"]
    assert "started" in http.get(sent.headers["location"], headers=HTML).text


def test_forms_set_and_delete_a_parameter(serve: Callable[..., Any]) -> None:
    http = serve("aircraft").http
    path = "/parameters/cockpit/brightness"
    token = hidden(http.get(path, headers=HTML).text, "PUT")
    fields = {"csrf": token, "method": "PUT", "type": "number", "value": "0.25"}
    assert http.post(path, data=fields, headers=HTML).status_code == 303
    assert http.get(path, headers={"Accept": "application/json"}).json() == 0.25
    token = hidden(http.get(path, headers=HTML).text, "DELETE")
    assert http.post(path, data={"csrf": token, "method": "DELETE"}, headers=HTML).status_code == 303
    assert http.get(path).status_code == 404
