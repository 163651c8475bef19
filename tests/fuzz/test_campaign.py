"""A bounded run of the campaign: the same seeds every time, some seconds of CPU. README.md: how to run it longer."""

from pathlib import Path

import numpy as np
import pytest
from fuzz_campaign import Outcome, check_command, check_readers, damaged
from fuzz_corpus import CORPUS, write_files
from fuzz_mutators import MUTATORS

READER_SEEDS = range(40)
COMMAND_SEEDS = range(1000, 1003)


@pytest.mark.parametrize("form", sorted(CORPUS))
def test_a_good_session_is_read(form: str, tmp_path: Path) -> None:
    assert check_readers(write_files(tmp_path / "session", CORPUS[form]())) == Outcome("read")


@pytest.mark.parametrize("form", sorted(CORPUS))
def test_a_damaged_session_is_read_or_refused_in_one_line(form: str, tmp_path: Path) -> None:
    for seed in READER_SEEDS:
        files, done = damaged(form, seed)
        outcome = check_readers(write_files(tmp_path / str(seed), files))
        assert outcome.kind != "finding", f"{form} {seed} ({done}): {outcome.text}"


@pytest.mark.parametrize("form", sorted(CORPUS))
def test_the_command_ends_with_the_right_exit_code(form: str, tmp_path: Path) -> None:
    for seed in COMMAND_SEEDS:
        files, done = damaged(form, seed)
        outcome = check_command(write_files(tmp_path / str(seed), files))
        assert outcome.kind != "finding", f"{form} {seed} ({done}): {outcome.text}"


COMMAND_FINDINGS = (
    ("columns", 39),
)  # covariance of samples that is none: the fixes alone are smoothed, and it is said


@pytest.mark.parametrize(("form", "seed"), COMMAND_FINDINGS)
def test_what_once_ended_the_command_with_a_traceback_no_longer_does(form: str, seed: int, tmp_path: Path) -> None:
    files, done = damaged(form, seed)
    outcome = check_command(write_files(tmp_path / "session", files))
    assert outcome.kind != "finding", f"{form} {seed} ({done}): {outcome.text}"


@pytest.mark.parametrize("mutator", MUTATORS, ids=lambda mutator: mutator.__name__)
def test_mutators_damage_and_repeat(mutator) -> None:
    data = CORPUS["columns"]()["gps.csv"]
    once, again = (mutator(data, np.random.default_rng(3)) for _ in range(2))
    assert once == again
    assert any(mutator(data, np.random.default_rng(seed)) != data for seed in range(5))
