"""Updates of a page in a real browser: a fake server sends one event after the other."""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Iterator, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from rosld.server.html.frame import ASSETS
from rosld.server.html.site import HEADERS

pytestmark = pytest.mark.slow

FILES = {
    "/style.css": (ASSETS["style.css"], "text/css"),
    "/live.js": (ASSETS["live.js"], "text/javascript"),
    "/icon.svg": (ASSETS["icon.svg"], "image/svg+xml"),
}
LIVE = "document.querySelector('.liveness').dataset.state === 'live'"
MARK = "document.querySelector('.liveness').innerText.trim()"


def page(content: str, live: bool = True) -> str:
    """Return a page with the usual frame."""
    data = ' data-live="3"' if live else ""
    script = '<script src="/live.js" defer></script>' if live else ""
    mark = '<p class="liveness" hidden><span class="dot"></span> <span role="status"></span> <button></button></p>'
    return (
        f'<!doctype html><html lang="en"><head><title>x</title><link rel="stylesheet" href="/style.css">{script}</head>'
        f'<body><header class="top"><div class="bar">{mark if live else ""}</div></header><main id="main"{data}>\n'
        f'<header class="title"><h1>Page</h1></header>\n{content}\n</main><footer{data}>foot</footer></body></html>'
    )


def form(action: str, *inputs: str, token: str = "t") -> str:
    """Return a form in a separate row."""
    return (
        f'<li data-key="{action}"><form method="post" action="{action}">'
        f'<input type="hidden" name="csrf" value="{token}">'
        f"{''.join(inputs)}<button>{action}</button></form></li>\n"
    )


def text(value: str, name: str = "data") -> str:
    """Return an input."""
    return f'<input type="text" name="{name}" value="{value}">'


class Site:
    """A server with one page, and event streams."""

    def __init__(self, first: str) -> None:
        self.page = first
        self.status = 200
        self.asked: list[Mapping[str, list[str]]] = []
        self._told: list[queue.Queue[bytes | None]] = []
        self._came = threading.Condition()
        self._port = 0
        self.start()

    def start(self) -> None:
        """Listen, on the same port as before."""
        self._server = ThreadingHTTPServer(("127.0.0.1", self._port), self._handler())
        self._server.daemon_threads = True
        self._port = self._server.server_port
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()

    def stop(self) -> None:
        """End all streams, and stop listening."""
        self._server.shutdown()
        self._server.server_close()
        for each in self._told:
            each.put(None)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._port}/"

    @property
    def readers(self) -> int:
        """Return the number of open streams."""
        return len(self._told)

    def until_readers(self, count: int) -> None:
        """Wait until this number of streams is open."""
        with self._came:
            assert self._came.wait_for(lambda: self.readers == count, 30), f"{self.readers} streams are open"

    def tell(self, data: str, name: str = "message") -> None:
        """Send one event to all readers."""
        lines = "".join(f"data: {line}\n" for line in data.split("\n"))
        for each in self._told:
            each.put(f"event: {name}\n{lines}\n".encode())

    def tell_page(self, content: str, live: bool = True) -> None:
        """Send the current page."""
        self.tell(page(content, live))

    def stream(self, handler: BaseHTTPRequestHandler) -> None:
        told: queue.Queue[bytes | None] = queue.Queue()
        with self._came:
            self._told.append(told)
            self._came.notify_all()
        try:
            handler.wfile.write(b":\n\n")
            while True:
                try:
                    chunk = told.get(timeout=0.05)
                except queue.Empty:
                    chunk = b":\n\n"
                if chunk is None:
                    break
                handler.wfile.write(chunk)
        except OSError:
            pass  # the reader has disconnected
        with self._came:
            self._told.remove(told)
            self._came.notify_all()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        site = self

        class Handler(BaseHTTPRequestHandler):
            def do_HEAD(self) -> None:
                self.send_response(site.status)
                self.end_headers()

            def do_GET(self) -> None:
                url = urlsplit(self.path)
                streams = "event-stream" in self.headers["Accept"]
                body, kind = FILES.get(url.path, (site.page.encode(), "text/html; charset=utf-8"))
                self.send_response(site.status if streams else 200)
                self.send_header("Content-Type", "text/event-stream" if streams else kind)
                for name, value in HEADERS.items():
                    self.send_header(name, value)
                self.end_headers()
                if not streams:
                    self.wfile.write(body)
                elif site.status == 200:
                    site.asked.append(parse_qs(url.query))
                    site.stream(self)

            def log_message(self, format: str, *args: object) -> None:
                pass

        return Handler


