"""Resources with two hundred clients at a time: nothing torn, nothing stale after a write, the robot asked seldom."""

from __future__ import annotations

import asyncio
import json
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, NamedTuple

import httpx
import pytest
from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.made_up import Counted, MadeUp, served

CLIENTS = 200
AV = "https://w3id.org/rosld/aircraft#"
TURTLE, JSON = "text/turtle", "application/json"
AIRCRAFT, ENGINE, POWER, SPEED = (
    "/resources/aircraft/",
    "/resources/aircraft/engine/",
    "/resources/aircraft/power",
    "/resources/aircraft/engine/speed",
)


class Answer(NamedTuple):
    """An answer: its status, and its body."""

    status: int
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


class Client:
    """One connection, kept alive, with one request at a time."""

    def __init__(self, base: httpx.URL) -> None:
        self._host, self._port = base.host, base.port or 80

    async def __aenter__(self) -> Client:
        self._reader, self._writer = await asyncio.open_connection(self._host, self._port)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._writer.close()
        await self._writer.wait_closed()

    async def ask(
        self, method: str, path: str, body: bytes = b"", accept: str = JSON, media_type: str = JSON
    ) -> Answer:
        """The answer to a request."""
        head = (
            f"{method} {path} HTTP/1.1\r\nHost: {self._host}:{self._port}\r\nAccept: {accept}\r\n"
            f"Content-Type: {media_type}\r\nContent-Length: {len(body)}\r\n\r\n"
        )
        self._writer.write(head.encode() + body)
        status, *fields = (await self._reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
        length = next((int(one.partition(":")[2]) for one in fields if one.lower().startswith("content-length:")), 0)
        return Answer(int(status.split()[1]), await self._reader.readexactly(length))


def at_once(base: httpx.URL, *tasks: Callable[[Client], Awaitable[Any]]) -> list[Any]:
    """What these come to, each with a connection of its own, all begun together."""

    async def one(task: Callable[[Client], Awaitable[Any]]) -> Any:
        async with Client(base) as client:
            return await task(client)

    async def together() -> list[Any]:
        return await asyncio.gather(*map(one, tasks))

    return asyncio.run(together())


def said(body: bytes, url: str) -> dict[str, set[str]]:
    """What a complex resource says of itself in the aircraft's vocabulary."""
    found: dict[str, set[str]] = {}
    for quad in parse(body, format=RdfFormat.TURTLE, base_iri=url):
        if quad.subject == NamedNode(url) and quad.predicate.value.startswith(AV):
            found.setdefault(quad.predicate.value.removeprefix(AV), set()).add(quad.object.value)
    return found


class Pilot:
    """One who flies the aircraft, and lets everybody look after each write.

    `power` is what it is known to be, unless a write is under way.
    """

    def __init__(self, flights: int) -> None:
        self.flights = flights
        self.writes = 0
        self.over = False
        self._power: str | None = "off"
        self._looks = 0
        self._looked = asyncio.Event()

    async def __call__(self, client: Client) -> None:
        try:
            for _ in range(self.flights):
                await self.write(client, "POST", AIRCRAFT + "start", b"", "on")
                await self.write(client, "PUT", SPEED, b"1", "on")
                await self.write(client, "PUT", SPEED, b"0", "on")
                while (await self.write(client, "POST", AIRCRAFT + "stop", b"", "off")).status == 409:
                    pass  # it has not been told yet that it stands
        finally:
            self.over = True

    async def write(self, client: Client, method: str, path: str, body: bytes, power: str) -> Answer:
        self._power = None
        self.writes += 1
        answer = await client.ask(method, path, body)
        assert answer.status in (200, 204) or (answer.status == 409 and path.endswith("stop")), answer
        if answer.status == 200:
            assert answer.json == {"power": power}
        self._power = "on" if answer.status == 409 else power
        self._looks = 0
        self._looked.clear()
        await self._looked.wait()
        return answer

    def known(self) -> tuple[int, str] | None:
        """What is known to be so, and since which write; None while one is under way."""
        return None if self._power is None else (self.writes, self._power)

    def looked(self) -> None:
        """Somebody read what is known to be so."""
        self._looks += 1
        if self._looks == CLIENTS // 2:
            self._looked.set()


def test_no_reader_sees_a_torn_state_or_one_from_before_a_write() -> None:
    robot = Counted(adapter_for("aircraft", AdapterOptions()))
    seen: Counter[str] = Counter()
    with served(robot) as http:
        base, pilot = http.base_url, Pilot(flights=3)
        urls = {path: str(base.join(path)) for path in (AIRCRAFT, ENGINE)}

        def reader(number: int) -> Callable[[Client], Coroutine[Any, Any, None]]:
            path, accept = (AIRCRAFT, ENGINE)[number % 2], (TURTLE, JSON)[number // 2 % 2]

            async def read(client: Client) -> None:
                while not pilot.over:
                    before = pilot.known()
                    answer = await client.ask("GET", path, accept=accept)
                    power = judged(path, accept, answer)
                    if before is not None and before == pilot.known():
                        assert power == before[1], f"{power} although it was {before[1]} all the while"
                        pilot.looked()
                    seen[f"{path} {accept} {power}"] += 1

            return read

        def judged(path: str, accept: str, answer: Answer) -> str:
            """The power that an answer tells of; fails where it contradicts itself."""
            if path == ENGINE:
                if answer.status == 404:
                    return "off"
                assert answer.status == 200, answer
                engine = said(answer.body, urls[ENGINE]) if accept == TURTLE else answer.json
                assert engine.keys() - {"aircraft"} == {"speed", "direction"}
                assert None not in engine.values()
                return "on"
            assert answer.status == 200, answer
            if accept == JSON:
                assert answer.json in ({"power": "off"}, {"power": "on"})
                return str(answer.json["power"])
            found = said(answer.body, urls[AIRCRAFT])
            (power,) = found.pop("power")
            assert found.keys() in ({"start"} if power == "off" else {"engine"}, {"engine", "stop"}), (power, found)
            assert ("start" in found) == (power == "off")
            return power

        began = time.monotonic()
        at_once(base, pilot, *map(reader, range(CLIENTS)))
        periods = int(time.monotonic() - began) + 1
    assert len(seen) == 8, seen
    # A write looks before it moves anything, and who reads after it looks again.
    assert robot.calls["/aircraft/get_power"] <= periods + 2 * pilot.writes
    assert robot.calls["/aircraft/engine/get_direction"] <= periods + 2 * pilot.writes


def test_a_getter_is_asked_once_in_a_freshness_period_however_many_read() -> None:
    robot = Counted(adapter_for("aircraft", AdapterOptions()))
    with served(robot, freshness=0.5) as http:
        until = time.monotonic() + 1.6

        async def read(client: Client) -> int:
            times = 0
            while time.monotonic() < until:
                assert (await client.ask("GET", AIRCRAFT)).json == {"power": "off"}
                times += 1
            return times

        began = time.monotonic()
        times = at_once(http.base_url, *[read] * CLIENTS)
        elapsed = time.monotonic() - began
    assert sum(times) > CLIENTS
    assert 2 <= robot.calls["/aircraft/get_power"] <= elapsed / 0.5 + 1


def test_those_who_come_together_share_one_call() -> None:
    robot = MadeUp()
    robot.answer("/arm/get_grip", "made_up/srv/GetByte", value=3)
    robot.hold("/arm/get_grip")
    with served(robot) as http:

        async def read(client: Client, path: str) -> Answer:
            return await client.ask("GET", path)

        async def release(client: Client) -> None:
            assert (await client.ask("GET", "/resources/")).status == 200  # nobody else is held up
            await asyncio.to_thread(robot.until, lambda: robot.calls["/arm/get_grip"])
            robot.release("/arm/get_grip")

        reads = [lambda client: read(client, "/resources/arm/"), lambda client: read(client, "/resources/arm/grip")]
        *answers, _ = at_once(http.base_url, *reads * (CLIENTS // 2), release)
    assert {(one.status, one.body) for one in answers} == {(200, b'{"grip":3}'), (200, b"3")}
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

        async def early(client: Client) -> Answer:
            return await client.ask("GET", "/resources/arm/grip")

        async def write(client: Client) -> Answer:
            await asyncio.to_thread(robot.until, lambda: robot.calls["/arm/get_grip"])
            assert (await client.ask("PUT", "/resources/arm/grip", b"2")).status == 204
            after = await client.ask("GET", "/resources/arm/grip")
            robot.run(slow.set)
            return after

        before, after = at_once(http.base_url, early, write)
        assert before.json in (1, 2)
        assert after.json == 2
        assert http.get("/resources/arm/grip", headers={"Accept": JSON}).json() == 2
    assert robot.calls["/arm/get_grip"] == 2


@pytest.mark.parametrize("write", [("POST", AIRCRAFT + "start", b""), ("PUT", POWER, b'"on"')])
def test_of_many_who_start_it_at_once_one_does(write: tuple[str, str, bytes]) -> None:
    robot = Counted(adapter_for("aircraft", AdapterOptions()))
    with served(robot) as http:

        async def start(client: Client) -> Answer:
            return await client.ask(*write)

        answers = at_once(http.base_url, *[start] * 50)
    done = [one for one in answers if one.status in (200, 204)]
    assert len(done) == 1
    # An action is not on offer any more; the power may be written while it stands, and the aircraft itself refuses.
    assert {one.status for one in answers} - {200, 204} == ({409} if write[0] == "POST" else {422})
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
    mapping = """
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix sh: <http://www.w3.org/ns/shacl#> .
@prefix ex: <http://example.org/> . @prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
<#left> a map:ComplexResource ; map:path "/left/" ;
  map:action [ map:relation ex:take ; map:service "/left/take" ; map:availableWhen <#free> ] .
<#right> a map:ComplexResource ; map:path "/right/" ;
  map:action [ map:relation ex:take ; map:service "/right/take" ; map:availableWhen <#free> ] .
<#free> a sh:NodeShape ; map:about "/dock/holder" ; sh:property [ sh:path rdf:value ; sh:hasValue "" ] .
"""
    with served(robot) as http:
        assert http.put("/mappings/dock", content=mapping, headers={"Content-Type": TURTLE}).status_code == 201

        async def take_left(client: Client) -> Answer:
            return await client.ask("POST", "/resources/left/take")

        async def take_right(client: Client) -> Answer:
            return await client.ask("POST", "/resources/right/take")

        answers = at_once(http.base_url, *[take_left, take_right] * 25)
    assert sorted(one.status for one in answers) == [200] + [409] * 49
    assert robot.calls["/left/take"] + robot.calls["/right/take"] == 1


def test_what_hangs_holds_up_nobody_else() -> None:
    robot = MadeUp()
    robot.answer("/arm/get_grip", "made_up/srv/GetByte", value=3)
    robot.answer("/arm/get_label", "made_up/srv/GetLabel", success=True, label="red")
    robot.answer("/leg/get_grip", "made_up/srv/GetByte", value=4)
    robot.hold("/arm/get_grip")
    with served(robot, read_deadline=1.5) as http:

        async def held(client: Client) -> float:
            assert (await client.ask("GET", "/resources/arm/")).json == {"grip": None, "label": "red"}
            return time.monotonic()

        async def free(client: Client) -> float:
            await asyncio.to_thread(robot.until, lambda: robot.calls["/arm/get_grip"])
            assert (await client.ask("GET", "/resources/leg/")).json == {"grip": 4}
            assert (await client.ask("GET", "/resources/arm/label")).json == "red"
            return time.monotonic()

        *slow, fast = at_once(http.base_url, *[held] * (CLIENTS - 1), free)
        robot.release("/arm/get_grip")
    assert fast < min(slow)
    assert robot.calls["/arm/get_grip"] == 1


def test_changes_of_one_value_made_side_by_side_lose_nothing() -> None:
    robot = MadeUp()
    values = robot.variable("/arm/span", "Range", low=0, high=0)
    patch = "application/merge-patch+json"
    with served(robot, freshness=0) as http:

        def changing(key: str, path: str) -> Callable[[Client], Coroutine[Any, Any, None]]:
            async def change(client: Client) -> None:
                for number in range(1, 11):
                    body = {key: number} if path.endswith("span") else {"span": {key: number}}
                    answer = await client.ask("PATCH", path, json.dumps(body).encode(), media_type=patch)
                    assert answer.status == 204, answer
                    assert values[key] == number

            return change

        at_once(http.base_url, changing("low", "/resources/arm/span"), changing("high", "/resources/arm/"))
    assert values == {"low": 10, "high": 10}
