"""From a location under `/bags/` to its resource."""

from __future__ import annotations

from rosld.adapters.base import Recording
from rosld.ontology.urls import Location
from rosld.server.http.problem import Problem
from rosld.server.resources.bag_files import BagFile, BagUpload
from rosld.server.resources.bag_moment import bag_moment
from rosld.server.resources.bags import ArmedBag, BagContainer, BagMessage, BagMessages, BagResource, RunningBag
from rosld.server.resources.context import Robot
from rosld.server.resources.event_stream import EventStreamResource, event_stream_page
from rosld.server.resources.recording_trigger import Find
from rosld.server.rest.resource import Resource, permanent_redirect


def bag_route(robot: Robot, location: Location, find: Find | None = None) -> Resource:
    """`/bags/` and below."""
    match location.segments:
        case ():
            return BagContainer(robot, find) if location.is_container else _slash(robot, location)
        case (name,) if not location.is_container:
            return BagUpload(robot, name)
        case (name,) if name in robot.bags.armed:
            return ArmedBag(robot, robot.bags.armed[name])
        case (name,):
            running = robot.bags.running.get(name)
            return BagResource(robot, _recording(robot, name)) if running is None else RunningBag(robot, running)
        case (name, "file") if not location.is_container:
            return BagFile(robot, _recording(robot, name))
        case (name, "at") if not location.is_container:
            return bag_moment(robot, _recording(robot, name))
        case (name, "ldes") if not location.is_container:
            return EventStreamResource(robot, _recording(robot, name))
        case (name, "ldes", page) if not location.is_container:
            return event_stream_page(robot, _recording(robot, name), page)
        case (name, "messages"):
            recording = _recording(robot, name)
            return BagMessages(robot, recording) if location.is_container else _slash(robot, location)
        case (name, "messages", index) if not location.is_container:
            recording = _recording(robot, name)
            first, beyond = recording.first, recording.first + recording.count
            is_number = index.isascii() and index.isdigit() and str(int(index)) == index
            if is_number and first <= int(index) < beyond:
                return BagMessage(robot, recording, int(index))
            if is_number and int(index) < first:
                raise Problem(410, f"Message {index} of {name} was removed: the oldest is {first}.")
            raise Problem(404, f"{name} has the messages {first} to {beyond - 1}, not {index}.")
    raise Problem(404, "Under /bags/B/ there are messages/, ldes, at and file, and nothing else.")


def _slash(robot: Robot, location: Location) -> Resource:
    url = robot.space.container("bags", location.segments)
    raise permanent_redirect(url)


def _recording(robot: Robot, name: str) -> Recording:
    found = robot.recordings.get(name)
    if found is None and name in robot.bags.armed:
        raise Problem(404, f"The recording {name} waits for its trigger: it has no messages yet.")
    if found is None and name in robot.bags.running:
        raise Problem(404, f'The recording {name} is still being made: PATCH it with {{"status": "ended"}} first.')
    if found is None:
        raise Problem(404, f"There is no recording {name}.")
    return found
