"""How often a topic may be published to, whoever asks for it."""

from __future__ import annotations

from dataclasses import dataclass, field

from rosld.server.auth.rate_limit import TokenBucket


@dataclass(slots=True)
class PublishLimiter:
    """Limiter of publishes: at most `rate` a second a topic, in bursts of up to one second's worth."""

    rate: float
    _buckets: dict[str, TokenBucket] = field(default_factory=dict)

    def wait(self, topic: str, now: float, *, is_counted: bool = True) -> float:
        """Count a publish if asked to and return 0.0, or count none and return the seconds until one is allowed."""
        bucket = self._bucket(topic)
        seconds = bucket.wait(now)
        if seconds == 0.0 and is_counted:
            bucket.take(now)
        return seconds

    def count(self, topic: str, now: float) -> None:
        """Count a publish that cannot wait: the next ones wait for it, a second's worth at the most."""
        self._bucket(topic).take(now, debt=self.rate)

    def _bucket(self, topic: str) -> TokenBucket:
        found = self._buckets.get(topic)
        if found is None:
            found = self._buckets[topic] = TokenBucket(self.rate, self.rate)
        return found
