"""The memory of rosld next to many topics that are occasionally read (`bench/ros2_memory.py`), for some seconds."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.ros2 import distros

HERE = Path(__file__).parent
BENCH = HERE.parents[1] / "bench" / "ros2_memory.py"
MAX_MEGABYTES = 4.0
"""With 100 topics at 50 Hz these are 60 bytes per message; without a leak memory grows by less than one."""


def load(name: str, path: Path) -> ModuleType:
    """Import a module by its path, as benches are not in packages."""
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


bench = load("bench_ros2_memory", BENCH)


def test_growth_is_the_slope_after_the_warm_up_and_noise_is_none() -> None:
    warming = [bench.Held(float(second), 100.0 + 5 * second) for second in range(10)]
    steady = [bench.Held(float(second), 150.0 + second % 2) for second in range(10, 31)]
    leaking = [bench.Held(float(second), 150.0 + second) for second in range(10, 31)]
    assert abs(bench.grown([*warming, *steady])) < 0.5
    assert bench.grown([*warming, *leaking]) == pytest.approx(20.0)
    with pytest.raises(ValueError, match="for longer"):
        bench.slope([bench.Held(1.0, 100.0)])


@pytest.mark.slow
@pytest.mark.ros2
def test_memory_does_not_grow_while_topics_are_published_and_looked_at() -> None:
    python = distros.require("jazzy").python
    options = ("--minutes", "0.35", "--every", "1", "--topics", "100", "--most", str(MAX_MEGABYTES))
    with distros.free_domain() as domain:
        done = subprocess.run(
            [python, str(BENCH), *options, "--domain", str(domain)],
            env=distros.environment(domain),
            capture_output=True,
            text=True,
            timeout=180,
            check=False,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "MB an hour" in done.stdout
