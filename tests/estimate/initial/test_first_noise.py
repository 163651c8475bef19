"""Noise to start from, where a receiver says how accurate its fixes are."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.factors.graph import GraphOptions
from smoother.estimate.fixes.offset import reported_share
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import simulate_preset


@pytest.fixture(scope="module")
def session() -> Session:
    return prepare(simulate_preset("white", 3, duration=40.0, imu=None, mag=None).raw)


@pytest.mark.parametrize(("claimed", "share"), [(0.5, 0.25), (4.0, 1.0), (5.6, 1.0), (9.0, 1.59), (100.0, 10.0)])
def test_a_receiver_that_reports_a_far_larger_error_is_accepted(session: Session, claimed: float, share: float) -> None:
    """Receivers say half to twice what they are off by: within that others tell, beyond it is the receiver's own."""
    reported = np.full(len(session.gnss), claimed)
    told = replace(session, gnss=replace(session.gnss, sigma_horizontal=reported))
    assert reported_share(told.gnss, GraphOptions().offset_sigma[0]) == pytest.approx(share, rel=0.01)
