"""Pages on a phone: looked at with a real browser, where there is one."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeAlias
from urllib.parse import urlsplit

import pytest

from rosld.server.html import ASSETS, HEADERS

WIDTH = 360
MEASURE = """(() => {
// What in the header is less than four pixels from something else in it, or reaches beyond the page; links that are
// out of sight at the end of their line do neither.
function crowding(page, name) {
  page.querySelector(".brand bdi").textContent = name;
  const live = page.querySelector(".liveness");
  if (live) {
    live.hidden = false;
    live.querySelector("[role=status]").textContent = "Not live";
    live.querySelector("button").textContent = "Pause";
  }
  const end = page.querySelector(".bar nav").getBoundingClientRect().right;
  const words = [...page.querySelectorAll(".brand bdi, .bar nav li, .bar .stop button, .bar .liveness > *")];
  const boxes = words.filter((each) => each.checkVisibility() && each.textContent).map((each) => {
    const range = page.ownerDocument.createRange();
    range.selectNodeContents(each);
    const told = range.getBoundingClientRect(), box = each.matches("button") ? each.getBoundingClientRect() : told;
    const right = each.closest("nav") ? Math.min(box.right, end) : box.right;
    return {text: each.textContent, left: box.left, right, top: box.top, bottom: box.bottom};
  }).filter((each) => each.left < each.right);
  const near = (one, other) => one.left < other.right + 4 && other.left < one.right + 4 &&
    one.top < other.bottom && other.top < one.bottom;
  const high = page.querySelector("header.top").offsetHeight > 110 ? [`${name}: high`] : [];
  return boxes.filter((one) => one.right > page.clientWidth || boxes.some((other) => other !== one && near(one, other)))
    .map((one) => `${name}: ${one.text}`).concat(high);
}
  const page = document.documentElement;
  const styled = getComputedStyle(page.querySelector("main")).maxWidth !== "none";
  const small = [...page.querySelectorAll("button, input:not([type=hidden]), select")].filter(
    (each) => each.checkVisibility() && each.getBoundingClientRect().height < 18).length;
  const crowded = ["aircraft", "a-robot-with-a-long-name.example:11311"].flatMap((name) => crowding(page, name));
  return {width: page.scrollWidth, styled, small, crowded};
})()"""


Measured: TypeAlias = Mapping[str, Mapping[str, object]]


@contextmanager
def serving(pages: Mapping[str, bytes]) -> Iterator[str]:
    """The pages by name, with the policy that all pages have, on a loopback port; yields the URL."""
    files = {"style.css": (ASSETS["style.css"], "text/css"), "icon.svg": (ASSETS["icon.svg"], "image/svg+xml")}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            name = urlsplit(self.path).path.strip("/")
            body, kind = files.get(name) or (pages.get(name), "text/html; charset=utf-8")
            self.send_response(200 if body else 404)
            self.send_header("Content-Type", kind)
            for key, value in HEADERS.items():
                self.send_header(key, value)
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.fixture(scope="module")
def measured(window: Any, pages: Mapping[str, bytes]) -> Measured:
    """How wide each page gets on a phone, whether its stylesheet passed its policy, what is too small or too close."""
    with serving(pages) as url, window.tab() as tab:
        tab.send("Emulation.setDeviceMetricsOverride", width=WIDTH, height=700, deviceScaleFactor=1, mobile=True)

        def measure(name: str) -> Mapping[str, object]:
            tab.open(url + name)
            found: Mapping[str, object] = tab.run(MEASURE)
            return found

        return {name: measure(name) for name in pages}


def test_no_page_is_wider_than_a_phone(measured: Measured, pages: Mapping[str, bytes]) -> None:
    assert measured.keys() == pages.keys()
    assert {name: each["width"] for name, each in measured.items()} == dict.fromkeys(pages, WIDTH)


def test_the_stylesheet_passes_the_policy(measured: Measured) -> None:
    assert all(each["styled"] for each in measured.values())


def test_nothing_in_the_header_touches_anything_else_or_reaches_beyond_the_page(measured: Measured) -> None:
    assert {name: each["crowded"] for name, each in measured.items() if each["crowded"]} == {}


def test_nothing_to_press_is_too_small_for_a_finger(measured: Measured) -> None:
    assert not [name for name, each in measured.items() if each["small"]]
