"""`--set gnss.rate=10`: texts of the command line as values of the simulation's scenario, and the list of them all.

Names and types are those of the scenario's dataclasses.
"""

import dataclasses
import math
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from smoother.errors import UsageError
from smoother.sim.motion import Spin, Stop
from smoother.sim.presets import draw_scenario
from smoother.sim.scenario import GROUPS, Interval, Jump, Scenario, with_changes


def parsed(settings: Sequence[str]) -> dict[str, Any]:
    """Return NAME=VALUE texts as changes for `with_changes`. Raises UsageError with the text and what was expected."""
    changes = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise UsageError(f"--set {setting}: write NAME=VALUE, such as gnss.white_horizontal=0.5")
        kind = _kinds().get(name.strip())
        # a name that does not exist is refused by with_changes, which knows the nearest one
        changes[name.strip()] = text if kind is None else _value(text.strip(), kind, setting)
    return changes


def listed(preset: str, seed: int, changes: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Name and value of every parameter of a preset as drawn for `seed`, with `changes` applied."""
    scenario = with_changes(draw_scenario(preset, np.random.default_rng(seed).spawn(2)[0]), changes)
    for name in _kinds():
        group, _, figure = name.rpartition(".")
        owner = getattr(scenario, group) if group else scenario
        yield name, "-" if owner is None else _shown(getattr(owner, figure))


def _kinds() -> dict[str, Any]:
    """Type of every parameter that a text can set."""
    kinds = {name: kind for name, kind in _fields(Scenario) if name not in (*GROUPS, "name", "track", "duration")}
    for group, owner in GROUPS.items():
        kinds |= {f"{group}.{name}": kind for name, kind in _fields(owner)}
    return kinds


def _fields(owner: type) -> list[tuple[str, Any]]:
    hints = typing.get_type_hints(owner)
    return [(field.name, hints[field.name]) for field in dataclasses.fields(owner)]


def _value(text: str, kind: Any, setting: str) -> Any:
    options = typing.get_args(kind) if isinstance(kind, types.UnionType) else (kind,)
    if text.lower() == "none":
        if types.NoneType in options:
            return None
        raise UsageError(f"--set {setting}: this figure cannot be left out")
    kind = next(option for option in options if option is not types.NoneType)
    try:
        return _reader(kind)(text)
    except (ValueError, TypeError) as error:
        raise UsageError(f"--set {setting}: {_expected(kind)} expected") from error


def _reader(kind: Any) -> Callable[[str], Any]:
    if kind in (float, int, str):
        return kind  # type: ignore[no-any-return]
    if kind is bool:
        return _truth_value
    if typing.get_origin(kind) is tuple:
        item = typing.get_args(kind)[0]
        return lambda text: tuple(_items(text, item)) if text else ()
    return _array


def _expected(kind: Any) -> str:
    if typing.get_origin(kind) is tuple:
        item = typing.get_args(kind)[0]
        parts = {Interval: "start:length", Stop: "time:length", Spin: "time:length", Jump: "start:length:north:west:up"}
        return f"a list {parts.get(item, 'number')},.."
    names = {float: "a number", int: "a whole number", bool: "true or false"}
    return names.get(kind, "3 or 9 numbers with commas between")


def _items(text: str, item: type) -> Iterator[Any]:
    for part in text.split(","):
        numbers = [float(number) for number in part.split(":")]
        if any(math.isnan(number) for number in numbers):
            raise ValueError(part)
        if item is float and len(numbers) == 1:
            yield numbers[0]
        elif item is Jump and len(numbers) == 5:
            yield Jump(numbers[0], numbers[1], np.array(numbers[2:]))
        elif item in (Interval, Stop, Spin) and len(numbers) == 2:
            yield item(*numbers)
        else:
            raise ValueError(part)


def _array(text: str) -> Any:
    numbers = np.array([float(part) for part in text.split(",")])
    if numbers.size not in (3, 9) or not np.all(np.isfinite(numbers)):
        raise ValueError(text)
    return numbers if numbers.size == 3 else numbers.reshape(3, 3)


def _truth_value(text: str) -> bool:
    known = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    if text.lower() not in known:
        raise ValueError(text)
    return known[text.lower()]


def _shown(value: Any) -> str:
    """A value in the form of --set."""
    if dataclasses.is_dataclass(value):
        return ":".join(_shown(getattr(value, field.name)) for field in dataclasses.fields(value)).replace(",", ":")
    if isinstance(value, np.ndarray):
        return ",".join(f"{number:.6g}" for number in value.ravel())
    if isinstance(value, tuple):
        return ",".join(_shown(item) for item in value)
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    return f"{value:.10g}" if isinstance(value, float) else str(value)
