"""The query editor at /sparql in a real browser, and its size: no other page includes it."""

from __future__ import annotations

import json
import re
from typing import Any

import httpx
import pytest

pytestmark = pytest.mark.slow

HTML = {"Accept": "text/html"}
MIRROR = "document.querySelector('#editor .yasqe .CodeMirror').CodeMirror"
RUN = "document.querySelector('#editor [data-part=run]')"
HINTS = "[...document.querySelectorAll('.CodeMirror-hint')].map((each) => each.textContent)"
LINKS = "[...document.querySelectorAll('.yasr a.iri')].map((each) => each.getAttribute('href'))"
PAST = """SELECT ?time ?charge WHERE {
  <topics/battery_state> ros:past ?message .
  ?message ros:received ?time ;
    <https://w3id.org/rosld/types/sensor_msgs/msg/BatteryState#percentage> ?charge .
}"""
PAGES = (
    "/", "/resources/rover/", "/nodes/rover", "/topics/", "/topics/odom", "/topics/scan", "/topics/cmd_vel",
    "/topics/camera/image_raw", "/actions/navigate_to", "/types/nav_msgs/msg/Odometry", "/queries/silent-topics",
    "/bags/history/", "/graph", "/diagnostics", "/plot?y=topics/odom%23twist.twist.linear.x", "/find?q=speed", "/stop",
)  # fmt: skip
"""The rover's pages, without `/ontology`, which is a whole vocabulary of 490 kB."""
MOST = 300_000


@pytest.fixture
def editor(tab: Any, rover: httpx.Client) -> Any:
    """The editor, open and empty. Requests to other hosts fail the test."""
    tab.open(f"{rover.base_url}sparql")
    tab.run(f"{MIRROR}.setValue('')")
    yield tab
    asked = tab.run("performance.getEntriesByType('resource').map((each) => each.name)")
    assert asked
    assert not [each for each in asked if not each.startswith((str(rover.base_url), f"blob:{rover.base_url}"))]


def write(tab: Any, text: str) -> None:
    tab.run(f"void {MIRROR}.focus()")
    tab.type(text)


def answer(tab: Any, view: str = "") -> None:
    """Run the query, and wait until its answer is drawn."""
    tab.run(f"{RUN}.click()")
    tab.until(f"{RUN}.textContent === 'Run' && document.querySelector('.yasr_results').childElementCount")
    if view:
        tab.run(f"document.querySelector('.yasr .select_{view}').click()")


def test_a_typed_query_is_answered_by_links_by_yes_or_by_an_error_in_words(editor: Any, rover: httpx.Client) -> None:
    write(editor, "SELECT ?topic ?type ?class { ?topic ros:hasMessageType ?type ; a ?class }")
    assert editor.run("document.querySelectorAll('.cm-error, .cm-sp-error, .parseErrorIcon').length") == 0
    answer(editor)
    editor.until("document.querySelector('.yasr a[data-iri]')")
    links = editor.run(LINKS)
    assert "/topics/odom" in links
    assert "/types/nav_msgs/msg/Odometry" in links
    assert "/ontology#Topic" in links, "a term leads to where this server describes it"
    address = editor.run("location.href")
    assert "?query=SELECT" in address
    assert "/odom" in rover.get(address, headers=HTML).text.partition('id="results"')[2]
    editor.run(f"{MIRROR}.setValue('')")
    write(editor, "ASK { ?topic a ros:Topic }")
    answer(editor)
    assert "true" in editor.until("document.querySelector('.booleanResult')?.textContent").lower()
    editor.run(f"{MIRROR}.setValue('')")
    write(editor, "SELECT ?topic { ?topic a ros:Topic")
    answer(editor)
    editor.until("document.querySelector('.errorResult [role=alert]')")
    assert "at 2:15 is not closed" in editor.run("document.querySelector('.errorResult').textContent")


def test_numbers_over_time_are_drawn_and_the_address_opens_the_plot_again(editor: Any) -> None:
    write(editor, PAST)
    answer(editor, "Plot")
    points = "Number(document.querySelector('.yasr .plotting figure')?.dataset.points)"
    editor.until(f"{points} >= 1")
    assert editor.run("[...document.querySelectorAll('.u-legend .u-label')].map((each) => each.textContent)") == [
        "Time",
        "charge",
    ]
    address = editor.run("location.href")
    assert address.endswith("#plot")
    editor.open("about:blank")
    editor.open(address)
    editor.until(f"{points} >= 1")


