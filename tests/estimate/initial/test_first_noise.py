"""Noise to start from, where a receiver says how accurate its fixes are."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.factors.graph import GraphOptions
from smoother.estimate.fixes.offset import reported_share
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import simulate_preset

CENTIMETRES, METRES = 0.02, 1.5


@pytest.fixture(scope="module")
def session() -> Session:
    return prepare(simulate_preset("white", 3, duration=40.0, imu=None, mag=None).raw)


def claiming(session: Session, corrected: float) -> Session:
    """The session with corrections for that share of the fixes, from the first one on."""
    n = len(session.gnss)
    reported = np.where(np.arange(n) < corrected * n, CENTIMETRES, METRES)
    return replace(session, gnss=replace(session.gnss, sigma_horizontal=reported))


@pytest.mark.parametrize("corrected", [0.0, 0.45, 0.55, 0.65, 0.8])
def test_centimetres_do_not_count_for_fixes_that_lost_their_corrections(session: Session, corrected: float) -> None:
    share = reported_share(claiming(session, corrected).gnss, GraphOptions().offset_sigma[0])
    assert share == reported_share(claiming(session, 0.0).gnss, GraphOptions().offset_sigma[0])


def test_few_fixes_without_corrections_do_not_spoil_those_with_them(session: Session) -> None:
    assert reported_share(claiming(session, 0.95).gnss, GraphOptions().offset_sigma[0]) == reported_share(
        claiming(session, 1.0).gnss, GraphOptions().offset_sigma[0]
    )


def test_fixes_that_are_some_times_worse_than_usual_are_of_the_same_receiver(session: Session) -> None:
    reported = np.where(np.arange(len(session.gnss)) % 3 == 0, 3.0 * METRES, METRES)
    uneven = replace(session, gnss=replace(session.gnss, sigma_horizontal=reported))
    assert reported_share(uneven.gnss, GraphOptions().offset_sigma[0]) == reported_share(
        claiming(session, 0.0).gnss, GraphOptions().offset_sigma[0]
    )


@pytest.mark.parametrize(("claimed", "share"), [(0.5, 0.25), (4.0, 1.0), (5.6, 1.0), (9.0, 1.59), (100.0, 10.0)])
def test_a_reported_accuracy_far_worse_than_usual_counts(session: Session, claimed: float, share: float) -> None:
    """Receivers report half to twice their error: within that the usual counts, beyond it the report."""
    reported = np.full(len(session.gnss), claimed)
    reporting = replace(session, gnss=replace(session.gnss, sigma_horizontal=reported))
    assert reported_share(reporting.gnss, GraphOptions().offset_sigma[0]) == pytest.approx(share, rel=0.01)
