"""The form of the page `/bags/` that begins a recording, or has one wait for its trigger."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from rosld.adapters.model import MessageSchema
from rosld.adapters.model.library import TypeLibrary
from rosld.server.html.forms import MessageForm, NameChoices

_FIELDS = """string name
float64 duration
string topics
float64 before
string trigger_resource
string trigger_condition
uint8 trigger_limit
"""
_FOLDED = frozenset({"topics", "before", "trigger_resource", "trigger_condition", "trigger_limit"})
_ABOUT = (
    "Topics: those that you tick, all where you tick none. Duration: seconds, 0 for as long as you like. More: globs "
    "of topics with spaces between them, such as /odom /camera/*; seconds out of the history before; a condition, "
    "such as percentage < 0.2, that begins the recording when it comes to hold of the value at a URL."
)


@cache
def _schema() -> MessageSchema:
    return TypeLibrary(ros_version=2, folders=()).learn_message("rosld/msg/Recording", _FIELDS)


def recording_form(topics: Mapping[str, str]) -> MessageForm:
    """The form; `topics` are those that there are, with their URLs."""
    return MessageForm(
        _schema(),
        method="POST",
        title="Record",
        button="Record",
        value={"trigger_limit": 1},
        about=_ABOUT,
        choices=NameChoices("topics", "Topics", topics),
        folded=_FOLDED,
    )


def order_of_form(said: Mapping[str, object]) -> dict[str, object]:
    """What a form was filled with as an order: what was left empty is left out."""
    found = {key: said[key] for key in ("name", "before", "duration") if said.get(key)}
    found["topics"] = str(said.get("topics", "")).split() or ["*"]
    if said.get("trigger_condition") or said.get("trigger_resource"):
        limit = said.get("trigger_limit") or 1
        trigger: dict[str, object] = {"condition": said.get("trigger_condition"), "limit": limit}
        resource = said.get("trigger_resource")
        found["trigger"] = {**trigger, "resource": resource} if resource else trigger
    return found
