"""Resources read by many clients at a time: nothing torn, nothing stale after a write, few calls of the robot."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.asking import mapped
from tests.server.robots.made_up import Counted, MadeUp, served

pytestmark = pytest.mark.slow

CLIENTS = 24
AV = "https://w3id.org/rosld/aircraft#"
TURTLE, JSON = "text/turtle", "application/json"
AIRCRAFT, ENGINE, POWER, SPEED = (
    "/resources/aircraft/",
    "/resources/aircraft/engine/",
    "/resources/aircraft/power",
    "/resources/aircraft/engine/speed",
)


async def ask(http: httpx.AsyncClient, method: str, path: str, body: bytes = b"", accept: str = JSON) -> httpx.Response:
    return await http.request(method, path, content=body, headers={"Accept": accept, "Content-Type": JSON})


def at_once(base: httpx.URL, *tasks: Callable[[httpx.AsyncClient], Awaitable[Any]]) -> list[Any]:
    """Run tasks that begin together, with as many connections; return their results."""

    async def together() -> list[Any]:
        limits = httpx.Limits(max_connections=None, max_keepalive_connections=None)
        async with httpx.AsyncClient(base_url=base, limits=limits, timeout=60) as http:
            return await asyncio.gather(*(task(http) for task in tasks))

    return asyncio.run(together())


def said(body: bytes, url: str) -> dict[str, set[str]]:
    """Return the statements of a complex resource about itself in the aircraft's vocabulary."""
    found: dict[str, set[str]] = {}
    for quad in parse(body, format=RdfFormat.TURTLE, base_iri=url):
        if quad.subject == NamedNode(url) and quad.predicate.value.startswith(AV):
            found.setdefault(quad.predicate.value.removeprefix(AV), set()).add(quad.object.value)
    return found


FLIGHT = (
    ("POST", AIRCRAFT + "start", b"", "on"),
    ("PUT", SPEED, b"1", "on"),
    ("PUT", SPEED, b"0", "on"),
    ("POST", AIRCRAFT + "stop", b"", "off"),
)
"""Writes, and the power after each."""


class Pilot:
    """A client that flies the aircraft, and waits after each write until half of the clients have read its result.

    `state` is the number of writes and the power, or None during a write.
    """

    def __init__(self) -> None:
        self.writes = 0
        self.state: tuple[int, str] | None = (0, "off")
        self.over = False
        self._reads = 0
        self._read = asyncio.Event()

    async def fly(self, client: httpx.AsyncClient) -> None:
        try:
            for method, path, body, power in FLIGHT * 2:
                self.state = None
                self.writes += 1
                while (answer := await ask(client, method, path, body)).status_code == 409:
                    assert path.endswith("stop")  # the server does not know yet that the aircraft is at rest
                assert answer.status_code in (200, 204), answer
                self.state, self._reads = (self.writes, power), 0
                self._read.clear()
                await self._read.wait()
        finally:
            self.over = True

    def count_read(self) -> None:
        self._reads += 1
        if self._reads == CLIENTS // 2:
            self._read.set()


def judged(path: str, accept: str, answer: httpx.Response) -> str:
    """Return the power that an answer implies; fail if it contradicts itself."""
    if path == ENGINE and answer.status_code == 404:
        return "off"
    assert answer.status_code == 200, answer
    found = said(answer.content, str(answer.url)) if accept == TURTLE else answer.json()
    if path == ENGINE:
        assert found.keys() - {"aircraft"} == {"speed", "direction"}
        assert None not in found.values()
        return "on"
    if accept == JSON:
        return str(found["power"])
    (power,) = found.pop("power")
    assert found.keys() in ({"start"} if power == "off" else {"engine"}, {"engine", "stop"}), (power, found)
    assert ("start" in found) == (power == "off")
    return power


