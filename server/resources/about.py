"""Resources that others tell of: reading the latter takes the right to read the former."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rosld.ontology.urls import Location, Space
from rosld.server.events.notification_channels import Channels
from rosld.server.history.recordings import Recordings
from rosld.server.receipts.journal import Journal, NoSuchReceipt
from rosld.server.robot.hold_store import Holds
from rosld.server.robot.session import Session


@dataclass(frozen=True, slots=True)
class AboutResources:
    """The URLs of what a resource tells of; None where there is no such resource, so that this is not known.

    Those of what is gone are none: that it is gone tells nothing of it. Any thread may ask.
    """

    session: Session
    holds: Holds
    recordings: Recordings
    receipts: Journal
    channels: Channels

    def __call__(self, location: Location) -> Sequence[str] | None:
        """The URLs of what the resource at a location tells of."""
        space, session = self.session.space, self.session
        match location.kind, location.segments:
            case "calls", (id,):
                name = session.calls.service_of(id)
                return name if name is None else (space.service(name),) if name else ()
            case "goals", (id,):
                name = session.goals.action_of(id)
                return name if name is None else (space.action(name),) if name else ()
            case "holds", (id,):
                name = self.holds.topic_of(id)
                return name if name is None else (space.topic(name),) if name else ()
            case "activity", (id,):
                return self._of_receipt(id)
            case "channels", (_, token, *_):
                topic = self.channels.topic_of(token)
                return None if topic is None else (topic,)
            case "bags", (name, "file"):
                return self._of_file(space, name)
            case "bags", (name, "messages", index):
                return self._of_message(space, name, index)
        return ()

    def _of_receipt(self, id: str) -> Sequence[str] | None:
        try:
            return self.receipts.find(id).touched
        except NoSuchReceipt:
            return None

    def _of_file(self, space: Space, name: str) -> Sequence[str]:
        """The recording and all of its topics: its file holds their messages."""
        recording = self.recordings.find(name)
        return () if recording is None else (space.bag(name), *map(space.topic, recording.topics))

    def _of_message(self, space: Space, name: str, segment: str) -> Sequence[str] | None:
        recording = self.recordings.find(name)
        if recording is None or not (segment.isascii() and segment.isdigit()):
            return None
        index = int(segment)
        if index < recording.first:
            return ()
        topic = recording.topic_of(index)
        return None if topic is None else (space.topic(topic),)
