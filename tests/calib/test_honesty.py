"""A short form of benchmarks/calibration_honesty.py: are the sigmas honest?"""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

PATH = Path(__file__).resolve().parents[2] / "benchmarks" / "calibration_honesty.py"
RECORDINGS = 6


@pytest.fixture(scope="module")
def campaign():
    spec = importlib.util.spec_from_file_location("calibration_honesty", PATH)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look it up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_errors_of_handled_loggers_are_as_large_as_their_sigmas(campaign):
    pooled = {}
    for seed in range(1000, 1000 + RECORDINGS):  # others than those of the campaign
        for name, z in campaign.handled(seed).items():
            pooled.setdefault(name, []).append(z)
    assert len(pooled) >= 38
    tail = 0.0005 / len(pooled)
    for name, z in pooled.items():
        assert np.mean(np.square(z)) < chi2.isf(tail, len(z)) / len(z), name
    everything = np.concatenate([np.array(z) for z in pooled.values()])
    # 240 values, of which those of one recording are correlated
    assert 0.58 < np.mean(np.abs(everything) < 1.0) < 0.78
    assert np.mean(np.abs(everything) < 2.0) > 0.90


def test_the_report_names_what_lies_outside(campaign):
    good = np.random.default_rng(1).standard_normal(2000)
    text, passed = campaign.report({"good": good, "bad": 3.0 * good})
    assert not passed
    assert "| bad | 2000 | " in text
    assert text.count("**outside**") == 1
    assert campaign.report({"good": good})[1]
