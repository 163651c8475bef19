"""The delay of the force behind the rate: found where a box is turned under a force that stays, else nothing said."""

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.preprocess import force_delay as module
from smoother.estimate.preprocess.force_delay import (
    BANDS,
    FEWEST_BLOCKS,
    BandDelay,
    ForceDelay,
    band_delays,
    force_delay,
)
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

GRAVITY = np.array([0.0, 0.0, 9.8])
COLUMN = np.array([-0.77, 0.0, 0.64])
Samples = tuple[Array, Array, Array]


def tones(t: Array, low: float, high: float, sigma: float, rng: np.random.Generator) -> Array:
    """Noise between two frequencies, Hz, as a sum of tones: it can be had at any time."""
    count = 60
    frequency, phase = rng.uniform(low, high, count), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.asarray(sigma * np.sqrt(2.0 / count) * np.sin(2.0 * np.pi * np.outer(t, frequency) + phase).sum(axis=1))


def turned_box(
    seed: int,
    delay: float = 0.03,
    *,
    rate: float = 50.0,
    duration: float = 150.0,
    bends: tuple[float, float] = (0.3, 5.0),
) -> Samples:
    """Samples of a box on a wheel under gravity and bends, with white noise; the force comes `delay` s late.

    bends : Hz below which they pull, and how hard, m/s^2.
    """
    noise = np.random.default_rng(1000 + seed)
    t = np.arange(round(duration * rate)) / rate

    def at(when: Array) -> tuple[Array, Array]:
        rng = np.random.default_rng(seed)  # the same motion at other times
        pull = [tones(when, 0.02, bends[0], sigma, rng) for sigma in (2.0, bends[1])]
        angle = tones(when, 0.5, 7.0, 8.0 * DEG, rng)
        return np.stack([*pull, np.full(len(when), 9.8)], axis=1), angle

    step = 1e-4
    force_b, angle = at(t - delay)
    turning = (at(t + step)[1] - at(t - step)[1]) / (2.0 * step)
    force = np.einsum("nji,nj->ni", so3.exp(angle[:, None] * COLUMN), force_b)
    rate_s = turning[:, None] * COLUMN
    return t, force + 1.5 * noise.normal(size=force.shape), rate_s + 0.03 * noise.normal(size=force.shape)


@pytest.mark.parametrize("rate", [25.0, 50.0, 104.0, 200.0])
@pytest.mark.parametrize("delay", [0.055, 0.012, -0.03])
def test_a_delay_is_found_at_any_rate(rate: float, delay: float) -> None:
    found = force_delay(*turned_box(3, delay, rate=rate))
    assert found.is_found
    assert abs(found.delay - delay) < 4.0 * found.sigma
    assert found.sigma < 2e-3


def test_where_there_is_none_none_is_found_but_seen_to_be_none() -> None:
    found = force_delay(*turned_box(4, 0.0))
    assert found.is_seen
    assert not found.is_found
    assert abs(found.delay) < 4.0 * found.sigma


def test_sigmas_are_those_of_the_errors() -> None:
    z = [(found.delay - 0.03) / found.sigma for found in (force_delay(*turned_box(seed)) for seed in range(24))]
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.5  # of 24 draws the rms is known to 15 %


def test_bends_that_come_late_too_do_not_pull_the_delay_off() -> None:
    bends = (0.9, 15.0)  # which with their delay in them would pull it by 1.1 ms
    off = [force_delay(*turned_box(seed, 0.08, bends=bends)).delay - 0.08 for seed in range(6)]
    assert abs(np.mean(off)) < 0.5e-3


def test_each_band_finds_it() -> None:
    bands = band_delays(*turned_box(5, duration=300.0))
    assert [(band.low, band.high) for band in bands] == list(BANDS)
    for band in bands:
        assert band.holds
        assert abs(band.delay - 0.03) < 4.0 * band.sigma
        assert abs(band.size - 1.0) < 4.0 * band.size_sigma


def test_slow_samples_have_the_bands_that_fit() -> None:
    assert [band.high for band in band_delays(*turned_box(5, rate=12.5, duration=400.0))] == [1.0, 2.0, 4.0]


def test_the_axes_of_the_sensor_do_not_matter() -> None:
    t, force, rate = turned_box(6)
    R = so3.exp(np.array([0.4, -1.3, 2.0]))
    straight, askew = force_delay(t, force, rate), force_delay(t, force @ R, rate @ R)
    assert askew.delay == pytest.approx(straight.delay, rel=1e-6)
    assert askew.sigma == pytest.approx(straight.sigma, rel=1e-6)


def test_a_slow_filter_of_the_force_is_found_as_its_delay() -> None:
    t, force, rate = turned_box(7, 0.0, rate=200.0)
    window = 13  # whose mean is six samples late
    late = np.stack([np.convolve(force[:, i], np.full(window, 1.0 / window))[: len(t)] for i in range(3)], axis=1)
    found = force_delay(t, late, rate)
    assert found.is_found
    assert found.delay == pytest.approx(0.03, abs=2e-3)


def test_gaps_and_uneven_stamps_cost_nothing_but_samples() -> None:
    t, force, rate = turned_box(8, rate=100.0)
    kept = np.random.default_rng(0).random(len(t)) > 0.05
    kept[4000:4700] = False
    t = t + 2e-3 * np.sin(t)
    found = force_delay(t[kept], force[kept], rate[kept])
    assert found.is_found
    assert abs(found.delay - 0.03) < 4.0 * found.sigma


