"""Roll on ground that is not level across, over whole sessions."""

from dataclasses import replace

import numpy as np

from smoother.estimate.smoother import GraphSmoother
from smoother.units import DEG

from .roads import unlevel_track


def test_roll_holds_where_a_track_is_not_level_across() -> None:
    """It is off by the mean of the lap, 0.8 deg: 6 sigmas, where only the fit of the mounting tells how unsure."""
    track = unlevel_track(fall=1.2 * DEG, varies=1.0 * DEG)
    found = GraphSmoother().estimate(track.session)
    assert found.sigmas is not None
    off = found.euler[:, 0] - np.interp(found.t, track.t, track.roll)
    driving = (found.t > 5.0) & (found.t < track.t[-1] - 5.0)
    assert np.abs(np.mean(off[driving])) > 0.5 * DEG
    assert np.sqrt(np.mean((off / found.sigmas.attitude[:, 0])[driving] ** 2)) < 1.6
    sigma = found.report.identified["R_bs"].sigma
    assert isinstance(sigma, list)
    assert sigma[0] > 0.6 * DEG > 0.2 * DEG > sigma[1]
    stated = replace(track.session.config.mounting, R_bs=np.array(found.report.identified["R_bs"].value))
    session = replace(track.session, config=replace(track.session.config, mounting=stated))
    told = GraphSmoother().estimate(session).sigmas
    assert told is not None
    assert np.median(told.attitude[:, 0]) < 0.2 * DEG  # whoever says how the box lies has levelled it himself


def test_roll_of_a_level_track_is_as_sure_as_its_samples_make_it() -> None:
    track = unlevel_track(fall=0.0, varies=0.0)
    found = GraphSmoother().estimate(track.session)
    assert found.sigmas is not None
    off = found.euler[:, 0] - np.interp(found.t, track.t, track.roll)
    driving = (found.t > 5.0) & (found.t < track.t[-1] - 5.0)
    assert 0.5 < np.sqrt(np.mean((off / found.sigmas.attitude[:, 0])[driving] ** 2)) < 1.5
    assert np.median(found.sigmas.attitude[driving, 0]) < 0.12 * DEG
