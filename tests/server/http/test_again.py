"""The same request again: the same answer with the date of now, as long as it stands; and the connection goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.server.commands import listening
from rosld.server.http import again
from rosld.server.http.again import Again
from rosld.server.http.connection import Bounds

_V = TypeVar("_V")
DATE = b"Sun, 22 Nov 2026 10:00:00 GMT"
LATER = b"Sun, 22 Nov 2026 10:00:01 GMT"
ANSWER = b"HTTP/1.1 200 OK\r\ndate: " + DATE + b"\r\ncontent-length: 1\r\n\r\nx"
GET = b"GET /a HTTP/1.1\r\nHost: a\r\n\r\n"


def anybody(address: str | None) -> bool:
    return True


# What is kept


def test_an_answer_that_stands_is_given_again_with_the_date_of_now() -> None:
    kept = Again(anybody)
    assert kept.answer(GET, None, DATE) is None
    kept.keep(GET, ANSWER, lambda: True)
    assert kept.answer(GET, None, DATE) == ANSWER
    assert kept.answer(GET, None, LATER) == ANSWER.replace(DATE, LATER)
    assert kept.answer(GET.replace(b"/a", b"/b"), None, DATE) is None


def test_what_came_is_remembered_a_while() -> None:
    kept = Again(anybody)
    assert [kept.has_come(GET) for _ in range(3)] == [False, True, True]
    for number in range(again._REMEMBERED):
        assert not kept.has_come(GET + b"%d" % number)
    assert kept.has_come(GET)
    for number in range(2 * again._REMEMBERED):
        assert not kept.has_come(GET + b"x%d" % number)
    assert not kept.has_come(GET)


def test_an_answer_that_no_longer_stands_is_forgotten() -> None:
    kept, stands = Again(anybody), [True]
    kept.keep(GET, ANSWER, lambda: stands[0])
    stands[0] = False
    assert kept.answer(GET, None, DATE) is None
    stands[0] = True
    assert kept.answer(GET, None, DATE) is None


def test_who_is_at_the_limit_is_given_nothing_and_others_are() -> None:
    kept = Again(lambda address: address != "10.0.0.1")
    kept.keep(GET, ANSWER, lambda: True)
    assert kept.answer(GET, "10.0.0.1", DATE) is None
    assert kept.answer(GET, "10.0.0.2", DATE) == ANSWER


def test_what_is_long_or_has_no_date_is_not_kept() -> None:
    kept = Again(anybody)
    for answer in (ANSWER + bytes(again.LONGEST_ANSWER), ANSWER.replace(b"date", b"when")):
        kept.keep(GET, answer, lambda: True)
        assert kept.answer(GET, None, DATE) is None


def test_no_more_is_kept_than_may_be_and_the_least_used_goes_first() -> None:
    kept = Again(anybody, most=3 * (len(GET) + len(ANSWER)))
    requests = [GET.replace(b"/a", b"/%d" % number) for number in range(4)]
    for request in requests[:3]:
        kept.keep(request, ANSWER, lambda: True)
    assert kept.answer(requests[0], None, DATE)
    kept.keep(requests[0], ANSWER, lambda: True)  # once more is no more
    kept.keep(requests[3], ANSWER, lambda: True)
    assert [kept.answer(request, None, DATE) is not None for request in requests] == [True, False, True, True]


# On the wire


class Counting:
    """An app that answers with how often it was asked, and says that this stands until `changed`."""

    def __init__(self) -> None:
        self.asked = 0
        self.edition = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.asked += 1
        body = await Request(scope, receive).body()
        edition = self.edition
        if scope["path"] != "/never" and again.SCOPE in scope:
            scope[again.SCOPE] = lambda: self.edition == edition
        await Response(b"%d %s" % (self.asked, scope["path"].encode() + body))(scope, receive, send)


class Talk:
    """One connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

    def send(self, data: bytes) -> None:
        self._writer.write(data)

    async def read(self) -> bytes:
        """The body of the next answer."""
        head = await self._reader.readuntil(b"\r\n\r\n")
        [length] = [line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")]
        return await self._reader.readexactly(int(length.split(b":")[1]))

    async def ask(self, data: bytes) -> bytes:
        self.send(data)
        return await self.read()

    async def ended(self) -> bool:
        return await self._reader.read() == b""


def talking(app: Counting, work: Callable[[Talk], Awaitable[_V]], bounds: Bounds | None = None) -> _V:
    """What `work` makes of a connection to a server that runs this app."""

    async def main() -> _V:
        listens = asyncio.Event()
        server = listening.Server(app, listens.set, bounds, again=Again(anybody))
        sock = listening.bind("127.0.0.1", 0)
        serving = asyncio.create_task(server.serve(sockets=[sock]))
        await asyncio.wait_for(listens.wait(), 60)
        reader, writer = await asyncio.open_connection("127.0.0.1", sock.getsockname()[1])
        try:
            return await asyncio.wait_for(work(Talk(reader, writer)), 60)
        finally:
            writer.close()
            server.should_exit = True
            await serving

    return asyncio.run(main())


def answers(app: Counting, *requests: bytes, bounds: Bounds | None = None) -> Sequence[bytes]:
    """The bodies of the answers to requests on one connection, one after the other."""

    async def work(talk: Talk) -> list[bytes]:
        return [await talk.ask(request) for request in requests]

    return talking(app, work, bounds)


def post(path: bytes, body: bytes, *headers: bytes) -> bytes:
    lines = b"".join(header + b"\r\n" for header in headers)
    return b"POST %s HTTP/1.1\r\nHost: a\r\n%sContent-Length: %d\r\n\r\n%s" % (path, lines, len(body), body)


def test_the_same_request_is_answered_without_asking_anybody_from_the_third_on() -> None:
    app = Counting()
    assert answers(app, GET, GET, GET, GET) == [b"1 /a", b"2 /a", b"2 /a", b"2 /a"]
    assert app.asked == 2


def test_the_body_is_part_of_the_request() -> None:
    app = Counting()
    x, y = post(b"/a", b"x"), post(b"/a", b"y")
    found = answers(app, x, x, x, y, y, y, x)
    assert found == [b"1 /ax", b"2 /ax", b"2 /ax", b"3 /ay", b"4 /ay", b"4 /ay", b"2 /ax"]


def test_every_header_is_part_of_the_request() -> None:
    other = GET.replace(b"Host: a", b"Host: a\r\nAccept: text/csv")
    found = answers(Counting(), GET, other, GET, other, GET, other)
    assert found == [b"1 /a", b"2 /a", b"3 /a", b"4 /a", b"3 /a", b"4 /a"]


def test_what_may_change_at_any_time_is_asked_for_each_time() -> None:
    request = GET.replace(b"/a", b"/never")
    assert answers(Counting(), request, request, request) == [b"1 /never", b"2 /never", b"3 /never"]


def test_what_has_changed_is_asked_for_anew() -> None:
    app = Counting()

    async def work(talk: Talk) -> list[bytes]:
        found = [await talk.ask(GET) for _ in range(3)]
        app.edition += 1
        return [*found, await talk.ask(GET), await talk.ask(GET)]

    assert talking(app, work) == [b"1 /a", b"2 /a", b"2 /a", b"3 /a", b"3 /a"]


def test_requests_that_come_together_are_answered_in_their_order_and_each_is_asked_for() -> None:
    app, other = Counting(), GET.replace(b"/a", b"/b")

    async def work(talk: Talk) -> list[bytes]:
        assert [await talk.ask(GET) for _ in range(3)] == [b"1 /a", b"2 /a", b"2 /a"]
        found = []
        for _ in range(3):
            talk.send(other + GET + other)
            found += [await talk.read() for _ in range(3)]
        return [*found, await talk.ask(GET)]

    alone = [b"%d /%s" % (number, b"bab"[(number - 3) % 3 :][:1]) for number in range(3, 12)]
    assert talking(app, work) == [*alone, b"2 /a"]


@pytest.mark.parametrize("cut", [1, 3, 20, len(GET) - 1])
def test_a_request_that_comes_in_pieces_is_read_as_any_other(cut: int) -> None:
    app = Counting()

    async def work(talk: Talk) -> list[bytes]:
        found = [await talk.ask(GET) for _ in range(3)]
        for _ in range(2):
            talk.send(GET[:cut])
            await asyncio.sleep(0.05)  # a piece by itself
            found.append(await talk.ask(GET[cut:]))
        return [*found, await talk.ask(GET)]

    assert talking(app, work) == [b"1 /a", b"2 /a", b"2 /a", b"3 /a", b"4 /a", b"2 /a"]


def test_the_end_of_a_body_that_looks_like_a_request_is_no_request() -> None:
    app = Counting()

    async def work(talk: Talk) -> list[bytes]:
        assert [await talk.ask(GET) for _ in range(3)] == [b"1 /a", b"2 /a", b"2 /a"]
        talk.send(b"POST /b HTTP/1.1\r\nHost: a\r\nContent-Length: %d\r\n\r\n" % len(GET))
        await asyncio.sleep(0.05)  # the head by itself
        return [await talk.ask(GET), await talk.ask(GET)]

    assert talking(app, work) == [b"3 /b" + GET, b"2 /a"]


def test_who_wants_the_connection_to_end_has_it_ended_each_time() -> None:
    app, request = Counting(), GET.replace(b"Host: a", b"Host: a\r\nConnection: close")

    async def work(talk: Talk) -> bool:
        assert await talk.ask(request) == b"%d /a" % app.asked
        return await talk.ended()

    assert [talking(app, work) for _ in range(3)] == [True] * 3


def test_who_waits_for_leave_to_send_is_given_it_each_time() -> None:
    app = Counting()

    async def work(talk: Talk) -> list[bytes]:
        head = b"POST /a HTTP/1.1\r\nHost: a\r\nExpect: 100-continue\r\nContent-Length: 1\r\n\r\n"
        found = []
        for _ in range(3):
            talk.send(head)
            assert b" 100 " in await talk._reader.readuntil(b"\r\n\r\n")
            found.append(await talk.ask(b"x"))
        return found

    assert talking(app, work) == [b"1 /ax", b"2 /ax", b"3 /ax"]


def test_who_waits_for_leave_and_sends_all_the_same_is_answered_whole_each_time() -> None:
    request = post(b"/a", b"x", b"Expect: 100-continue")

    async def work(talk: Talk) -> list[bytes]:
        found = []
        for _ in range(4):
            talk.send(request)
            assert b" 100 " in await talk._reader.readuntil(b"\r\n\r\n")
            found.append(await talk.read())
        return found

    assert talking(Counting(), work) == [b"1 /ax", b"2 /ax", b"3 /ax", b"4 /ax"]


def test_a_connection_that_was_answered_again_may_be_silent_as_long_as_any_other() -> None:
    app = Counting()

    async def work(talk: Talk) -> list[bytes]:
        found = [await talk.ask(GET) for _ in range(3)]
        await asyncio.sleep(0.3)  # longer than a head may take
        return [*found, await talk.ask(GET)]

    assert talking(app, work, Bounds(head_seconds=0.1)) == [b"1 /a", b"2 /a", b"2 /a", b"2 /a"]


def test_a_first_request_that_is_known_is_no_slow_one() -> None:
    app = Counting()

    async def main() -> bytes:
        listens = asyncio.Event()
        server = listening.Server(app, listens.set, Bounds(head_seconds=0.1), again=Again(anybody))
        sock = listening.bind("127.0.0.1", 0)
        serving = asyncio.create_task(server.serve(sockets=[sock]))
        await asyncio.wait_for(listens.wait(), 60)
        try:
            for _ in range(3):
                reader, writer = await asyncio.open_connection("127.0.0.1", sock.getsockname()[1])
                talk = Talk(reader, writer)
                await talk.ask(GET)
                await asyncio.sleep(0.2)
                found = await talk.ask(GET)
                writer.close()
            return found
        finally:
            server.should_exit = True
            await serving

    assert asyncio.run(main()) == b"2 /a"
