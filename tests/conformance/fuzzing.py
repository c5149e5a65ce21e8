"""Fuzzing: number and choice of examples in a run."""

from __future__ import annotations

import os
from collections.abc import Callable

from hypothesis import HealthCheck, Phase, seed, settings

SEED = int(os.environ.get("ROSLD_FUZZ_SEED", "0"))


def fuzzing(share: float = 1.0) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test on the same examples each time, on a share of those of the profile or of `ROSLD_FUZZ_EXAMPLES`."""
    examples = int(os.environ.get("ROSLD_FUZZ_EXAMPLES", settings().max_examples))
    how = settings(
        max_examples=max(1, int(examples * share)),
        deadline=None,
        database=None,
        phases=(Phase.explicit, Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    return lambda test: seed(SEED)(how(test))