def test_no_reader_sees_a_torn_state_or_one_from_before_a_write() -> None:
    robot = Counted(adapter_for("aircraft", AdapterOptions()))
    seen: Counter[str] = Counter()
    pilot = Pilot()

    def reader(number: int) -> Callable[[httpx.AsyncClient], Coroutine[Any, Any, None]]:
        path, accept = (AIRCRAFT, ENGINE)[number % 2], (TURTLE, JSON)[number // 2 % 2]

        async def read(client: httpx.AsyncClient) -> None:
            while not pilot.over:
                before = pilot.state
                power = judged(path, accept, await ask(client, "GET", path, accept=accept))
                if before is not None and before == pilot.state:
                    assert power == before[1], f"{power} although it was {before[1]} all the while"
                    pilot.count_read()
                seen[f"{path} {accept} {power}"] += 1

        return read

    began = time.monotonic()
    with served(robot) as http:
        at_once(http.base_url, pilot.fly, *map(reader, range(CLIENTS)))
    periods = int(time.monotonic() - began) + 1
    assert len(seen) == 8, seen
    # A write reads the state first, and later readers read it again.
    for getter in ("/aircraft/get_power", "/aircraft/engine/get_direction"):
        assert robot.calls[getter] <= periods + 2 * pilot.writes


def test_reads_at_one_time_share_one_call_and_its_answer_until_it_is_stale() -> None:
    robot = MadeUp()
    robot.answer("/arm/get_grip", "made_up/srv/GetByte", value=3)
    robot.hold("/arm/get_grip")
    with served(robot, freshness=60) as http:

        async def read(client: httpx.AsyncClient, path: str) -> httpx.Response:
            return await ask(client, "GET", path)

        async def release(client: httpx.AsyncClient) -> None:
            assert (await ask(client, "GET", "/resources/")).status_code == 200  # no other request is delayed
            await asyncio.to_thread(robot.until, lambda: robot.calls["/arm/get_grip"])
            robot.release("/arm/get_grip")

        reads = [lambda client: read(client, "/resources/arm/"), lambda client: read(client, "/resources/arm/grip")]
        *answers, _ = at_once(http.base_url, *reads * (CLIENTS // 2), release)
    assert {(one.status_code, one.content) for one in answers} == {(200, b'{"grip":3}'), (200, b"3")}
    assert robot.calls["/arm/get_grip"] == 1


def test_an_answer_from_before_a_write_is_not_shown_after_it() -> None:
    robot, value, slow = MadeUp(), {"grip": 1}, asyncio.Event()

    async def get(_: object) -> dict[str, int]:
        found = value["grip"]
        if robot.calls["/arm/get_grip"] == 1:
            await slow.wait()
        return {"value": found}

    robot.offer("/arm/get_grip", "made_up/srv/GetByte", get)
    robot.offer(
        "/arm/set_grip", "made_up/srv/SetByte", lambda one: value.update(grip=one["value"]) or {"success": True}
    )
    with served(robot) as http:

        async def early(client: httpx.AsyncClient) -> httpx.Response:
            return await ask(client, "GET", "/resources/arm/grip")

        async def write(client: httpx.AsyncClient) -> httpx.Response:
            await asyncio.to_thread(robot.until, lambda: robot.calls["/arm/get_grip"])
            assert (await ask(client, "PUT", "/resources/arm/grip", b"2")).status_code == 204
            after = await ask(client, "GET", "/resources/arm/grip")
            robot.run(slow.set)
            return after

        before, after = at_once(http.base_url, early, write)
        assert before.json() in (1, 2)
        assert after.json() == 2
        assert http.get("/resources/arm/grip", headers={"Accept": JSON}).json() == 2
    assert robot.calls["/arm/get_grip"] == 2


def test_exactly_one_of_many_who_start_the_aircraft_at_once_does() -> None:
    # An action is not on offer any more; the power may be written while it stands, and the aircraft itself refuses.
    for write, done, refused in (("POST", AIRCRAFT + "start", b""), 200, 409), (("PUT", POWER, b'"on"'), 204, 422):
        robot = Counted(adapter_for("aircraft", AdapterOptions()))
        with served(robot) as http:

            async def start(client: httpx.AsyncClient, write: tuple[str, str, bytes] = write) -> httpx.Response:
                return await ask(client, *write)

            answers = at_once(http.base_url, *[start] * 30)
        assert sorted(one.status_code for one in answers) == sorted([done] + [refused] * 29)
        assert robot.calls["/aircraft/start"] == (1 if write[0] == "POST" else 0)


def test_actions_that_exclude_each_other_are_never_both_carried_out() -> None:
    robot, taken = MadeUp(), {"by": ""}
    robot.offer("/dock/get_holder", "made_up/srv/GetWords", lambda _: {"words": taken["by"]})

    def take(who: str) -> Callable[[object], Awaitable[dict[str, Any]]]:
        async def act(_: object) -> dict[str, Any]:
            assert taken["by"] == "", f"{who} takes what {taken['by']} holds"
            await asyncio.sleep(0)
            taken["by"] = who
            return {"success": True}

        return act

    robot.offer("/left/take", "std_srvs/srv/Trigger", take("left"))
    robot.offer("/right/take", "std_srvs/srv/Trigger", take("right"))
    mapping = "".join(
        f"""<#{who}> a map:ComplexResource ; map:path "/{who}/" ;
            map:action [ map:relation ex:take ; map:service "/{who}/take" ; map:availableWhen <#free> ] ."""
        for who in ("left", "right")
    )
    free = 'a sh:NodeShape ; map:about "/dock/holder" ; sh:property [ sh:path rdf:value ; sh:hasValue "" ]'
    with served(robot) as http:
        mapped(http, f"{mapping} <#free> {free} .")

        def taking(who: str) -> Callable[[httpx.AsyncClient], Awaitable[httpx.Response]]:
            return lambda client: ask(client, "POST", f"/resources/{who}/take")

        answers = at_once(http.base_url, *[taking("left"), taking("right")] * 25)
    assert sorted(one.status_code for one in answers) == [200] + [409] * 49
    assert robot.calls["/left/take"] + robot.calls["/right/take"] == 1
