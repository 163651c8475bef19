"""Every document: its links resolve, files that it names exist, scripts have its options, and figures a command.

The account of the quality gate is compared with the limits of the gate.
"""

import re
from pathlib import Path

import pytest

from smoother.estimate.judge.quality import QualityLimits
from smoother.units import DEG, KMH

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("", "docs", "firmware", "firmware/emulator", "tests/data", "tests/fuzz")
DOCUMENTS = [path for folder in FOLDERS for path in sorted((ROOT / folder).glob("*.md"))]
PRESENT = [path for path in DOCUMENTS if path.name != "CHANGELOG.md"]  # which names what there was
TOPS = [path for path in ROOT.iterdir() if path.name == ".ci" or not path.name.startswith(".")]
MODULES = [f"/{path.as_posix()}" for top in TOPS for path in top.rglob("*.py")]
MOST_LINES_OF_README, MOST_OF_ACCURACY, MOST_OF_ALL = 150, 15_000, 170_000  # lines, bytes, bytes
IN_WORDS = {"four": 4.0, "five": 5.0, "a fifth": 0.2}


def of_document(paths: list[Path]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("path", paths, ids=lambda path: path.relative_to(ROOT).as_posix())


def anchor(heading: str) -> str:
    """Where a link to a heading points, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", re.sub(r"\]\([^)]*\)", "]", heading).strip().lower()).replace(" ", "-")


def commands(text: str) -> list[str]:
    """Lines of the blocks of code, and code within sentences."""
    blocks = re.findall(r"^```\w*\n(.*?)^```|((?:^    .*\n)+)", text, re.MULTILINE | re.DOTALL)
    lines = [line for fenced, indented in blocks for line in (fenced or indented).splitlines()]
    prose = re.sub(r"^```\w*\n.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    return lines + [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose)]


@of_document(DOCUMENTS)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\((?!\w+:)([^)\s]+)\)", path.read_text(encoding="utf-8")):
        name, _, part = target.partition("#")
        linked = path.parent / name if name else path
        assert linked.exists(), target
        if part and linked.suffix == ".md":
            assert part in map(anchor, re.findall(r"^#+ (.*)$", linked.read_text(encoding="utf-8"), re.MULTILINE)), (
                target
            )


@of_document(PRESENT)
def test_python_files_that_are_named_exist(path: Path) -> None:
    for name in re.findall(r"[`\s(]((?:[\w.-]+/)*\w+\.py)\b", path.read_text(encoding="utf-8")):
        assert any(module.endswith(f"/{name}") for module in MODULES), name


@of_document(PRESENT)
def test_scripts_have_the_options_that_are_given_to_them(path: Path) -> None:
    for command in commands(path.read_text(encoding="utf-8")):
        script = re.search(r"(?:^|[ /])(\w+\.py) ", f"{command} ")
        found = list((ROOT / "benchmarks").glob(script[1])) if script else []
        for option in re.findall(r"(?<=\s)--[a-z][\w-]*", command) if found else ():
            assert f'"{option}"' in found[0].read_text(encoding="utf-8"), command


@of_document([path for path in PRESENT if path.parent.name == "docs" and path.name != "dependencies.md"])
def test_a_page_with_a_table_of_figures_has_a_command(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if re.search(r"^\|.*\d\.\d.*\|$", text, re.MULTILINE):
        assert any(re.search(r"\.py\b|^(smooth|make) ", command) for command in commands(text))


def numbers(name: str, pattern: str) -> list[float]:
    """What the groups of a pattern are in a document, as numbers."""
    match = re.search(pattern, " ".join((ROOT / name).read_text(encoding="utf-8").split()))
    assert match is not None, f"{name} does not say {pattern!r}"
    return [IN_WORDS[word] if word in IN_WORDS else float(word) for word in match.groups()]


def test_the_gate_is_described_by_its_limits() -> None:
    limits, gate = QualityLimits(), "The gate fails a result.*?"
    for said, values in {
        r"more than (\d+) % of the fixes, or for longer than (\d+) s, than (\d+) m and than (\d+) sigma": (
            *(100.0 * limits.far_share, limits.far_seconds, limits.near_fix, limits.near_fix_sigmas),
        ),
        r"error and noise found in the fixes up to (\d+) m": (limits.fix_sigma,),
        r"change by ([\d.]+) degrees from some moment on, or rock by more than (\d+) degrees": (
            *(limits.lean_step / DEG, limits.rattle / DEG),
        ),
        r"drives sideways for (a fifth) of the way, or (\d+) degrees off level": (
            *(limits.sideways_share, limits.overturned / DEG),
        ),
        r"hardly drove in (\d+) s or more, so that its heading is not known to (\d+) degrees": (
            *(limits.parked_seconds, limits.sigma_yaw / DEG),
        ),
        r"stays within (\d+) m at no clear speed": (limits.stood_radius,),
        r"sigma above (\d+) m; or of fewer than (\w+) fixes": (limits.sigma_horizontal, limits.fewest_fixes),
        r"more than (\d+) times their sigma, or more than (\d+) % of a kind rejected": (
            *(limits.normalised_rms, 100.0 * limits.rejected_share),
        ),
        r"Rows more than (\d+) s from any fix are not judged": (limits.near_seconds,),
    }.items():
        assert numbers("docs/troubleshooting.md", gate + said) == pytest.approx(list(values))
    (fastest,) = numbers("docs/troubleshooting.md", gate + r"at more than (\d+) km/h")
    assert round(limits.top_speed / KMH, -1) == fastest
    assert numbers("docs/accuracy.md", r"so for sessions of (\d+) s and more") == [limits.parked_seconds]


def test_the_entrance_is_a_page_and_the_documents_are_few() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= MOST_LINES_OF_README
    assert len((ROOT / "docs" / "accuracy.md").read_bytes()) <= MOST_OF_ACCURACY
    assert sum(len(path.read_bytes()) for path in DOCUMENTS if "firmware" not in path.parts) <= MOST_OF_ALL


def test_patterns_of_the_led_are_those_of_the_firmware() -> None:
    def patterns(name: str) -> set[str]:
        table = (ROOT / name).read_text(encoding="utf-8").partition("\n| LED |")[2].partition("\n\n")[0]
        return set(re.findall(r"^\| ([^|]*[^|\s-][^|]*) \|", table.partition("\n")[2], re.MULTILINE))

    shown = patterns("docs/troubleshooting.md")
    assert len(shown) == 7
    assert shown <= patterns("firmware/README.md")
