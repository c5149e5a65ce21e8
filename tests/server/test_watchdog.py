"""The watchdog: a pause of the loop is measured, named and reported at /status and in the log."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Any

import pytest
from pyoxigraph import Literal, NamedNode, RdfFormat, parse

import rosld
from rosld.server.runtime.watchdog import StackFrame, running_code
from tests.server.robots.made_up import MadeUp, served
from tests.waiting import until

ROS = "https://w3id.org/rosld#"
PAUSE_SECONDS = 0.3


def _busy(seconds: float) -> None:
    """Use the processor for this many seconds."""
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


class Sluggish(MadeUp):
    """A robot whose service blocks the loop, as nothing should."""

    def __init__(self) -> None:
        super().__init__()
        self.offer("/sluggish", "std_srvs/srv/Trigger", self._pause)

    def _pause(self, _: dict[str, Any]) -> dict[str, Any]:
        _busy(PAUSE_SECONDS)
        return {"success": True, "message": ""}


@pytest.mark.slow
def test_the_longest_pause_of_the_loop_is_told_at_status_with_the_code_that_ran(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "rosld.server.runtime.watchdog.LOG_INTERVAL_SECONDS", 0.0
    )  # others may be reported before on a busy machine
    with caplog.at_level(logging.WARNING, "rosld"), served(Sluggish()) as http:
        assert http.post("services/sluggish", json={}).status_code == 201
        told = http.get("status", headers={"Accept": "application/json"}).json()
        assert told["longestPause"] >= told["longestWork"] - 0.02
        assert PAUSE_SECONDS - 0.02 <= told["longestWork"] < PAUSE_SECONDS + 0.2
        assert told["recentPause"] >= PAUSE_SECONDS - 0.02
        assert told["longestWorkCode"].startswith("rosld.server.")
        paused = "the event loop was paused for"
        until(lambda: any(paused in each and told["longestWorkCode"] in each for each in caplog.messages), "a line")


def test_a_loop_that_waits_runs_no_code_though_rosld_started_it() -> None:
    here = str(Path(rosld.__file__).parent / "server" / "somewhere.py")
    call, loop, start = (
        StackFrame(here, "3", "answer"),
        StackFrame("/usr/lib/python3/asyncio/runners.py", "118", "run"),
        StackFrame(here, "1", "run"),
    )
    assert running_code([loop, start]) is None
    assert running_code([StackFrame("/usr/lib/python3/json/decoder.py", "7", "decode"), call, loop, start]) == (
        "rosld.server.somewhere.answer"
    )


def test_the_status_is_linked_from_the_entry_and_told_in_rdf_and_html() -> None:
    with served(MadeUp()) as http:
        url = str(http.base_url) + "status"
        entry = parse(http.get("", headers={"Accept": "application/n-triples"}).content, RdfFormat.N_TRIPLES)
        assert [each.object for each in entry if each.predicate == NamedNode(f"{ROS}hasServerStatus")] == [
            NamedNode(url)
        ]
        told = parse(http.get("status", headers={"Accept": "text/turtle"}).content, RdfFormat.TURTLE, base_iri=url)
        said = {each.predicate.value: each.object for each in told}
        assert isinstance(said[f"{ROS}longestPause"], Literal)
        assert f"{ROS}longestPauseEnd" in said
        assert "longest pause" in http.get("status", headers={"Accept": "text/html"}).text.lower()
        assert "/status" in http.get("openapi.json").json()["paths"]
