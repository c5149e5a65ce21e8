"""A real browser controlled by the DevTools protocol over a pipe: only the standard library, without a port."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

SECONDS = 30.0
_QUIET = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-sync"
_QUIET += " --use-angle=swiftshader --enable-unsafe-swiftshader"  # WebGL without a graphics card
_UNTIL = """new Promise((resolve, reject) => {
  const end = performance.now() + %d;
  const look = () => {
    let found;
    try { found = (() => (%s))(); } catch (error) { found = false; }
    if (found) resolve(found);
    else if (performance.now() > end) reject(new Error("it never came to be"));
    else setTimeout(look, 15);
  };
  look();
})"""


class Tab:
    """One page of the browser. `faults` are uncaught exceptions and policy violations."""

    def __init__(self, window: Window, target: str, session: str) -> None:
        self._window = window
        self._target = target
        self._session = session
        self._loaded = threading.Event()
        self.faults: list[str] = []

    def send(self, method: str, **params: object) -> Any:
        """Send one command of the protocol; return its result."""
        return self._window.send(method, self._session, **params)

    def open(self, url: str) -> None:
        """Load a page."""
        self._loaded.clear()
        self.send("Page.navigate", url=url)
        assert self._loaded.wait(SECONDS), f"{url} was not loaded"

    def leave(self, expression: str) -> None:
        """Run a function that leads to another page, and wait until that is loaded."""
        self._loaded.clear()
        self.run(f"void ({expression})")
        assert self._loaded.wait(SECONDS), f"{expression} led nowhere"

    def run(self, expression: str) -> Any:
        """Return the value of a JavaScript expression in the page, or the result of a promise."""
        found = self.send("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, (expression, found["exceptionDetails"])
        return found["result"].get("value")

    def until(self, condition: str, seconds: float = SECONDS) -> Any:
        """Wait until a JavaScript expression is true in the page; return its value."""
        return self.run(_UNTIL % (seconds * 1000, condition))

    def type(self, text: str) -> None:
        """Type text into the focused element."""
        self.send("Input.insertText", text=text)

    def press(self, x: float, y: float) -> None:
        """Click at a position of the window."""
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def follow(self, x: float, y: float) -> None:
        """Click an element that leads to another page, and wait until that is loaded."""
        self._loaded.clear()
        self.press(x, y)
        assert self._loaded.wait(SECONDS), f"what is at {x}, {y} led nowhere"

    def crash(self) -> None:
        """Crash the process that shows the page; the page does not respond afterwards."""
        self._window.post("Page.crash", self._session)

    def take(self, method: str, params: dict[str, Any]) -> None:
        """Process an event of the protocol."""
        if method == "Page.loadEventFired":
            self._loaded.set()
        elif method == "Runtime.exceptionThrown":
            self.faults.append(json.dumps(params["exceptionDetails"]))
        elif method == "Log.entryAdded" and params["entry"]["source"] in ("security", "violation", "other"):
            self.faults.append(params["entry"]["text"])


class Window:
    """The running browser."""

    def __init__(self, write: int, read: int) -> None:
        self._write = write
        self._replies: dict[int, Future[Any]] = {}
        self._tabs: dict[str, Tab] = {}
        self._count = 0
        self._reader = threading.Thread(target=self._listen, args=(read,), daemon=True)
        self._reader.start()

    def send(self, method: str, session: str | None = None, **params: object) -> Any:
        """Send one command; return its result."""
        return self.post(method, session, **params).result(SECONDS * 2)

    def post(self, method: str, session: str | None = None, **params: object) -> Future[Any]:
        """Send one command; return its result asynchronously."""
        self._count += 1
        number, reply = self._count, Future[Any]()
        self._replies[number] = reply
        message = {"id": number, "method": method, "params": params} | ({"sessionId": session} if session else {})
        os.write(self._write, json.dumps(message).encode() + b"\0")
        return reply

    def _listen(self, read: int) -> None:
        waiting = b""
        while chunk := os.read(read, 1 << 16):
            *whole, waiting = (waiting + chunk).split(b"\0")
            for each in whole:
                self._take(json.loads(each))

    def _take(self, message: dict[str, Any]) -> None:
        if "id" in message:
            reply = self._replies.pop(message["id"])
            if "error" in message:
                reply.set_exception(RuntimeError(str(message["error"])))
            else:
                reply.set_result(message["result"])
        elif message.get("sessionId") in self._tabs:
            self._tabs[message["sessionId"]].take(message["method"], message["params"])

    @contextmanager
    def tab(self) -> Iterator[Tab]:
        """Open a new tab, and close it at the end."""
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        tab = self._tabs[session] = Tab(self, target, session)
        for domain in ("Page", "Runtime", "Log"):
            tab.send(f"{domain}.enable")
        try:
            yield tab
        finally:
            self.send("Target.closeTarget", targetId=target)
            del self._tabs[session]


def _program() -> str:
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    assert found is not None, "chromium is not installed; tests/debian-browser.txt lists what is needed"
    return found


def _as_3_and_4(read: int, write: int) -> Callable[[], None]:
    """Move the pipes to the descriptors where the browser expects them."""

    def place() -> None:
        one, other = os.dup(read), os.dup(write)
        os.dup2(one, 3)
        os.dup2(other, 4)

    return place


@contextmanager
def browser(profile: Path) -> Iterator[Window]:
    """Run a headless browser, in a separate profile; end it by its own handle."""
    command_read, command_write = os.pipe()
    reply_read, reply_write = os.pipe()
    arguments = [*_QUIET.split(), "--hide-scrollbars", f"--user-data-dir={profile}", "--remote-debugging-pipe"]
    with subprocess.Popen(
        [_program(), *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        close_fds=False,
        preexec_fn=_as_3_and_4(command_read, reply_write),  # no thread runs yet
    ) as process:
        os.close(command_read)
        os.close(reply_write)
        try:
            yield Window(command_write, reply_read)
        finally:
            process.terminate()
            process.wait(60)
            os.close(command_write)
