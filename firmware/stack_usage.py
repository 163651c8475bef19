"""Worst-case stack of the firmware, from the call graph that GCC writes with -fcallgraph-info=su.

Owns the sum: the deepest path below main, plus for each interrupt priority the deepest of its handlers and the frame
the core pushes. Calls through pointers are resolved by the table below; one that is not in it, a recursion, or a
function of unknown size is an error, so the sum cannot be too small unnoticed.
"""

import re
from dataclasses import dataclass
from pathlib import Path

EXCEPTION_FRAME = 8 * 4 + 4  # eight words, and one more where the stack has to be aligned (PM0056, 2.3.7)

# Functions called through pointers, by the file the call stands in. Functions are named "file.c:function".
CARD_BUS = ["port/card.c:" + name for name in ("select_card", "set_speed", "exchange", "start", "is_done", "now_us")]
BOARD_ITSELF = [
    "now_us",
    "lock",
    "unlock",
    "is_supply_low",
    "feed_watchdog",
    "sleep",
    "restart",
    "set_mark",
    "stack_free",
]
BOARD_IMU = ["start_sampling", "stop_sampling", "is_sampling_on_pin"]
BOARD = ["port/board.c:" + name for name in (*BOARD_ITSELF, "set_idle")]
BOARD += ["port/imu.c:" + name for name in BOARD_IMU] + ["port/uart.c:set_baud"]
CALLED_FROM = {
    "sdcard.c": [*CARD_BUS, "port/board.c:wait"],
    "mpu9250.c": ["port/imu.c:transfer", "port/board.c:wait_us"],
    "neo6m.c": ["port/gps.c:set_baud", "port/gps.c:write", "port/gps.c:read"]
    + ["app/gps.c:" + name for name in ("on_sentence", "on_lost", "on_configured", "on_silent")],
    "panel.c": ["port/board.c:set_led", "port/board.c:is_pressed"],
    "serial.c": ["port/uart.c:kick"],
    "recovery.c": ["app/storage.c:read_block"],
    "volume.c": ["app/storage.c:look_at", "app/volume.c:write_part", "app/volume.c:check_part"],
    "app/app.c": BOARD,
    "app/checks.c": [*BOARD, "port/board.c:wait_us"],
    "app/storage.c": [*CARD_BUS, "port/board.c:wait"],
    "app/card.c": BOARD,
    "app/gps.c": BOARD,
    "app/imu.c": BOARD,
    "app/journal.c": BOARD,
    "app/recording.c": BOARD,
    "app/main.c": BOARD,
    "port/board.c": ["app/app.c:serve"],
    "port/time.c": ["port/imu.c:on_tick"],
    "port/imu.c": ["sampler_on_burst"],
}
# Handlers by priority, as port.h has them.
HANDLERS = {
    1: ["TIM2_IRQHandler", "EXTI0_IRQHandler", "DMA1_Channel4_IRQHandler"],
    2: ["USART2_IRQHandler", "DMA1_Channel6_IRQHandler"],
    3: ["DMA1_Channel2_IRQHandler"],
    5: ["USART1_IRQHandler"],
}
# Routines of the C library and of the compiler, which come without a call graph: more than their disassembly pushes.
LIBRARY = {"memcpy": 32, "memset": 32, "memcmp": 32, "memchr": 32, "strlen": 16, "strchr": 16, "__aeabi_uldivmod": 96}


class StackError(Exception):
    """The call graph does not let the stack be bounded."""


@dataclass(frozen=True)
class CallGraph:
    """Bytes of stack of each function, and whom it calls."""

    stack: dict[str, int]
    calls: dict[str, frozenset[str]]


def short_name(title: str) -> str:
    """Name of a function as the tables have it, from GCC's: without directories above, without clone suffixes."""
    path, colon, function = title.rpartition(":")
    function = re.sub(
        r"\.(isra|constprop|part|cold)(\.\d+)*$", "", re.sub(r"\.(isra|constprop|part|cold)\.\d+", "", function)
    )
    if not colon:
        return function
    parts = Path(path).parts
    folder = "port" if "port" in parts else parts[-2] if len(parts) > 1 else ""
    return f"{folder}/{parts[-1]}:{function}"


def read_call_graph(paths: list[Path]) -> CallGraph:
    """Read .ci files. Clones of one function are joined, with the larger stack."""
    stack: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for path in paths:
        text = path.read_text()
        place = short_name(re.search(r'graph: \{ title: "([^"]+)"', text).group(1) + ":")[:-1]  # type: ignore[union-attr]
        for title, label in re.findall(r'node: \{ title: "([^"]+)" label: "([^"]+)"', text):
            size = re.search(r"(\d+) bytes \((static|dynamic,bounded)\)", label)
            if size:
                stack[short_name(title)] = max(stack.get(short_name(title), 0), int(size.group(1)))
        for source, target in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            name = f"pointer in {place}" if target == "__indirect_call" else short_name(target)
            calls.setdefault(short_name(source), set()).add(name)
    return CallGraph(stack, {name: frozenset(targets) for name, targets in calls.items()})


def targets_of(name: str) -> list[str]:
    """Resolve a call through a pointer by the table of the file it stands in."""
    place = name.removeprefix("pointer in ")
    for key, targets in CALLED_FROM.items():
        if place == key or place.endswith("/" + key):
            return targets
    raise StackError(f"{place} calls through a pointer and is not in the table of stack_usage.py")


def deepest(graph: CallGraph, name: str, path: tuple[str, ...] = (), cache: dict[str, int] | None = None) -> int:
    """Bytes of stack below and with function `name`."""
    cache = {} if cache is None else cache
    if name in cache:
        return cache[name]
    if name in path:
        raise StackError(f"recursion: {' > '.join((*path, name))}")
    if name.startswith("pointer in "):
        return max(deepest(graph, target, (*path, name), cache) for target in targets_of(name))
    if name in LIBRARY:
        return LIBRARY[name]
    if name not in graph.stack:
        raise StackError(f"{name} has no known stack (called by {path[-1] if path else 'nobody'})")
    below = [deepest(graph, target, (*path, name), cache) for target in graph.calls.get(name, frozenset())]
    cache[name] = graph.stack[name] + max(below, default=0)
    return cache[name]


def worst_stack(graph: CallGraph) -> dict[str, int]:
    """Bytes of stack of main and of each interrupt priority, frames included; their sum is the worst case."""
    parts = {"main": graph.stack["Reset_Handler"] + deepest(graph, "main")}
    for priority, handlers in HANDLERS.items():
        known = [deepest(graph, handler) for handler in handlers]
        parts[f"priority {priority}"] = max(known) + EXCEPTION_FRAME
    return parts
