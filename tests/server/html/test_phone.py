"""Pages on a phone, in a real browser if there is one."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

import pytest

from rosld.server.html.frame import ASSETS
from rosld.server.html.site import HEADERS

pytestmark = pytest.mark.slow

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


@contextmanager
def serving(pages: Mapping[str, bytes]) -> Iterator[str]:
    """Serve the pages by name, with the usual policy, on a loopback port; yield the URL."""
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


def test_every_page_fits_a_phone_and_a_finger(window: Any, pages: Mapping[str, bytes]) -> None:
    wrong = {}
    with serving(pages) as url, window.tab() as tab:
        tab.send("Emulation.setDeviceMetricsOverride", width=WIDTH, height=700, deviceScaleFactor=1, mobile=True)
        for name in pages:
            tab.open(url + name)
            found = tab.run(MEASURE)
            if found != {"width": WIDTH, "styled": True, "small": 0, "crowded": []}:
                wrong[name] = found
    assert not wrong, wrong
