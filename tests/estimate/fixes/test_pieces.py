"""Long sessions hour by hour: the path of the whole, and no seam in it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from smoother.estimate.fixes import pieces
from smoother.estimate.fixes.path import GnssPath, fit_gnss_path
from smoother.estimate.fixes.pieces import fit_path
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.scenario import Interval
from smoother.sim.simulation import simulate_preset

LENGTH = 900.0  # s


def drive(**changes: Any) -> Session:
    changes = {"gnss_outages": (), **changes}
    return prepare(simulate_preset("kart", 4, duration=LENGTH, imu=None, mag=None, **changes).raw)


def in_pieces(session: Session, monkeypatch: pytest.MonkeyPatch) -> GnssPath:
    monkeypatch.setattr(pieces, "PIECE", LENGTH / 3.0)
    monkeypatch.setattr(pieces, "LONG", LENGTH / 2.0)
    return fit_path(session)


def test_a_session_of_usual_length_is_one_piece() -> None:
    session = drive()
    np.testing.assert_array_equal(fit_path(session).position_n, fit_gnss_path(session).position_n)


def test_pieces_make_the_path_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    session = drive()
    whole, parts = fit_gnss_path(session), in_pieces(session, monkeypatch)
    t = np.arange(session.gnss.t[0], session.gnss.t[-1], 0.1)
    one, two = whole.at(t), parts.at(t)
    # white noise of the fixes is 0.2 m and 0.15 m/s: what differs is the noise and the lag found in a third of them
    assert np.sqrt(np.mean((two.track_n - one.track_n)[:, :2] ** 2)) < 0.05
    assert np.sqrt(np.mean((two.velocity_n - one.velocity_n)[:, :2] ** 2)) < 0.1
    assert np.max(np.abs(np.diff((two.track_n - one.track_n)[:, :2], axis=0))) < 0.1
    assert parts.velocity_lag.value == pytest.approx(whole.velocity_lag.value, abs=0.01)
    np.testing.assert_allclose(parts.position_sigma, whole.position_sigma, rtol=0.2)
    assert parts.position_weight.shape == whole.position_weight.shape


def test_an_hour_without_fixes_goes_with_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    session = drive(gnss_outages=(Interval(300.0, 320.0),))
    path = in_pieces(session, monkeypatch)
    assert np.all(np.diff(path.t) > 0.0)
    assert len(path.position_weight) == len(session.gnss)


def test_over_a_pause_of_hours_the_path_stays_where_it_stopped_with_a_large_sigma() -> None:
    session = drive()
    pause = 3.0 * pieces.PIECE
    late = session.gnss.t > 0.5 * LENGTH
    gnss = replace(session.gnss, t=session.gnss.t + np.where(late, pause, 0.0))
    path = fit_path(replace(session, gnss=gnss))
    begin, end = (float(gnss.t[each][i]) for each, i in ((~late, -1), (late, 0)))
    t = np.linspace(begin + 1.0, end - 1.0, 5000)
    motion, sigma = path.at(t), path.sigma_at(t)
    between = np.diff(path.at(np.array([begin, end])).track_n, axis=0)
    start_n = path.at(np.array([begin])).track_n
    share = (t[:, None] - begin) / (end - begin)
    assert np.max(np.abs(motion.track_n - start_n - share * between)[:, :2]) < 30.0
    assert np.max(np.abs(motion.velocity_n)) < 30.0
    assert np.min(sigma.track_n[2000:3000, :2]) > 500.0
    assert np.min(sigma.velocity_n[100:-100, :2]) > 5.0
    # outside the pause nothing is changed
    inside = np.arange(session.gnss.t[0] + 5.0, 0.5 * LENGTH - 5.0, 0.5)
    whole = fit_path(session)
    np.testing.assert_allclose(path.at(inside).track_n[:, :2], whole.at(inside).track_n[:, :2], atol=0.3)