def test_of_a_long_session_the_part_with_most_turning_is_read() -> None:
    t, force, rate = turned_box(9, rate=25.0, duration=300.0)
    n = 40_000  # 27 min at rest before, as much as is read at most
    rng = np.random.default_rng(1)
    t = np.arange(n + len(t)) / 25.0
    force = np.concatenate([GRAVITY + rng.normal(size=(n, 3)), force])
    rate = np.concatenate([0.03 * rng.normal(size=(n, 3)), rate])
    found = force_delay(t, force, rate)
    assert found.is_found
    assert abs(found.delay - 0.03) < 4.0 * found.sigma


def test_a_force_of_another_size_than_the_turning_gives_no_delay() -> None:
    t, force, rate = turned_box(10)
    assert not force_delay(t, force, 0.5 * rate).is_seen  # a car leans half as much as its seat is thrown about
    assert not force_delay(t, force, 2.0 * rate).is_seen


def test_bands_that_contradict_each_other_say_nothing() -> None:
    t, force, rate = turned_box(11, 0.0)
    spectrum, frequency = np.fft.rfft(force, axis=0), np.fft.rfftfreq(len(t), t[1])
    delay = np.where(frequency > 2.0, 0.04, 0.0)  # s
    spectrum *= np.exp(-2j * np.pi * frequency * delay)[:, None]
    late = np.fft.irfft(spectrum, len(t), axis=0)
    bands = [band for band in band_delays(t, late, rate) if band.holds]
    assert len(bands) > 2
    assert not force_delay(t, late, rate).is_seen


def nothing(n: int) -> Samples:
    return np.arange(n) / 50.0, np.zeros((n, 3)), np.zeros((n, 3))


def noise(n: int) -> Samples:
    rng = np.random.default_rng(2)
    return np.arange(n) / 50.0, GRAVITY + rng.normal(size=(n, 3)), rng.normal(size=(n, 3))


def one_dead_axis(n: int) -> Samples:
    t, force, rate = noise(n)
    return t, force * [1.0, 0.0, 1.0], rate * [0.0, 1.0, 1.0]


@pytest.mark.parametrize("samples", [nothing, noise, one_dead_axis])
@pytest.mark.parametrize("n", [0, 1, FEWEST_BLOCKS * 256 - 1, 6000])
def test_samples_that_tell_nothing_are_no_trouble(samples: object, n: int) -> None:
    assert callable(samples)
    found = force_delay(*samples(n))
    assert (found.delay, found.sigma, found.is_seen, found.is_found) == (0.0, np.inf, False, False)


@pytest.mark.parametrize("preset", ["white", "kart", "kart_harsh"])
def test_a_logger_on_the_frame_of_a_simulated_kart_has_no_delay(preset: str) -> None:
    for seed in range(3):
        imu = prepare(simulate_preset(preset, seed, duration=100.0).raw).imu
        assert imu is not None
        assert not force_delay(imu.t, imu.specific_force_s, imu.angular_rate_s).is_seen


@pytest.mark.parametrize("preset", ["white", "kart"])
@pytest.mark.parametrize("delay", [0.0, 0.05])
def test_on_the_wheel_of_a_simulated_kart_it_is_found(preset: str, delay: float) -> None:
    changes = {"imu_accel_delay": delay, "motion_steering": 10.0 * DEG}
    imu = prepare(simulate_preset(preset, 1, duration=150.0, **changes).raw).imu
    assert imu is not None
    found = force_delay(imu.t, imu.specific_force_s, imu.angular_rate_s)
    assert found.is_seen
    assert found.is_found == (delay > 0.0)
    assert found.delay == pytest.approx(delay, abs=8e-3)  # the kart's own jerk goes along with some of the turning


@pytest.mark.parametrize(
    ("delay", "sigma", "unsure"),
    [(0.02, 0.002, 0.002), (0.013, 0.004, 0.01237), (0.004, 0.002, 0.0), (0.0, 0.003, 0.0)],
)
def test_the_sigma_of_times_contains_a_likely_delay_and_its_rest(delay: float, sigma: float, unsure: float) -> None:
    assert ForceDelay(delay, sigma, True).unsure == pytest.approx(unsure, abs=1e-5)
    assert ForceDelay(0.0, np.inf, False).unsure == 0.0


def band(delay: float, size: float = 1.0) -> BandDelay:
    """What one band says, to a millisecond, of 1 to 2 Hz."""
    return BandDelay(1.0, 2.0, delay, 1e-3, size, 0.01)


def test_bands_that_differ_by_more_than_their_sigmas_widen_that_of_the_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = np.zeros((1, 3))
    for apart, at_odds in ((0.5e-3, 1.0), (3e-3, 3.0 / np.sqrt(2.0))):  # of two, the rms in sigmas; never less than 1
        monkeypatch.setattr(module, "band_delays", lambda *_, by=apart: [band(0.03 - 0.5 * by), band(0.03 + 0.5 * by)])
        found = force_delay(np.zeros(1), nothing, nothing)
        assert found.delay == pytest.approx(0.03)
        assert found.sigma == pytest.approx(at_odds * 1e-3 / np.sqrt(2.0), rel=1e-6)


def test_a_band_whose_size_is_not_one_counts_for_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """By as much as goes along with the turning: of 10 % a quarter of a period off, at 1.41 Hz 11 ms."""
    monkeypatch.setattr(module, "band_delays", lambda *_: [band(0.03), band(0.05, size=1.1)])
    nothing = np.zeros((1, 3))
    beside = 0.1 / (2.0 * np.pi * np.sqrt(2.0))
    weights = np.array([1e-6, 1e-6 + beside**2]) ** -1.0
    assert force_delay(np.zeros(1), nothing, nothing).delay == pytest.approx(np.average([0.03, 0.05], weights=weights))