def test_what_a_graph_links_is_a_picture_of_links(editor: Any) -> None:
    write(editor, "CONSTRUCT { ?node ros:publishes ?topic } WHERE { ?node ros:publishes ?topic }")
    answer(editor, "Links")
    editor.until("document.querySelectorAll('svg.links a').length > 5")
    assert editor.run("document.querySelector('svg.links a[href=\"/topics/odom\"] text').textContent") == "/odom"


def test_a_stored_query_is_loaded_with_fields_for_its_parameters(editor: Any) -> None:
    stored = "document.getElementById('stored')"
    editor.run(f"{stored}.value = '/queries/node', {stored}.dispatchEvent(new Event('change'))")
    editor.until("document.getElementById('parameter-node')")
    assert editor.run(f"{MIRROR}.getValue()").startswith("# What a node publishes")
    answer(editor)
    editor.until("document.querySelector('.errorResult').textContent.includes('node must be given')")
    editor.run("document.getElementById('parameter-node').value = '/nodes/rover'")
    answer(editor)
    editor.until(f"{LINKS}.includes('/topics/odom')")


def test_terms_of_the_robot_are_completed(editor: Any) -> None:
    for text, typed, hint in (
        ("SELECT * { ?x a ", "ros:Top", "ros:Topic"),
        ("SELECT * { ?x ", "ros:hasMess", "ros:hasMessageType"),
        ("SELECT * { ", "<topics/od", "<topics/odom>"),
        ("SELECT * { ?x ", "<https://w3id.org/rosld#", "<https://w3id.org/rosld#hasMessageType>"),
        ("", "PREFIX batteryS", "batteryState: <https://w3id.org/rosld/types/sensor_msgs/msg/BatteryState#>"),
    ):
        editor.run(f"{MIRROR}.setValue('')")
        write(editor, text)
        write(editor, typed)
        if not re.search("[:<]", typed):
            editor.run(f"{MIRROR}.getOption('extraKeys')['Ctrl-Space']({MIRROR})")
        editor.until(f"{HINTS}.includes({json.dumps(hint)})")
        if typed.startswith("ros:"):
            assert editor.run(f"{MIRROR}.getLine(0)") == "PREFIX ros: <https://w3id.org/rosld#>"


def test_a_link_carries_out_no_update(tab: Any, rover: httpx.Client) -> None:
    update = "INSERT DATA { GRAPH <data/note> { <data/note> rdfs:label 'note' } }"
    tab.open(f"{rover.base_url}sparql?query={update}#plot")
    tab.until(f"{MIRROR}.getValue().startsWith('INSERT DATA')")
    asked = tab.run("performance.getEntriesByType('resource').map((each) => new URL(each.name).pathname)")
    assert "/sparql" not in asked
    assert tab.run(f"{RUN}.textContent") == "Run"
    assert rover.get("/data/note").status_code == 404


def test_without_scripts_the_form_asks_the_same(rover: httpx.Client) -> None:
    page = rover.get("/sparql?query=ASK { ?x a ros:Topic }", headers=HTML)
    assert re.search(r'<section id="editor"[^>]* hidden>', page.text)
    assert '<form id="ask" class="query" method="get" action="/sparql"' in page.text
    assert '<p class="answer">Yes' in page.text


def test_only_the_page_of_queries_may_have_styles_of_its_own(rover: httpx.Client) -> None:
    policies = {path: rover.get(path, headers=HTML).headers["content-security-policy"] for path in ("/sparql", "/stop")}
    assert "style-src 'self' 'unsafe-inline'; script-src 'self'; connect-src 'self'" in policies["/sparql"]
    assert policies["/stop"] == policies["/sparql"].replace(" 'unsafe-inline'", "")


def test_no_page_without_the_editor_weighs_more_than_300_kilobytes(rover: httpx.Client) -> None:
    sizes: dict[str, int] = {}
    weights: dict[str, int] = {}
    for path in PAGES:
        page = rover.get(path, headers=HTML)
        assert page.status_code == 200, path
        files = re.findall(r'<(?:script src|link rel="stylesheet" href|link rel="icon"[^>]* href)="([^"]+)"', page.text)
        assert "yasgui" not in "".join(files)
        for each in files:
            if each not in sizes:
                sizes[each] = len(rover.get(each).content)
        weights[path] = len(page.content) + sum(sizes[each] for each in files)
    assert not {path: weight for path, weight in weights.items() if weight > MOST}
