"""No file of the firmware's app uses one that uses it, directly or through others."""

import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

APP = Path(__file__).resolve().parents[2] / "firmware" / "app"
DEFINED = re.compile(r"^(?!static)[a-z_0-9 *]+?\b(\w+)\([^;{]*\)\n\{", re.MULTILINE)


def uses(sources: dict[str, str]) -> dict[str, set[str]]:
    """Which files each file calls functions of."""
    owner = {name: file for file, text in sources.items() for name in DEFINED.findall(text)}
    return {
        file: {owner[name] for name in re.findall(r"\b(\w+)\(", text) if owner.get(name, file) != file}
        for file, text in sources.items()
    }


def app_sources() -> dict[str, str]:
    return {path.name: path.read_text() for path in sorted(APP.glob("*.c"))}


def test_files_use_each_other_in_one_direction():
    graph = uses(app_sources())
    assert len(graph) > 10 and {"recording.c", "storage.c"} <= graph["card.c"]
    order = list(TopologicalSorter(graph).static_order())
    assert order[-1] == "main.c"


def test_circle_is_noticed():
    sources = app_sources()
    sources["imu.c"] += "\nvoid f(app_t *app)\n{\n    app_step_card(app, 0);\n}\n"
    sources["card.c"] += "\nvoid g(app_t *app)\n{\n    app_step_imu(app, 0);\n}\n"
    with pytest.raises(CycleError):
        TopologicalSorter(uses(sources)).prepare()