@pytest.fixture
def site() -> Iterator[Site]:
    found = Site(page(""))
    yield found
    found.stop()


def shown(tab: Any, site: Site, content: str) -> None:
    """Open a page with this content, and wait until it is live."""
    site.page = page(content)
    tab.open(site.url)
    tab.until(LIVE)
    site.until_readers(1)


def test_only_what_differs_is_touched(tab: Any, site: Site) -> None:
    shown(tab, site, '<p>one <bdi class="value">1</bdi> m</p>\n<p id="still">still</p>')
    tell = "`${each.type} ${each.target.nodeName} ${each.target.textContent}`"
    observer = f"new MutationObserver((found) => seen.push(...found.map((each) => {tell})))"
    everything = "{childList: true, characterData: true, subtree: true}"
    tab.run(f"void (window.seen = [], {observer}.observe(document.querySelector('main'), {everything}))")
    site.tell_page('<p>one <bdi class="value">2</bdi> m</p>\n<p id="still">still</p>')
    tab.until("document.querySelector('.value').textContent === '2'")
    assert tab.run("seen") == ["characterData #text 2"]
    assert tab.run("document.querySelector('.value').dataset.changed") == "now"
    tab.until("!document.querySelector('.value').hasAttribute('data-changed')")


def test_a_changed_value_does_not_stand_out_for_who_wants_less_motion(tab: Any, site: Site) -> None:
    tab.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-reduced-motion", "value": "reduce"}])
    shown(tab, site, '<bdi class="value">1</bdi>')
    colour = "getComputedStyle(document.querySelector('.value')).color"
    before = tab.run(colour)
    site.tell_page('<bdi class="value">2</bdi>')
    tab.until("document.querySelector('.value').dataset.changed === 'now'")
    assert tab.run(colour) == before


def test_rows_come_and_go_at_their_place_and_the_others_stay_the_same_nodes(tab: Any, site: Site) -> None:
    def rows(*names: str) -> str:
        return f"<ul>{''.join(f'<li data-key={name}>{name} x</li> ' for name in names)}</ul><p>end</p>"

    shown(tab, site, rows("b", "d", "e"))
    tab.run("void document.querySelectorAll('li').forEach((each) => each.mine = each.textContent)")
    site.tell_page(rows("a", "b", "c", "e", "f"))
    tab.until("document.querySelectorAll('li').length === 5")
    assert tab.run("[...document.querySelectorAll('li')].map((each) => each.textContent)") == [
        "a x", "b x", "c x", "e x", "f x",
    ]  # fmt: skip
    assert tab.run("[...document.querySelectorAll('li')].map((each) => each.mine ?? null)") == [
        None, "b x", None, "e x", None,
    ]  # fmt: skip


def test_what_is_typed_stays_with_its_focus_and_the_others_follow(tab: Any, site: Site) -> None:
    shown(tab, site, f"<ul>{form('/a', text('1'))}{form('/b', text('1'))}</ul><p>1</p>")
    tab.run("document.querySelector('[action=\"/a\"] [name=data]').select()")
    tab.type("climb")
    tab.run("document.activeElement.setSelectionRange(1, 3)")
    site.tell_page(f"<ul>{form('/a', text('2'), token='new')}{form('/b', text('2'))}</ul><p>2</p>")
    tab.until("document.querySelector('main p').textContent === '2'")
    assert tab.run("[...document.querySelectorAll('[name=data]')].map((each) => each.value)") == ["climb", "2"]
    assert tab.run("[document.activeElement.value, document.activeElement.selectionStart]") == ["climb", 1]
    assert tab.run("document.querySelector('[name=csrf]').value") == "new"


def test_choices_and_checks_follow_until_they_are_made(tab: Any, site: Site) -> None:
    def both(on: bool) -> str:
        options = f"<option{'' if on else ' selected'}>off</option><option{' selected' if on else ''}>on</option>"
        check = f'<input type="checkbox" name="c"{" checked" if on else ""}>'
        return f"<ul>{form('/a', f'<select name=s>{options}</select>', check)}</ul><p>{on}</p>"

    state = "[document.querySelector('[name=s]').value, document.querySelector('[name=c]').checked]"
    shown(tab, site, both(False))
    site.tell_page(both(True))
    tab.until("document.querySelector('main p').textContent === 'True'")
    assert tab.run(state) == ["on", True]
    tab.run("document.querySelector('[name=c]').click()")
    site.tell_page(both(False))
    tab.until("document.querySelector('main p').textContent === 'False'")
    assert tab.run(state) == ["on", False]


