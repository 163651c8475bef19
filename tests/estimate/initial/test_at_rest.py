"""Velocities at rest, and what they tell of the bias of those on the drive."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.initial import guess
from smoother.estimate.initial.first_noise import LASTS, USUAL_SHARE, scale_at_rest
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset

from ..smoothed import horizontal_rms, smoothed

T = 0.1 * np.arange(6000)
AT_REST = (T % 200.0) < 60.0


def velocities(lasting: float, white: float, rng: np.random.Generator) -> np.ndarray:
    """Velocities (N, 3) that err by `lasting` m/s, anew in every stand and for 20 s of it, and by `white` m/s."""
    piece = (T // 20.0).astype(int)
    return lasting * rng.normal(size=(piece[-1] + 1, 3))[piece] + white * rng.normal(size=(len(T), 3))


class TestScale:
    def test_white_noise_counts_one_by_one(self) -> None:
        assert scale_at_rest(T, velocities(0.0, 0.01, np.random.default_rng(0)), AT_REST) < 4.0  # of 14

    def test_what_lasts_counts_as_one(self) -> None:
        scale = scale_at_rest(T, velocities(0.01, 1e-4, np.random.default_rng(0)), AT_REST)
        assert scale == pytest.approx(np.sqrt(LASTS / 0.1), rel=0.1)

    def test_their_mean_is_as_sure_as_it_is(self) -> None:
        """Variance of the mean of 20 s, by many draws, beside that of as many white ones of a greater sigma."""
        rng = np.random.default_rng(1)
        draws = [velocities(0.01, 0.02, rng) for _ in range(40)]
        means = [draw[i : i + 200, :2].mean(axis=0) for draw in draws for i in range(0, 6000, 200)]
        scale = np.mean([scale_at_rest(T, draw, AT_REST) for draw in draws])
        assert scale * np.hypot(0.01, 0.02) / np.sqrt(200) == pytest.approx(np.std(means), rel=0.15)

    def test_a_short_stand_is_as_those_of_others(self) -> None:
        few = np.arange(len(T)) < 10
        usual = np.sqrt(1.0 + USUAL_SHARE * (LASTS / 0.1 - 1.0))
        assert scale_at_rest(T, velocities(0.0, 0.01, np.random.default_rng(0)), few) == pytest.approx(usual, rel=0.1)
        assert scale_at_rest(T, np.zeros((len(T), 3)), AT_REST) == pytest.approx(usual, rel=0.1)  # it holds its speed
        assert scale_at_rest(T, np.full((len(T), 3), np.nan), AT_REST) == pytest.approx(usual, rel=0.1)
        assert scale_at_rest(T[:1], np.zeros((1, 3)), AT_REST[:1]) == 1.0


def test_an_error_of_the_velocities_at_rest_does_not_move_the_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    changes = {"motion_standstill": 40.0, "gnss_velocity_sigma": 0.02, "gnss_offset_horizontal": 0.6}
    simulation = simulate_preset("kart", 4, duration=240.0, **changes)
    session = prepare(simulation.raw)
    gnss = session.gnss
    wrong = np.where((gnss.t < gnss.t[0] + 38.0)[:, None], [0.03, -0.02, 0.0], 0.0)
    session = replace(session, gnss=replace(gnss, velocity_n=gnss.velocity_n + wrong))

    def sliding() -> float:
        """How fast the drive moves aside, m/s."""
        s = smoothed(simulation, session)
        return horizontal_rms(s.velocity_error_n[s.trajectory.t > 45.0].mean(axis=0)[None])

    assert (held := sliding()) < 0.012
    monkeypatch.setattr(guess, "scale_at_rest", lambda *_: 1.0)
    assert sliding() > 1.5 * held
