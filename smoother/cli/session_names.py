"""Short, unique names of several sessions."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

FIELDS = ("kart", "driver", "title")  # of session.toml, in the order in which they are tried


def session_names(paths: Sequence[Path], abouts: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a name for each session: that of its folder or file where these differ.

    Else kart, driver or title of session.toml where they differ, else as many of the folders above as
    make them differ. A session that is named twice gets a number. abouts: `session` of each summary.json.
    """
    places = [_place(path.resolve()) for path in paths]
    deepest = max(len(place) for place in places)
    folders = [["/".join(place[-depth:]) for place in places] for depth in range(1, deepest + 1)]
    for names in (folders[0], *_stated(abouts), *folders[1:]):
        if len(set(names)) == len(names):
            return names
    return _numbered(folders[0])


def _place(path: Path) -> tuple[str, ...]:
    return (*path.parts[:-1], path.stem if path.is_file() else path.name)


def _stated(abouts: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Names from session.toml, shortest first; none from a field that a session lacks."""
    known = {field: [_called(field, about.get(field)) for about in abouts] for field in FIELDS}
    whole = {field: values for field, values in known.items() if all(values)}
    names = [*whole.values()]
    if "kart" in whole and "driver" in whole:  # a kart of several drivers, each in several karts
        names.append([f"{kart}, {driver}" for kart, driver in zip(whole["kart"], whole["driver"], strict=True)])
    return names


def _called(field: str, value: str | None) -> str:
    """A kart is often stated by its number alone, which is no name."""
    text = (value or "").strip()
    return f"kart {text}" if field == "kart" and text.isdecimal() else text


def _numbered(names: Sequence[str]) -> list[str]:
    often = Counter(names)
    return [f"{name} ({names[:i].count(name) + 1})" if often[name] > 1 else name for i, name in enumerate(names)]
