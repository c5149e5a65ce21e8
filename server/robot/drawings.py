"""What is drawn of the newest messages of topics: made once a message, for all who look."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

import orjson

from rosld.adapters.model import MessageSchema, RosError, Sample
from rosld.server.robot.live_topics import LiveTopics
from rosld.server.robot.schemas import Schemas
from rosld.server.space.drawing import Drawing, drawing_json, place_sample

_LARGE = 64 * 1024
"""Bytes of a message from which a thread draws it."""
_MAX_KEPT = 256


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSample:
    """A sample and what is drawn of it, also as JSON; or a sentence that says why nothing is."""

    sample: Sample
    drawing: Drawing | None
    json: bytes
    problem: str = ""


class Drawings:
    """The drawings of one robot's topics."""

    def __init__(self, topics: LiveTopics, schemas: Schemas) -> None:
        self._topics = topics
        self._schemas = schemas
        self._kept: dict[str, DrawnSample] = {}
        self._turns: dict[str, asyncio.Lock] = {}

    async def newest(self, topic: str) -> DrawnSample | None:
        """The drawing of the newest message of a topic that is subscribed to; None where there is no message."""
        view = self._topics.find_view(topic)
        sample = None if view is None else view.newest
        if sample is None:
            return None
        kept = self._kept.get(topic)
        if kept is not None and kept.sample is sample:
            return kept
        async with self._turns.setdefault(topic, asyncio.Lock()):
            kept = self._kept.get(topic)  # it may have been drawn while this one waited
            if kept is None or kept.sample is not sample:
                kept = await self._draw(sample)
                self._kept.pop(topic, None)
                self._kept[topic] = kept
                while len(self._kept) > _MAX_KEPT:
                    oldest = next(iter(self._kept))
                    del self._kept[oldest]
                    self._turns.pop(oldest, None)
        return kept

    async def _draw(self, sample: Sample) -> DrawnSample:
        try:
            schema = await self._schemas.message(sample.schema)
            if len(sample.data) > _LARGE:
                return await asyncio.to_thread(_draw_sample, schema, sample)
            return _draw_sample(schema, sample)
        except (RosError, ValueError, MemoryError) as error:
            return DrawnSample(sample, None, b"null", f"{error}" or "It cannot be drawn")


def _draw_sample(schema: MessageSchema, sample: Sample) -> DrawnSample:
    drawing = place_sample(schema, sample)
    return DrawnSample(sample, drawing, orjson.dumps(drawing_json(drawing), option=orjson.OPT_SERIALIZE_NUMPY))
