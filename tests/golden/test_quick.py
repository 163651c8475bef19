"""The quick rows of the golden table are what they were: what a change of the code moves shows here first."""

import pytest

from golden import DERIVED, PRESENT, RECORDED, STORED, default_bench, jobs_of, run_job
from golden_tables import beyond, changes, read_table, texts_of

QUICK = [(table, job.name) for table, jobs in jobs_of(recorded=True).items() for job in jobs if job.quick]


@pytest.mark.parametrize(("table", "name"), QUICK, ids=[f"{table}-{name}" for table, name in QUICK])
def test_row_is_that_of_the_present_table(table: str, name: str, request: pytest.FixtureRequest) -> None:
    if table in RECORDED:
        request.getfixturevalue("data_directory")
    done = run_job(default_bench(), table, name)
    stored, tolerances = read_table(STORED / PRESENT / f"{table}.txt")
    job = next(job for job in jobs_of(recorded=True)[table] if job.name == name)
    moved = beyond(changes(stored, texts_of(done.rows), tolerances, job.rows))
    said = "\n".join(str(change) for change in moved[:40])
    assert not moved, f"{len(moved)} values moved (python benchmarks/golden.py --only {table} shows all):\n{said}"


def test_every_job_is_in_both_stored_tables() -> None:
    for edition in ("first_edition", PRESENT):
        for table, jobs in jobs_of(recorded=True).items():
            stored = {row for row, _ in read_table(STORED / edition / f"{table}.txt")[0]}
            wanted = {row for job in jobs for row in job.rows}
            assert wanted <= stored, f"{edition}/{table}: rows are missing"
            assert table in DERIVED or stored == wanted, f"{edition}/{table}: rows that no job makes"