def test_a_form_in_use_that_is_not_on_offer_any_more_stays_and_says_so(tab: Any, site: Site) -> None:
    begin = "<section aria-labelledby=s><h2 id=s>S</h2>"
    shown(tab, site, f"{begin}<ul>{form('/a', text('1'))}{form('/b')}</ul></section>")
    tab.run("document.querySelector('[name=data]').select()")
    tab.type("mine")
    site.tell_page("<p>nothing</p>")
    tab.until("document.querySelector('form[data-withdrawn]')")
    assert tab.run("document.querySelector('[name=data]').value") == "mine"
    assert tab.run("document.activeElement.value") == "mine"
    assert "Not on offer" in tab.run(
        "getComputedStyle(document.querySelector('form[data-withdrawn]'), '::after').content"
    )
    site.tell_page(f"{begin}<ul>{form('/a', text('2'))}</ul></section>")
    tab.until("!document.querySelector('form[data-withdrawn]')")
    assert tab.run("[...document.querySelectorAll('[name=data]')].map((each) => each.value)") == ["mine"]


def test_a_button_never_becomes_another_and_a_new_one_waits_for_the_eye(tab: Any, site: Site) -> None:
    shown(tab, site, f"<ul>{form('/start')}</ul>")
    tab.run("void (window.start = document.querySelector('form button'), start.focus())")
    site.tell_page(f"<ul>{form('/stop')}</ul>")
    tab.until("document.querySelector('form button').textContent === '/stop'")
    assert tab.run("start.isConnected") is False
    assert tab.run("document.querySelector('li').inert") is True
    box = tab.run("document.querySelector('form button').getBoundingClientRect().toJSON()")
    tab.press(box["x"] + 5, box["y"] + 5)
    tab.until("!document.querySelector('li').inert")
    assert tab.run("location.pathname") == "/"
    once = "(event) => event.preventDefault(window.pressed = true)"
    tab.run(f"void document.querySelector('form').addEventListener('submit', {once})")
    tab.press(box["x"] + 5, box["y"] + 5)
    tab.until("pressed")


def test_what_is_unfolded_stays_unfolded_and_in_view(tab: Any, site: Site) -> None:
    def long(value: str) -> str:
        return f"<details><summary>more</summary><p class=v>{value}</p></details>" + "<p>line</p>" * 200

    shown(tab, site, long("1"))
    tab.run("void (document.querySelector('details').open = true, scrollTo(0, 900))")
    site.tell_page(long("2"))
    tab.until("document.querySelector('.v').textContent === '2'")
    assert tab.run("[document.querySelector('details').open, scrollY]") == [True, 900]


HOSTILE = (
    "<img src=x onerror=window.broken=1><script>window.broken=1</script><svg onload=window.broken=1></svg>"
    "<iframe srcdoc='<script>parent.broken=1</script>'></iframe><a href='javascript:window.broken=1'>x</a>"
)


def test_markup_in_what_comes_is_never_run(window: Any, site: Site) -> None:
    with window.tab() as tab:
        shown(tab, site, "<p>1</p>")
        site.tell_page(f"<div>{HOSTILE}<script src='/live.js'></script></div><p>2</p>")
        tab.until("document.querySelector('main > p').textContent === '2'")
        tab.run("document.querySelector('main a').click()")
        assert tab.run("new Promise((done) => setTimeout(() => done(typeof broken), 300))") == "undefined"
        assert tab.faults  # the policy forbade it, as the fault says


SHADOWS = (
    "firstChild", "childNodes", "nodeName", "nodeType", "attributes", "getAttribute", "setAttribute", "querySelector",
    "querySelectorAll", "parentNode", "parentElement", "nextSibling", "insertBefore", "removeChild", "matches", "id",
    "dataset", "children", "contains", "elements", "localName", "remove", "length", "method", "action", "__proto__",
)  # fmt: skip


