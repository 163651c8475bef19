"""What is installed from the wheel: whole, complete in its dependencies, and able to run away from the checkout.

`make install-check` does the same with dependencies of its own, and `make bounds` on every Python and at both ends of
the bounds; here the wheel borrows the dependencies of the environment that the tests run in.
"""

import ast
import importlib.util
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from email import message_from_bytes
from email.message import Message
from pathlib import Path
from types import ModuleType

import numpy
import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
PACKAGES = ("smoother", "calib")
IMPORTED_AS = {
    "serial": "pyserial",
    "PIL": "pillow",
    "mpl_toolkits": "matplotlib",
    "dask": "distributed",
    "py_gpmf_parser": "py-gpmf-parser",
}
OF_RUNNING = ("dask", "aim", "gopro", "fit")  # extras that a user installs
PERMISSIVE = re.compile(r"BSD|MIT|Apache|Python Software Foundation|PSF|Zlib|HPND")


def _of_ci(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / ".ci" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


install_check, listing = _of_ci("install_check"), _of_ci("dependencies")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    try:
        built: Path = install_check.build_wheel(tmp_path_factory.mktemp("wheel"))
    except install_check.CheckError as error:
        if "No matching distribution found for setuptools" in str(error):
            pytest.skip("no package index to build the wheel with")
        raise
    return built


@pytest.fixture(scope="module")
def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return message_from_bytes(archive.read(name))


def shipped_files() -> set[str]:
    paths = (path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file())
    return {path.relative_to(ROOT).as_posix() for path in paths if "__pycache__" not in path.parts}


def imports() -> Iterator[tuple[str, str]]:
    """Each name imported from outside the project and the standard library, with the file that does so."""
    for name in (name for name in shipped_files() if name.endswith(".py")):
        for node in ast.walk(ast.parse((ROOT / name).read_text(encoding="utf-8"))):
            modules = (
                [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else []
            )
            for module in modules:
                top = module.partition(".")[0]
                if top not in sys.stdlib_module_names and top not in PACKAGES:
                    yield top, name


def test_wheel_holds_every_file_of_the_package_and_no_other(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        files = {name for name in archive.namelist() if ".dist-info/" not in name}
        licences = [name for name in archive.namelist() if name.endswith("licenses/LICENSE")]
    assert files == shipped_files()
    assert len(licences) == 1


def test_wheel_is_for_every_system_and_lists_what_it_needs(wheel: Path, metadata: Message) -> None:
    assert wheel.name.endswith("-py3-none-any.whl")
    assert metadata["Requires-Python"] == ">=3.11"
    assert metadata["License-Expression"] == "MIT"
    for line in metadata.get_all("Requires-Dist", []):
        requirement = Requirement(line)
        if requirement.marker is None:
            operators = {specifier.operator for specifier in requirement.specifier}
            assert operators == {">=", "<"}, f"{requirement.name} lacks a bound"


def test_every_import_is_of_a_declared_dependency() -> None:
    project = tomllib.loads(PYPROJECT)["project"]
    extras = (line for extra in OF_RUNNING for line in project["optional-dependencies"][extra])
    declared = {Requirement(line).name for line in (*project["dependencies"], *extras)}
    found = {(IMPORTED_AS.get(top, top), name) for top, name in imports()}
    assert {(top, name) for top, name in found if top not in declared} == set()
    assert {"gtsam", "numpy", "pyserial"} <= {top for top, _ in found}


def test_demo_runs_from_the_wheel_outside_the_checkout(wheel: Path, tmp_path: Path) -> None:
    venv = tmp_path / "venv"
    install_check.run([sys.executable, "-m", "venv", "--without-pip", venv], tmp_path)
    python = venv / "bin" / "python"
    command = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index", wheel]
    install_check.run(command, tmp_path)
    # a folder on PYTHONPATH lends its packages, but not the link that an editable installation is
    borrowed = {"PYTHONPATH": str(Path(numpy.__file__).parents[1])}
    install_check.try_demo(venv / "bin", tmp_path, 20.0, **borrowed)


def test_check_fails_where_the_package_is_not_that_of_the_environment(tmp_path: Path) -> None:
    programs = tmp_path / "bin"
    programs.mkdir()
    (programs / "python").symlink_to(sys.executable)
    with pytest.raises(install_check.CheckError, match="is not of the environment"):
        install_check.try_demo(programs, tmp_path, 20.0, PYTHONPATH=str(ROOT))


def test_every_place_that_names_the_supported_pythons_names_the_same() -> None:
    supported = [".".join(map(str, version)) for version in install_check.SUPPORTED]
    said = f"{supported[0]} to {supported[-1]}"
    for name in ("README.md", "Makefile", ".ci/venv.sh"):
        assert f"Python {said}" in (ROOT / name).read_text(encoding="utf-8"), name
    venv = (ROOT / ".ci" / "venv.sh").read_text(encoding="utf-8")
    assert "(3, 11) <= sys.version_info[:2] <= (3, 14)" in venv
    for version in supported:
        assert f"python{version}" in venv


def test_page_of_dependencies_is_that_of_the_project() -> None:
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    extras = tomllib.loads(PYPROJECT)["project"]["optional-dependencies"]
    assert set(extras) == set(listing.EXTRAS)
    for extra in (None, *extras):
        for row in listing.dependencies(PYPROJECT, extra):
            assert row.why, f"pyproject.toml does not say why {row.name} is needed"
            assert re.search(
                rf"^\| {row.name} \| {row.bounds} \| .+ \| {re.escape(row.why)} \|$", page, re.MULTILINE
            ), f"docs/dependencies.md is not of today as to {row.name}: make dependencies"


def test_what_is_installed_with_the_program_may_be_used_by_anybody() -> None:
    direct = [row.name for row in listing.dependencies(PYPROJECT)]
    along = listing.brought_along(direct)
    assert {"cycler", "pygments"} <= along.keys()
    for name in (*direct, *along):
        licence = listing.licence(name)
        assert PERMISSIVE.search(licence) and "GPL" not in licence, f"{name}: {licence}"


def test_container_is_made_of_what_the_wheel_is_made_of() -> None:
    copied = re.findall(r"^COPY (.+) \S+$", (ROOT / "Containerfile").read_text(encoding="utf-8"), re.MULTILINE)
    assert {word.rstrip("/") for row in copied for word in row.split() if not word.startswith("--")} == set(
        install_check.SHIPPED
    )


def test_make_offers_the_checks() -> None:
    for target in ("install-check", "bounds", "dependencies", "audit"):
        done = subprocess.run(
            ["make", target, "--dry-run"], cwd=ROOT, env=os.environ, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
