"""Forms of pictures, and their cache: each is drawn once for all its readers. Imports no drawing library."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple, TypeAlias

from msgspec import Struct

from rosld.adapters.model import MessageSchema, Sample
from rosld.server.runtime.process_memory import PROCESS_MEMORY

JPEG, PNG = "image/jpeg", "image/png"
RAW_IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
DRAWN_TYPES = (RAW_IMAGE, COMPRESSED_IMAGE, OCCUPANCY_GRID)
"""Message types that can be drawn as pictures."""


class DepthRange(NamedTuple):
    """Distances in metres of the nearest and the farthest colour."""

    nearest: float = 0.0
    farthest: float = 10.0


DEFAULT_RANGE = DepthRange()


class PictureForm(Struct, frozen=True):
    """Form of a requested picture: its media type, maximum width, and the distances of colours."""

    media_type: str = JPEG
    width: int | None = None
    shown: DepthRange = DEFAULT_RANGE


def can_draw(type_name: str) -> bool:
    """Whether messages of a type are pictures."""
    return type_name in DRAWN_TYPES


MAX_PIXELS = 36_000_000
"""Maximum number of pixels of a picture: 8K video has 33 million."""
_PER_PIXEL = 24
"""Maximum bytes per pixel while drawing: 64 bits in four channels, and the same as floats."""


class CannotDraw(ValueError):
    """A message that cannot be drawn as a picture. The message is a sentence without its full stop.

    `words` are quoted from the message, such as its encoding, and are not part of the sentence.
    """

    def __init__(self, sentence: str, words: str | None = None) -> None:
        super().__init__(sentence)
        self.words = words


class UnknownPicture(CannotDraw):
    """Pictures of this kind are not supported, regardless of their data."""


def require_size(width: int, height: int) -> None:
    """Raise CannotDraw if a picture has no pixels, or too many.

    Raises NotEnoughMemory if there is not enough memory to draw it.
    """
    if width <= 0 or height <= 0:
        raise CannotDraw(f"The image is {width} by {height} pixels, so there is nothing to show")
    if width * height > MAX_PIXELS:
        raise CannotDraw(f"The image has {width} by {height} pixels, but the limit is {MAX_PIXELS:,}")
    PROCESS_MEMORY.require(width * height * _PER_PIXEL, f"a picture of {width} by {height} pixels")


DrawSample: TypeAlias = Callable[[MessageSchema, Sample], bytes]
_MAX_FILES = 32
_MAX_BYTES = 32 * 1024 * 1024


class PictureCache:
    """Pictures by sample and form; requests for a picture being drawn wait for it.

    A single thread draws, so that pictures use at most one core, and never the event loop.
    """

    def __init__(self, instance_id: str) -> None:
        """Create a cache. `instance_id` is part of the entity tags, and differs for each run of the server."""
        self.instance_id = instance_id
        self._thread = ThreadPoolExecutor(1, "rosld-pictures")
        self._drawing: dict[Hashable, asyncio.Task[bytes]] = {}
        self._files: OrderedDict[Hashable, bytes] = OrderedDict()
        self._bytes = 0
        self.drawings = 0
        """Number of pictures drawn since the start."""

    async def picture(self, topic: str, schema: MessageSchema, sample: Sample, form: PictureForm) -> bytes:
        """Return the file of a sample's picture. Raises CannotDraw, ValueError and MemoryError."""
        return await self.file(topic, schema, sample, form, partial(_draw_picture, form=form))

    async def file(self, topic: str, schema: MessageSchema, sample: Sample, form: Hashable, draw: DrawSample) -> bytes:
        """Return the file that `draw` makes of a sample on the thread; `form` is part of its key."""
        key = (topic, sample.publisher, sample.epoch, sample.sequence, sample.received_ns, form)
        found = self._files.get(key)
        if found is not None:
            self._files.move_to_end(key)
            return found
        task = self._drawing.get(key)
        if task is None:
            task = self._drawing[key] = asyncio.ensure_future(self._draw(key, schema, sample, draw))
            task.add_done_callback(partial(self._on_drawn, key))
        return await asyncio.shield(task)

    def _on_drawn(self, key: Hashable, task: asyncio.Task[bytes]) -> None:
        self._drawing.pop(key, None)
        if not task.cancelled():
            task.exception()  # retrieved, because the waiting requests may have been cancelled

    async def _draw(self, key: Hashable, schema: MessageSchema, sample: Sample, draw: DrawSample) -> bytes:
        self.drawings += 1
        data = await asyncio.get_running_loop().run_in_executor(self._thread, draw, schema, sample)
        self._keep(key, data)
        return data

    def _keep(self, key: Hashable, data: bytes) -> None:
        self._files[key] = data
        self._bytes += len(data)
        while self._files and (len(self._files) > _MAX_FILES or self._bytes > _MAX_BYTES):
            _, oldest = self._files.popitem(last=False)
            self._bytes -= len(oldest)

    def close(self) -> None:
        """Cancel pending pictures. The one being drawn is finished."""
        self._thread.shutdown(wait=False, cancel_futures=True)


def _draw_picture(schema: MessageSchema, sample: Sample, form: PictureForm) -> bytes:
    from rosld.server.pictures.picture import draw_sample  # imported late: Pillow is a tenth of the server's start time

    return draw_sample(schema, sample, form)
