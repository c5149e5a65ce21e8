"""Choice of the connection to close when the limit is reached."""

from __future__ import annotations

from rosld.server.serving.connections import SILENT_SECONDS, Connections


class One:
    """A connection that records that it was ended."""

    is_ended = False

    def end_idle(self) -> None:
        self.is_ended = True


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def opened(to: Connections, number: int) -> list[One]:
    made = [One() for _ in range(number)]
    assert all(to.open(one) for one in made)
    return made


def ended(of: list[One]) -> list[int]:
    return [number for number, one in enumerate(of) if one.is_ended]


def test_the_connection_that_was_idle_longest_makes_room() -> None:
    of = Connections(3)
    held = opened(of, 3)
    of.start_request(held[0])
    of.end_request(held[1])
    more = opened(of, 1)
    assert ended(held) == [2]
    of.end_request(held[0])
    opened(of, 2)
    assert (ended(held), ended(more)) == ([1, 2], [0])
    assert len(of) == 3


def test_where_none_is_idle_there_is_a_reserve_which_idle_ones_do_not_fill() -> None:
    of = Connections(2, reserve=2)
    busy = opened(of, 2)
    assert all(of.start_request(one) for one in busy)
    extra = opened(of, 3)
    assert ended(extra) == [0]
    assert not any(of.start_request(one) for one in extra[1:])
    assert not of.open(One())
    of.end_request(extra[2])
    opened(of, 1)
    assert (ended(busy), ended(extra)) == ([], [0, 2])


def test_who_may_have_no_more_connections_has_one_in_the_reserve() -> None:
    of = Connections(2, reserve=1)
    greedy = One()
    assert of.open(greedy, is_extra=True)
    assert not of.start_request(greedy)
    assert all(of.start_request(one) for one in opened(of, 2))


def test_a_websocket_that_was_sent_nothing_for_long_makes_room_when_no_connection_is_idle() -> None:
    clock = Clock()
    of = Connections(2, reserve=1, clock=clock)
    connections, websockets = opened(of, 2), [One(), One()]
    for each in zip(connections, websockets, strict=True):
        of.upgrade(*each)
    clock.now += SILENT_SECONDS / 2
    of.note_activity(websockets[0])
    extra = opened(of, 1)
    assert not of.start_request(extra[0])
    clock.now += SILENT_SECONDS / 2
    assert of.start_request(opened(of, 1)[0])
    assert ended(websockets) == [1]
