"""No function of the firmware has its value dropped without saying so with a cast to void.

Calls through the drivers' structs of functions count as well, which no warning of a compiler covers.
"""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import clang.cindex as clang
import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
PARTS = ("core", "drivers", "app", "port/stm32f103")
SOURCES = [path for part in PARTS for path in sorted((FIRMWARE / part).glob("*.c"))]
HARMLESS = {"memcpy", "memset"}  # they return what they were given
KIND = clang.CursorKind
FIRST_STATEMENT = {  # children of a statement from this on are statements; the condition stands before them
    KIND.COMPOUND_STMT: 0,
    KIND.DEFAULT_STMT: 0,
    KIND.DO_STMT: 0,
    KIND.FOR_STMT: 0,
    KIND.CASE_STMT: 1,
    KIND.IF_STMT: 1,
    KIND.WHILE_STMT: 1,
}
ATOMICS = """
#include <stdint.h>
typedef _Atomic(uint_fast32_t) atomic_uint_fast32_t;
typedef _Atomic(_Bool) atomic_bool;
#define memory_order_relaxed __ATOMIC_RELAXED
#define memory_order_acquire __ATOMIC_ACQUIRE
#define memory_order_release __ATOMIC_RELEASE
#define atomic_load_explicit __c11_atomic_load
#define atomic_store_explicit __c11_atomic_store
#define atomic_init __c11_atomic_init
"""
sys.path.insert(0, str(FIRMWARE))
import build  # noqa: E402


@pytest.fixture(scope="module")
def arguments(tmp_path_factory) -> list[str]:
    """Arguments with which the sources can be parsed; the parser comes without a compiler's own headers."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("needs system package gcc")
    headers = tmp_path_factory.mktemp("headers")
    (headers / "stdatomic.h").write_text(ATOMICS)
    (headers / "firmware_hash.h").write_text("#define FIRMWARE_HASH {0}\n")
    fatfs = build.find_fatfs(build.FATFS_CACHE)
    shutil.copy(fatfs / "ff.h", headers)
    shutil.copy(fatfs / "diskio.h", headers)
    own = subprocess.run([compiler, "-print-file-name=include"], capture_output=True, text=True, check=True).stdout
    places = [f"-I{headers}", *(f"-I{FIRMWARE / part}" for part in PARTS), "-isystem", own.strip()]
    return ["-std=c11", "-w", *places]


def dropped(path: Path, arguments: list[str]) -> Iterator[str]:
    """Each call in a file that stands as a statement though it has a value, as "line: function"."""
    unit = clang.Index.create().parse(str(path), args=arguments)
    errors = [str(one) for one in unit.diagnostics if one.severity >= clang.Diagnostic.Error]
    assert errors == []
    for node in unit.cursor.walk_preorder():
        if node.kind in FIRST_STATEMENT and node.location.file and node.location.file.name == str(path):
            for statement in list(node.get_children())[FIRST_STATEMENT[node.kind] :]:
                while statement.kind == KIND.PAREN_EXPR:
                    (statement,) = statement.get_children()
                is_call = statement.kind == KIND.CALL_EXPR and statement.spelling not in HARMLESS
                if is_call and statement.type.kind != clang.TypeKind.VOID:
                    yield f"{statement.location.line}: {statement.spelling}"


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_no_value_is_dropped(path, arguments):
    assert list(dropped(path, arguments)) == []


@pytest.mark.parametrize(
    ("name", "right", "wrong", "found"),
    [
        ("drivers/sdcard.c", "(void)receive(", "receive(", "receive"),
        ("drivers/sdcard.c", "    if (bus->start(", "    bus->is_done(bus->context);\n    if (bus->start(", "is_done"),
        ("app/journal.c", "LOCKED(app, (void)log_writer_event(", "LOCKED(app, log_writer_event(", "log_writer_event"),
        ("app/stream.c", "(void)serial_put(", "serial_put(", "serial_put"),
    ],
)
def test_value_dropped_on_purpose_is_found(arguments, tmp_path, name, right, wrong, found):
    text = (FIRMWARE / name).read_text()
    assert right in text
    changed = tmp_path / "changed.c"
    changed.write_text(text.replace(right, wrong, 1))
    assert [row.split()[-1] for row in dropped(changed, arguments)] == [found]
