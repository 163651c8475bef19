"""Dependencies point one way: a module imports only from layers below its own."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LAYERS = [  # lowest first; a file or a package of smoother/
    "errors",
    "threads",
    "documents",
    "arrays",
    "disc",
    "units",
    "words",
    "problems",
    "utc_clock",
    "so3",
    "frames",
    "config",
    "samples",
    "trajectory",
    "calibration",
    "session",
    "sim",
    "fit",
    "prepare",
    "estimate",
    "laps",
    "report",
    "export",
    "live",
    "batch",
    "api",
    "cli",
    "__main__",
]

ESTIMATE = (
    "model",
    "factors",
    "solvers",
    "fixes",
    "preprocess",
    "initial",
    "output",
    "baseline",
    "judge",
)  # lowest first
MOST_IMPORTS = 25  # modules of estimate that one of them uses


def existing(name: str) -> list[Path]:
    package, module = ROOT / "smoother" / name, ROOT / "smoother" / f"{name}.py"
    return sorted(package.rglob("*.py")) if package.is_dir() else [module] if module.exists() else []


def imported_modules(path: Path) -> Iterator[str]:
    """Every module a file imports, at its head or inside a function; `from smoother import x` counts as smoother.x."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.relative_to(ROOT)}:{node.lineno}: imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def modules_of_estimate(path: Path) -> set[str]:
    """Modules below smoother.estimate that a file imports."""
    found = {name for name in imported_modules(path) if name.startswith("smoother.estimate.")}
    return {name if is_module(name) else name.rpartition(".")[0] for name in found}


def is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


@pytest.mark.parametrize("name", LAYERS)
def test_module_imports_only_layers_below(name: str) -> None:
    above = LAYERS[LAYERS.index(name) + 1 :]
    assert existing(name), f"no module is called as the layer {name}"
    for path in existing(name):
        layers = [module.split(".")[1] for module in imported_modules(path) if module.startswith("smoother.")]
        assert not set(layers) & set(above), f"{path.relative_to(ROOT)} imports a layer above its own"


def test_a_subpackage_of_estimate_imports_only_those_below_it() -> None:
    estimate = ROOT / "smoother" / "estimate"
    found = {path.parent.name for path in estimate.glob("*/__init__.py")}
    assert found <= set(ESTIMATE)
    for i, name in enumerate(ESTIMATE):
        for path in sorted((estimate / name).rglob("*.py")):
            used = {module.split(".")[2] for module in modules_of_estimate(path)}
            assert not used & set(ESTIMATE[i + 1 :]), f"{path.relative_to(ROOT)} imports a subpackage above its own"


def test_no_module_of_estimate_depends_on_most_others() -> None:
    estimate = ROOT / "smoother" / "estimate"
    counts = {path.relative_to(estimate).as_posix(): modules_of_estimate(path) for path in estimate.rglob("*.py")}
    assert not {name for name, used in counts.items() if len(used) > MOST_IMPORTS}


def test_every_module_of_the_package_has_a_layer() -> None:
    modules = (
        path for path in (ROOT / "smoother").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    )
    names = {path.stem for path in modules}
    assert names - {"__init__"} <= set(LAYERS)


def test_only_the_command_line_imports_the_calibration_procedures() -> None:
    for path in (ROOT / "smoother").rglob("*.py"):
        if "cli" not in path.relative_to(ROOT).parts:
            assert not [module for module in imported_modules(path) if module.split(".")[0] == "calib"], path


def test_the_calibration_procedures_use_nothing_above_fit() -> None:
    above = set(LAYERS[LAYERS.index("fit") + 1 :])
    for path in (ROOT / "calib").rglob("*.py"):
        layers = {module.split(".")[1] for module in imported_modules(path) if module.startswith("smoother.")}
        assert not layers & above, path


def test_only_the_command_line_prints() -> None:
    for path in (ROOT / "smoother").rglob("*.py"):
        if "cli" in path.relative_to(ROOT).parts:
            continue
        calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
        assert not [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "print"], path


@pytest.mark.parametrize(("library", "owner"), [("pynmea2", "session/nmea.py"), ("matplotlib", "report")])
def test_a_library_has_one_owner(library: str, owner: str) -> None:
    for path in (ROOT / "smoother").rglob("*.py"):
        if any(module.split(".")[0] == library for module in imported_modules(path)):
            assert path.relative_to(ROOT / "smoother").as_posix().startswith(owner), path
