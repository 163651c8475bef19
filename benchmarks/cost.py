"""Wall and CPU time of a piece of work, the best of several runs."""

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Cost:
    """Wall and CPU time, s."""

    wall: float
    cpu: float

    def __str__(self) -> str:
        return f"{self.wall:7.2f} s ({self.cpu:7.2f})"


def best_of(repeats: int, work: Callable[[], object]) -> Cost:
    """Run `work` several times and return the least wall and CPU time: what is more was somebody else's."""
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return Cost(min(walls), min(cpus))