def test_fields_of_any_name_do_no_harm(tab: Any, site: Site) -> None:
    def hostile(value: str) -> str:
        return f"<ul>{form('/a', *(text(value, name) for name in SHADOWS))}</ul><p>{value}</p>"

    shown(tab, site, hostile("1"))
    site.tell_page(hostile("2"))
    tab.until("document.querySelector('main p').textContent === '2'")
    assert tab.run("new Set([...document.querySelectorAll('[type=text]')].map((each) => each.value)).size") == 1
    assert tab.run("document.querySelector('[name=firstChild]').value") == "2"
    site.tell_page("<p>3</p>")
    tab.until("!document.querySelector('form')")


def test_a_resource_that_goes_is_told_and_told_again_when_it_is_back(tab: Any, site: Site) -> None:
    shown(tab, site, "<p>1</p>")
    words = "There is <b>no</b> topic /x."
    site.tell(json.dumps({"status": 404, "detail": words}), "gone")
    tab.until("document.querySelector('#live-notice')")
    said = tab.run("document.querySelector('#live-notice').textContent")
    assert said.startswith("This resource is gone.")
    assert words in said
    assert tab.run(MARK).startswith("Gone")
    assert tab.run("document.querySelector('main > p').textContent") == "1"
    site.tell_page("<p>2</p>")
    tab.until("document.querySelector('main > p').textContent === '2'")
    assert tab.run("document.querySelector('#live-notice')") is None
    assert tab.run(MARK).startswith("Live")


def test_what_is_gone_for_good_is_not_asked_for_again(tab: Any, site: Site) -> None:
    shown(tab, site, "<p>1</p>")
    site.tell(json.dumps({"status": 410}), "gone")
    site.until_readers(0)
    assert tab.run("document.querySelector('.liveness').checkVisibility()") is False
    assert tab.run("document.querySelector('#live-notice').checkVisibility()") is True


def test_a_page_that_becomes_final_is_shown_and_left_alone(tab: Any, site: Site) -> None:
    shown(tab, site, "<p>Running</p>")
    site.tell_page("<p>Succeeded</p>", live=False)
    tab.until("document.querySelector('main > p').textContent === 'Succeeded'")
    site.until_readers(0)
    assert tab.run("document.querySelector('.liveness').checkVisibility()") is False


def test_a_server_that_ends_is_told_and_found_again(tab: Any, site: Site) -> None:
    shown(tab, site, "<p>1</p>")
    site.stop()
    tab.until("document.querySelector('.liveness').dataset.state === 'lost'")
    assert tab.run(MARK).startswith("Not live")
    site.start()
    tab.until(LIVE)
    site.until_readers(1)
    site.tell_page("<p>2</p>")
    tab.until("document.querySelector('main > p').textContent === '2'")


def test_what_has_gone_while_nobody_looked_is_told(window: Any, site: Site) -> None:
    with window.tab() as tab:
        shown(tab, site, "<p>1</p>")
        site.status = 404
        site.stop()
        site.start()
        tab.until("document.querySelector('#live-notice')")
        assert tab.run(MARK).startswith("Gone")


def test_a_page_that_is_paused_or_that_nobody_sees_costs_nothing(tab: Any, site: Site) -> None:
    shown(tab, site, "<p>1</p>")
    tab.run("document.querySelector('.liveness button').click()")
    site.until_readers(0)
    assert tab.run(MARK).split() == ["Paused", "Go", "on"]
    tab.run("document.querySelector('.liveness button').click()")
    site.until_readers(1)
    tab.until(LIVE)
    see = "Object.defineProperty(document, 'hidden', {configurable: true, get: () => %s})"
    tab.run(f"void ({see % 'true'}, document.dispatchEvent(new Event('visibilitychange')))")
    site.until_readers(0)
    tab.run(f"void ({see % 'false'}, document.dispatchEvent(new Event('visibilitychange')))")
    site.until_readers(1)


def test_a_large_page_comes_less_often(tab: Any, site: Site) -> None:
    shown(tab, site, "<p>1</p>")
    shown_large = f"<p>{'x' * 1_000_000}</p>"
    site.page = page(shown_large)
    tab.open(f"{site.url}?format=ttl&page=2#here")
    tab.until(LIVE)
    small, large = site.asked
    assert small == {"format": ["html"], "rate": ["3.000"]}
    assert large["format"] == ["html"]
    assert large["page"] == ["2"]
    assert 0.2 < float(large["rate"][0]) < 0.4
