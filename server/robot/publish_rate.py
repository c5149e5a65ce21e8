"""How often a topic may be published to: a token bucket a topic."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class PublishLimiter:
    """Lets through at most `rate` publishes a second a topic, with bursts of up to one second's worth."""

    rate: float
    _buckets: dict[str, tuple[float, float]] = field(default_factory=dict)

    def wait(self, topic: str, now: float) -> float:
        """0.0 and one publish less, or the seconds until the next is allowed. `now` is a monotonic time in seconds."""
        most = max(self.rate, 1.0)
        tokens, then = self._buckets.get(topic, (most, now))
        tokens = min(most, tokens + (now - then) * self.rate)
        if tokens < 1.0:
            self._buckets[topic] = (tokens, now)
            return (1.0 - tokens) / self.rate
        self._buckets[topic] = (tokens - 1.0, now)
        return 0.0

    def count(self, topic: str, now: float) -> None:
        """Count a publish that cannot wait: the next ones wait for it, a second's worth at the most."""
        tokens, then = self._buckets.get(topic, (self.rate, now))
        tokens = min(max(self.rate, 1.0), tokens + (now - then) * self.rate) - 1.0
        self._buckets[topic] = (max(tokens, -self.rate), now)
