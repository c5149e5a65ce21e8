"""The aircraft in a real browser while other clients fly it: pages update without being reloaded."""

from __future__ import annotations

import json
import time
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

pytestmark = pytest.mark.slow

AIRCRAFT, ENGINE = "resources/aircraft/", "resources/aircraft/engine/"
DISPLAY = "topics/cockpit/display"
LIVE = "document.querySelector('.liveness').dataset.state === 'live'"


@pytest.fixture
def served(own_aircraft: httpx.Client) -> Any:
    """An aircraft that has not been started."""
    return SimpleNamespace(url=str(own_aircraft.base_url), http=own_aircraft)


def watch(tab: Any, url: str) -> None:
    """Open a page, wait until it is live, and add a mark that only reloading removes."""
    tab.open(url)
    tab.until(LIVE)
    tab.run("void (window.sameLoad = true)")


def start(served: Any) -> None:
    served.http.post(f"{AIRCRAFT}start").raise_for_status()


def test_start_is_replaced_by_stop_when_another_client_starts(tab: Any, served: Any) -> None:
    buttons = "[...document.querySelectorAll('.acts button')].map((each) => each.textContent).join()"
    watch(tab, served.url + AIRCRAFT)
    assert tab.run(buttons) == "Start"
    assert not tab.run("document.querySelector('.way')")
    start(served)
    tab.until(f"{buttons} === 'Stop'")
    assert tab.run("document.querySelector('.way').pathname") == f"/{ENGINE}"
    assert tab.run("document.querySelector('.told').innerText.trim()") == "on"
    assert tab.run("sameLoad")
    tab.until("!document.querySelector('[inert]')")
    tab.leave("document.querySelector('.acts button').click()")  # its token is valid: the form is carried out
    tab.until(f"{buttons} === 'Start'")


def test_a_topic_shows_each_message_as_text(tab: Any, served: Any) -> None:
    watch(tab, served.url + DISPLAY)
    hostile = "</main><script>window.broken = 1</script><img src=x onerror='window.broken = 1'>"
    for words in ("climb", hostile, "two\nlines", "level"):
        served.http.put(DISPLAY, json={"data": words}).raise_for_status()
        field = "document.querySelector('#message dd')?.innerText"
        begins = words.partition("\n")[0]
        shown = tab.until(f"{field}.includes({json.dumps(begins)}) && {field}")
        assert words in shown
    assert tab.run("document.querySelectorAll('main script, main img').length") == 0
    assert tab.run("typeof broken") == "undefined"
    assert tab.run("sameLoad")


def test_times_say_how_long_ago_they_were_by_the_clock_of_the_robot(tab: Any, served: Any) -> None:
    served.http.put(DISPLAY, json={"data": "once"}).raise_for_status()
    received = "document.querySelector('.message time')"
    watch(tab, served.url + DISPLAY)
    tab.until(f"/^(now|\\d+ s ago)$/.test({received}.dataset.ago)")
    assert tab.run(f"{received}.textContent").endswith(" UTC")
    tab.run("void (Date.now = ((now) => () => now() + 3 * 3600 * 1000)(Date.now))")
    tab.until(f"{received}.dataset.ago === '3 h ago'")
    tab.open(f"{served.url}activity/")  # a page that follows nothing
    tab.until("/^(now|\\d+ s ago)$/.test(document.querySelector('.members time')?.dataset.ago)")


def test_counts_and_lists_follow_the_graph(tab: Any, served: Any) -> None:
    watch(tab, served.url)
    count = "Number(document.querySelector('li[data-key=\"/topics/\"] .number').textContent)"
    before = tab.run(count)
    body = (
        "<#message> a <https://w3id.org/rosld/types/std_msgs/msg/String> ; "
        '<https://w3id.org/rosld/types/std_msgs/msg/String#data> "by" .'
    )
    made = served.http.put("topics/passing", content=body, headers={"Content-Type": "text/turtle"})
    assert made.is_success, made.text
    tab.until(f"{count} === {before + 1}")
    watch(tab, served.url + "topics/")
    tab.until("document.querySelector('tr[data-key=\"/topics/passing\"]')")
    served.http.delete("topics/passing").raise_for_status()
    tab.until("!document.querySelector('tr[data-key=\"/topics/passing\"]')")
    assert tab.run("sameLoad")


def test_a_fast_topic_costs_a_page_few_updates(tab: Any, served: Any) -> None:
    watch(tab, served.url + "topics/aircraft/engine/speed")
    tab.run("void (window.updates = 0, new MutationObserver(() => updates += 1).observe("
            "document.querySelector('#message'), {subtree: true, characterData: true}))")  # fmt: skip
    began = time.monotonic()
    tab.until("updates >= 6")
    assert time.monotonic() - began >= 5 / 3 * 0.9


def test_without_scripts_every_page_is_whole(tab: Any, served: Any) -> None:
    start(served)
    for path in ("", AIRCRAFT, ENGINE, DISPLAY, "topics/", "nodes/", "parameters/cockpit/", "calls/"):
        tab.send("Emulation.setScriptExecutionDisabled", value=True)
        tab.open(served.url + path)
        tab.send("Emulation.setScriptExecutionDisabled", value=False)
        assert tab.run("document.querySelector('.liveness').checkVisibility()") is False
        assert tab.run("[...document.querySelectorAll('button')].every((each) => each.form || !each.checkVisibility())")
        assert tab.run("document.querySelector('h1').checkVisibility()")
        assert len(tab.run("document.querySelector('main').innerText")) > 40


def test_pages_that_do_not_change_and_calls_that_were_answered_are_not_followed(served: Any) -> None:
    call = served.http.post("services/aircraft/start", json={}).headers["location"]
    paths = ("types/std_msgs/msg/String", "ontology", "sparql", "queries/", "shapes/", call)
    pages = {path: served.http.get(path, headers={"Accept": "text/html"}).text for path in paths}
    assert not [path for path, page in pages.items() if "live.js" in page]
    assert "Succeeded" in pages[call]


def test_a_page_that_answers_a_form_stays_as_it_is(tab: Any, served: Any) -> None:
    start(served)
    watch(tab, served.url + ENGINE)
    tab.run("document.querySelector('form[action$=speed] input[type=number]').select()")
    tab.type("5000")  # from now on no update changes the form
    tab.run("document.querySelector('form[action$=speed]').noValidate = true")
    tab.leave("document.querySelector('form[action$=speed] button').click()")
    assert tab.run("document.querySelector('.notice.error').checkVisibility()")
    assert tab.run("[...document.scripts].filter((each) => each.src.includes('live.js')).length") == 0
    assert tab.run("document.querySelector('[aria-invalid]').value") == "5000"
