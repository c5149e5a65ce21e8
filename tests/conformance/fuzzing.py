"""Fuzzing: how many examples are sent in a run, and which."""

from __future__ import annotations

import os
from collections.abc import Callable

from hypothesis import HealthCheck, Phase, seed, settings

EXAMPLES = int(os.environ.get("ROSLD_FUZZ_EXAMPLES", "25"))
SEED = int(os.environ.get("ROSLD_FUZZ_SEED", "0"))


def fuzzing(times: float = 1.0) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Runs a test on the same examples each time."""
    how = settings(
        max_examples=max(1, int(EXAMPLES * times)),
        deadline=None,
        database=None,
        phases=(Phase.explicit, Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    return lambda test: seed(SEED)(how(test))
