"""The table of problem codes holds every code that the sources report, and no other; the page is made from it."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from smoother.problems import ANY_STREAM, BEGIN, END, STREAMS, document, explain, explanations, remedy, sections

ROOT = Path(__file__).resolve().parent.parent
SOURCES = [path for folder in ("smoother", "calib") for path in sorted((ROOT / folder).rglob("*.py"))]
TREES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}
# the argument that is the code, by the name of what is called
REPORTING = {"Problem": 0, "Check": 0, "say": 0, "drop": 1}
FILES = ("imu.csv", "gps.csv", "official.csv", "wheel_speed.csv", "magcalib.txt", "micros()")  # may begin a sentence
OF_ROWS = ("say", "drop")  # methods of rows, which put the stream before the code


def named_strings() -> dict[str, set[str]]:
    """Texts of module constants by name, `A, B = "a", "b"` as well."""
    found: dict[str, set[str]] = {}
    for tree in TREES.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.Assign):
                targets, values = (
                    part.elts if isinstance(part, ast.Tuple) else [part] for part in (node.targets[0], node.value)
                )
                for target, value in zip(targets, values, strict=False):
                    if (
                        isinstance(target, ast.Name)
                        and isinstance(value, ast.Constant)
                        and isinstance(value.value, str)
                    ):
                        found.setdefault(target.id, set()).add(value.value)
    return found


NAMED = named_strings()


def codes_in(node: ast.expr) -> Iterator[str]:
    """Codes that an argument may be; `*` stands for what is put in. None of a variable."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.Name) and node.id.isupper():
        yield from NAMED[node.id]
    elif isinstance(node, ast.IfExp):
        yield from (*codes_in(node.body), *codes_in(node.orelse))
    elif isinstance(node, ast.JoinedStr):
        yield "".join(str(part.value) if isinstance(part, ast.Constant) else "*" for part in node.values)


def reported() -> list[tuple[str, str]]:
    """(where, code or its pattern) of every code that a call of the sources names."""
    found = []
    for path, tree in TREES.items():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            place = REPORTING.get(name)
            if place is None or len(node.args) <= place or (name in OF_ROWS and path.parent.name != "session"):
                continue
            stream = "*_" if name in OF_ROWS else ""
            found += [(f"{path.relative_to(ROOT)}:{node.lineno}", stream + code) for code in codes_in(node.args[place])]
    return found


def is_known(code: str) -> bool:
    """Whether a code, or what a pattern stands for, is in the table."""
    if explain(code) is not None:
        return True
    pattern = re.compile(re.escape(code).replace(r"\*", r"\w+"))
    return code.strip("*_") != "" and any(
        pattern.fullmatch(each) for known in explanations() for each in ([known, *of_streams(known)])
    )


def of_streams(code: str) -> list[str]:
    return [f"{stream}_{code.removeprefix(ANY_STREAM)}" for stream in STREAMS] if code.startswith(ANY_STREAM) else []


def test_every_code_that_is_reported_is_in_the_table() -> None:
    codes = reported()
    assert len(codes) > 100
    assert not [found for found in codes if found[1].strip("*_") and not is_known(found[1])]


def test_codes_of_the_golden_table_are_in_the_table() -> None:
    found = {
        code
        for path in (ROOT / "tests" / "golden" / "present").glob("*.txt")
        for code in re.findall(r"\bproblem\.(\w+)", path.read_text(encoding="utf-8"))
    }
    assert len(found) > 40
    assert not [code for code in found if explain(code) is None]


@pytest.mark.parametrize("code", explanations())
def test_every_code_of_the_table_is_in_the_sources(code: str) -> None:
    """As a whole, or as the part that follows the stream or another prefix."""
    texts = {
        node.value
        for tree in TREES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    whole = code.removeprefix(ANY_STREAM)
    parts = [whole, *(whole.removeprefix(f"{head}_") for head in (*STREAMS, "log"))]
    pieces = {whole[i:] for i, c in enumerate(whole) if c == "_"}  # of a text that is put together
    assert texts & {
        *(of_streams(code) or [code]),
        *pieces,
        *parts,
        *(f"_{part}" for part in parts),
        *(part.upper() for part in parts),
    }


def test_an_entry_is_made_of_sentences() -> None:
    for entry in explanations().values():
        for text in (entry.meaning, entry.cause, entry.remedy):
            assert text == text.strip()
            assert not text or (text[-1] == "." and text[0].islower() <= (text.split()[0].rstrip(",:;") in FILES))
        assert entry.meaning
        assert entry.cause


def test_codes_stand_once() -> None:
    assert sum(len(codes) for codes in sections().values()) == len(explanations())


def test_a_code_of_a_stream_has_the_entry_of_all_streams_but_where_it_has_its_own() -> None:
    assert explain("imu_gap") is explain("mag_gap") is not None
    assert explain("gps_gap") is not explain("imu_gap")
    assert explain("unheard_of") is None
    assert remedy("gps_no_fix").startswith("Wait")
    assert remedy("gps_null_island") == remedy("unheard_of") == ""


def test_the_page_is_made_from_the_table() -> None:
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    between = page.partition(BEGIN)[2].partition(END)[0].strip()
    assert between == document().strip(), "run `python -m smoother.problems`"
