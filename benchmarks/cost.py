"""Wall and CPU time of a piece of work, of one run or the least of several."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Cost:
    """Wall and CPU time, s."""

    wall: float
    cpu: float

    def __str__(self) -> str:
        return f"{self.wall:7.2f} s ({self.cpu:7.2f})"


def cost_of(work: Callable[[], object]) -> Cost:
    """Run `work` once."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return Cost(time.perf_counter() - wall, time.process_time() - cpu)


def least(costs: Sequence[Cost]) -> Cost:
    """Return the least wall and the least CPU time of several runs: what is more was somebody else's."""
    return Cost(min(cost.wall for cost in costs), min(cost.cpu for cost in costs))


def best_of(repeats: int, work: Callable[[], object]) -> Cost:
    """Run `work` several times and return the least wall and CPU time."""
    return least([cost_of(work) for _ in range(repeats)])
