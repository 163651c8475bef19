"""Figures that stand in several documents, or in a document and in the code, are the same in all of them."""

import re
from collections import Counter
from pathlib import Path

import pytest

from smoother.estimate.quality import QualityLimits
from smoother.live.lag import LagOptions
from smoother.live.navigator import IDENTIFY_AFTER
from smoother.units import DEG, KMH

ROOT = Path(__file__).resolve().parent.parent
IN_WORDS = {"four": 4.0, "five": 5.0, "a fifth": 0.2}


def text_of(name: str) -> str:
    """The text of a document, in one line."""
    return " ".join((ROOT / name).read_text(encoding="utf-8").split())


def numbers(name: str, pattern: str) -> list[float]:
    """What the groups of a pattern are in a document, as numbers."""
    match = re.search(pattern, text_of(name))
    assert match is not None, f"{name} does not say {pattern!r}"
    return [IN_WORDS[word] if word in IN_WORDS else float(word) for word in match.groups()]


def test_effects_are_counted_as_the_ablations_list_them() -> None:
    table = (ROOT / "docs" / "ablations.md").read_text(encoding="utf-8").partition("## Verdicts")[2]
    verdicts = [line.split(" | ", 1)[1] for line in table.partition("\nTaken out")[0].splitlines() if " | " in line][1:]
    kinds = Counter(re.split(r"\W", verdict.removeprefix("was "))[0] for verdict in verdicts)
    assert kinds.keys() == {"earned", "nothing"} and kinds["nothing"] == 1
    said = r"\| (\d+) on simulated sessions of [\w-]+ kinds.*?: (\d+) earned, one \("
    assert numbers("docs/accuracy.md", said) == [len(verdicts), kinds["earned"]]


@pytest.mark.parametrize("interval", ["1", "2", "5"])
def test_thinned_karts_are_as_far_off_in_the_readme_as_in_their_table(interval: str) -> None:
    adria, lignano = numbers("docs/accuracy.md", rf"\| {interval} s \| ([\d.]+) \| [\d.]+ \| ([\d.]+) \| [\d.]+ \|")
    places = {"1": 3, "5": 2}
    if interval in places:
        said = rf"in [15] s: [^|]*?{adria:.{places[interval]}f} m \(Adria\), ([\d.]+) m \(Lignano\)"
        assert numbers("README.md", said) == [round(lignano, places[interval])]


def test_the_gate_is_described_by_its_limits() -> None:
    limits, gate = QualityLimits(), "The gate fails a result.*?"
    for said, values in {
        r"more than (\d+) % of the fixes, or for longer than (\d+) s, than (\d+) m and than (\d+) sigma": (
            *(100.0 * limits.far_share, limits.far_seconds, limits.near_fix, limits.near_fix_sigmas),
        ),
        r"found in the fixes up to (\d+) m": (limits.fix_sigma,),
        r"stand otherwise by ([\d.]+) degrees from some moment on, or rock by more than (\d+) degrees": (
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
        assert numbers("README.md", gate + said) == pytest.approx(list(values))
    (fastest,) = numbers("README.md", gate + r"at more than (\d+) km/h")
    assert round(limits.top_speed / KMH, -1) == fastest
    assert numbers("docs/hard_sessions.md", r"so for sessions of (\d+) s and more") == [limits.parked_seconds]


def test_the_live_view_begins_when_the_readme_says() -> None:
    said = r"After (\d+) s of driving the batch.*?again after (\d+), (\d+), (\d+), (\d+), (\d+) and (\d+) s"
    assert tuple(numbers("README.md", said)) == IDENTIFY_AFTER
    assert numbers("README.md", r"fixed-lag smoother \(GTSAM, (\d+) s\)") == [LagOptions().lag]
