"""Roll on level ground, over whole sessions."""

import numpy as np

from smoother.estimate.smoother import GraphSmoother
from smoother.units import DEG

from .roads import unlevel_track


def test_roll_of_a_level_track_is_as_sure_as_its_samples_make_it() -> None:
    track = unlevel_track(fall=0.0, varies=0.0)
    found = GraphSmoother().estimate(track.session)
    assert found.sigmas is not None
    off = found.euler[:, 0] - np.interp(found.t, track.t, track.roll)
    driving = (found.t > 5.0) & (found.t < track.t[-1] - 5.0)
    assert 0.5 < np.sqrt(np.mean((off / found.sigmas.attitude[:, 0])[driving] ** 2)) < 1.5
    assert np.median(found.sigmas.attitude[driving, 0]) < 0.12 * DEG
