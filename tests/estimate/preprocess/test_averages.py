"""Sums of samples are made once for all who ask, and are gone with the samples."""

import gc
import weakref

import numpy as np
import pytest

from smoother.estimate.preprocess import streams as averages
from smoother.estimate.preprocess.streams import averages_of
from smoother.samples import ImuSamples


def samples() -> ImuSamples:
    t = np.arange(0.0, 10.0, 0.01)
    return ImuSamples(t, np.tile([1.0, 2.0, 3.0], (len(t), 1)), np.stack([t, t, t], axis=1))


def test_who_asks_for_the_same_samples_gets_the_same_sums() -> None:
    imu = samples()
    known = averages_of(imu)
    assert averages_of(imu) is known and averages_of(samples()) is not known
    force, rate = known.around(np.array([5.0]), 1.0)
    np.testing.assert_allclose(force, [[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(rate, [[5.0, 5.0, 5.0]], atol=0.01)


def test_sums_are_gone_with_their_samples() -> None:
    imu = samples()
    known = weakref.ref(averages_of(imu))
    del imu
    gc.collect()
    assert known() is None


def test_those_of_a_day_are_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(averages, "SHARED", 500)
    imu = samples()
    assert averages_of(imu) is not averages_of(imu)
