"""LAPACK's routines come alone, and are those of SciPy."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.linalg import lapack

import smoother.estimate.lapack as ours

BAND = np.array([[2.0, 3.0, 4.0], [1.0, 1.0, 0.0]])


def test_the_routines_are_those_of_scipy() -> None:
    factor, failed = ours.lapack_routines().dpbtrf(BAND, lower=1)
    expected, _ = lapack.dpbtrf(BAND, lower=1)
    assert failed == 0
    np.testing.assert_array_equal(factor, expected)


def test_where_the_extension_is_not_found_the_whole_package_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ours, "EXTENSION", "_elsewhere")
    assert ours.lapack_routines() is lapack


def test_smoothing_fixes_does_not_wait_for_the_rest_of_scipy_and_numpy() -> None:
    modules = "smoother.estimate.gnss_chains, smoother.estimate.smoother, smoother.laps.analysis"
    slow = "{'scipy.linalg', 'scipy.interpolate', 'scipy.signal', 'numpy.f2py'}"
    code = f"import {modules}, sys; print({slow} & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "set()"
