"""From a location under `/bags/` to its resource."""

from __future__ import annotations

from rosld.adapters.base import Recording
from rosld.ontology.urls import Location, Space
from rosld.server.history.recordings import Recordings
from rosld.server.http.problem import Problem
from rosld.server.pictures.picture_cache import PictureCache
from rosld.server.resources.bag_container import BagContainer
from rosld.server.resources.bag_files import BagFile, BagUpload, UnreadableBag
from rosld.server.resources.bag_messages import BagMessage, BagMessages
from rosld.server.resources.bag_moment import bag_moment
from rosld.server.resources.bags import BagResource
from rosld.server.resources.event_stream import EventStreamResource, event_stream_page
from rosld.server.resources.recording_trigger import RecordingTriggers
from rosld.server.resources.unfinished_bags import ArmedBag, RunningBag
from rosld.server.rest.resource import Resource, permanent_redirect
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings


def bag_route(
    session: Session,
    states: VersionCache[State],
    recordings: Recordings,
    pictures: PictureCache,
    location: Location,
    triggers: RecordingTriggers | None = None,
) -> Resource:
    """The resource at `/bags/` or below. Raises a 404 Problem where there is none, 308 where only the slash differs."""
    match location.segments:
        case ():
            return (
                BagContainer(session, states, recordings, triggers)
                if location.is_container
                else _slash(session.space, location)
            )
        case (name,) if not location.is_container:
            return BagUpload(session.space, session.settings, states, recordings, name)
        case (name,):
            return _bag(session.space, session.settings, states, recordings, name)
        case (name, "file") if not location.is_container:
            return BagFile(session.space, recordings, _recording(recordings, name))
        case (name, "at") if not location.is_container:
            return bag_moment(session, _recording(recordings, name))
        case (name, "ldes"):
            if location.is_container:  # where the breadcrumb of a page of the stream leads
                raise permanent_redirect(session.space.bag_stream(name))
            return EventStreamResource(session, states, recordings.history, _recording(recordings, name))
        case (name, "ldes", page) if not location.is_container:
            return event_stream_page(session, states, recordings.history, _recording(recordings, name), page)
        case (name, "messages"):
            recording = _recording(recordings, name)
            return BagMessages(session, states, recording) if location.is_container else _slash(session.space, location)
        case (name, "messages", index) if not location.is_container:
            recording = _recording(recordings, name)
            return BagMessage(session, states, pictures, recording, _message_index(recording, index))
    raise Problem(404, "Under /bags/B/ there are messages/, ldes, at and file, and nothing else.")


def _bag(space: Space, settings: Settings, states: VersionCache[State], recordings: Recordings, name: str) -> Resource:
    """The recording of a name, in whatever state it is. Raises a 404 Problem where there is none."""
    if name in recordings.armed:
        return ArmedBag(space, settings, recordings, recordings.armed[name])
    if name in recordings.unreadable:
        return UnreadableBag(space, settings, recordings, name)
    running = recordings.running.get(name)
    if running is not None:
        return RunningBag(space, settings, states, recordings, running)
    return BagResource(space, settings, states, recordings, _recording(recordings, name))


def _message_index(recording: Recording, segment: str) -> int:
    """The index of a message that is there; a 410 Problem for one that was removed, 404 for what never was one."""
    first, beyond = recording.first, recording.first + recording.count
    is_number = segment.isascii() and segment.isdigit() and str(int(segment)) == segment
    if is_number and first <= int(segment) < beyond:
        return int(segment)
    if is_number and int(segment) < first:
        raise Problem(410, f"Message {segment} of {recording.name} was removed: the oldest is {first}.")
    raise Problem(404, f"{recording.name} has the messages {first} to {beyond - 1}, not {segment}.")


def _slash(space: Space, location: Location) -> Resource:
    url = space.container("bags", location.segments)
    raise permanent_redirect(url)


def _recording(recordings: Recordings, name: str) -> Recording:
    found = recordings.readable.get(name)
    if found is None and name in recordings.armed:
        raise Problem(404, f"The recording {name} waits for its trigger: it has no messages yet.")
    if found is None and name in recordings.running:
        raise Problem(404, f'The recording {name} is still being made: PATCH it with {{"status": "ended"}} first.')
    if found is None:
        raise Problem(404, f"There is no recording {name}: /bags/ lists those that there are.")
    return found
