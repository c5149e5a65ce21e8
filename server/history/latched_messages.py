"""Messages that subscribers who come late are sent: the latched ones of ROS 1, the transient-local ones of ROS 2."""

from __future__ import annotations

from collections.abc import Callable

from rosld.adapters.model import Sample
from rosld.adapters.model.sample import latched_depth


class LatchedMessages:
    """The latest latched message of each publisher of each topic. One thread changes it, any thread reads.

    Of transforms it is the latest few, for later messages add frames to those of the earlier ones.
    """

    def __init__(self) -> None:
        self._samples: dict[tuple[str, str], tuple[Sample, ...]] = {}

    def take(self, topic: str, sample: Sample) -> None:
        """Take in a message that came after all others of its publisher; one that is not latched is ignored."""
        if sample.latched:
            key = topic, sample.publisher
            self._samples[key] = (*self._samples.get(key, ()), sample)[-latched_depth(sample.schema.name) :]

    def keep(self, is_there: Callable[[str, str], bool]) -> None:
        """Forget the messages of the publishers that are not there any more, by topic and name."""
        self._samples = {key: samples for key, samples in list(self._samples.items()) if is_there(*key)}

    def messages(self, wants: Callable[[str], bool]) -> list[tuple[str, Sample]]:
        """The messages of the topics that are wanted, in order of receipt."""
        found = [
            (topic, sample)
            for (topic, _), samples in list(self._samples.items())
            if samples and wants(topic)
            for sample in samples
        ]
        return sorted(found, key=lambda one: one[1].received_ns)
