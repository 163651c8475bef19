"""The magnetometer calibrated against a driven attitude: hard and soft iron found, nonsense refused."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.factors.constraints import heading_rows
from smoother.estimate.model.heading import FLOOR, _memory, heading_from_field, repeating
from smoother.estimate.model.state import CONSTANTS, Geometry, State
from smoother.fit.magnetic_model import field_n
from smoother.frames import rotation_from_euler, wrap_angle
from smoother.samples import MagSamples
from smoother.units import DEG

K, INTERVAL = 1000, 0.2
DECLINATION, INCLINATION = 4.0 * DEG, 61.0 * DEG
EARTH_N = 47.0 * field_n(DECLINATION, INCLINATION)  # uT
R_BS = so3.exp(np.array([0.4, -1.1, 2.0]))
HARD_IRON = np.array([30.0, -22.0, 15.0])
SOFT_IRON = np.eye(3) + np.array([[0.2, 0.1, -0.05], [0.1, -0.1, 0.08], [-0.05, 0.08, 0.1]])


def laps(R_bs: np.ndarray = R_BS) -> State:
    """Laps on nearly level ground: all headings, a few degrees of roll and pitch."""
    t = INTERVAL * np.arange(K)
    R_nb = rotation_from_euler(
        2.0 * DEG * np.sin(0.9 * t), 1.5 * DEG * np.cos(1.3 * t), 0.2 * t + 0.5 * np.sin(0.3 * t)
    )
    zeros = np.zeros((K, 3))
    constants = {c.name: np.zeros(c.size) for c in CONSTANTS}
    return State(t, R_nb @ R_bs, zeros, zeros, zeros, zeros, zeros, constants, Geometry(np.eye(3)))


def readings(
    state: State, hard: np.ndarray = HARD_IRON, soft: np.ndarray = SOFT_IRON, noise: float = 1.0, unit: float = 1.0
) -> MagSamples:
    """What the sensor reads at 10 Hz on the way, uT times `unit`."""
    t = np.arange(state.t[0], state.t[-1], 0.1)
    i = np.minimum((t / INTERVAL).astype(int), K - 2)
    share = (t - state.t[i]) / INTERVAL
    turn = so3.log(state.R_ns[i].transpose(0, 2, 1) @ state.R_ns[i + 1])
    R = state.R_ns[i] @ so3.exp(share[:, None] * turn)
    field_s = np.einsum("kji,j->ki", R, EARTH_N) @ soft.T + hard
    return MagSamples(t, unit * (field_s + noise * np.random.default_rng(0).normal(size=field_s.shape)))


def heading_error(state: State, heading) -> np.ndarray:
    """Yaw of the corrected field against the field's true one, rad, at the keyframes it was found for."""
    field = np.einsum("kij,kj->ki", state.R_ns[heading.interval], heading.field_s)
    return wrap_angle(np.arctan2(field[:, 1], field[:, 0]) - np.arctan2(EARTH_N[1], EARTH_N[0]))


@pytest.mark.parametrize("unit", [1.0, 1.0 / 47.0, 1000.0])
def test_hard_and_soft_iron_are_found_from_laps_in_any_unit(unit: float) -> None:
    state = laps()
    heading = heading_from_field(readings(state, unit=unit), state, DECLINATION, INCLINATION)
    assert heading is not None
    error = heading_error(state, heading)
    assert abs(np.mean(error)) < 1.0 * DEG
    assert np.std(error) < 1.5 * DEG  # 1 uT against 23 uT of level field is 2.5 deg, averaged over ten readings
    assert heading.sigma == pytest.approx(np.sqrt(FLOOR**2 + repeating(len(heading.interval))))


@pytest.mark.parametrize("seed", range(4))
def test_any_mounting_and_any_iron_of_a_kart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = laps(so3.exp(2.0 * rng.normal(size=3)))
    crooked = rng.uniform(-0.15, 0.15, (3, 3))
    heading = heading_from_field(
        readings(state, rng.uniform(-30.0, 30.0, 3), np.eye(3) + crooked + crooked.T), state, DECLINATION, INCLINATION
    )
    assert heading is not None
    assert np.sqrt(np.mean(heading_error(state, heading) ** 2)) < 2.5 * DEG


@pytest.mark.parametrize("seed", range(4))
def test_the_iron_that_was_found_is_within_its_sigmas(seed: int) -> None:
    """In any unit, with attitudes that all lean by a degree as those of a biased accelerometer do."""
    rng = np.random.default_rng(10 + seed)
    state = laps(so3.exp(2.0 * rng.normal(size=3)))
    hard, crooked = rng.uniform(-30.0, 30.0, 3), rng.uniform(-0.1, 0.1, (3, 3))
    soft = np.eye(3) + crooked + crooked.T
    leaning = replace(state, R_ns=so3.exp(np.array([0.7, 0.7, 0.0]) * DEG) @ state.R_ns)
    heading = heading_from_field(readings(state, hard, soft, unit=0.01), leaning, DECLINATION, INCLINATION)
    assert heading is not None
    assert heading.fit is not None
    correction = np.linalg.inv(soft) * np.linalg.det(soft) ** (1.0 / 3.0)
    of_iron = (heading.fit.iron - 0.01 * hard) / heading.fit.iron_sigma
    of_matrix = (heading.fit.soft_iron - correction) / heading.fit.soft_iron_sigma
    assert np.max(np.abs(np.append(of_iron, of_matrix.ravel()))) < 2.6
    assert np.all(heading.fit.iron_sigma < 0.3 * 0.47)  # what laps tell, within a third of the field


def test_the_sigma_of_iron_contains_attitudes_and_the_engine_s_current() -> None:
    """However many readings there are: both are the same in all of them, or come back in every lap."""
    state = laps()
    quiet = heading_from_field(readings(state, noise=0.01), state, DECLINATION, INCLINATION)
    readings_of_engine = readings(state, noise=0.01)
    current = 12.0 * (1.0 + np.sin(1.1 * readings_of_engine.t))  # uT, of which the mean is never seen
    engine = replace(readings_of_engine, field_s=readings_of_engine.field_s + current[:, None] * [0.6, 0.0, 0.8])
    disturbed = heading_from_field(engine, state, DECLINATION, INCLINATION)
    assert quiet is not None and quiet.fit is not None
    assert disturbed is not None and disturbed.fit is not None
    assert np.min(quiet.fit.matrix_sigma) > 47.0 * 1.0 * DEG
    assert np.all(np.abs(disturbed.fit.iron - HARD_IRON) < 2.6 * disturbed.fit.iron_sigma)
    assert np.all(disturbed.fit.iron_sigma > 1.15 * quiet.fit.iron_sigma)


def test_a_calibrated_field_has_no_iron() -> None:
    state = laps()
    heading = heading_from_field(readings(state, np.zeros(3), np.eye(3)), state, DECLINATION, INCLINATION)
    assert heading is not None
    assert heading.fit is None


def test_its_rows_read_zero_at_the_true_attitude() -> None:
    state = laps()
    heading = heading_from_field(readings(state, noise=0.0), state, DECLINATION, INCLINATION)
    assert heading is not None
    rows = heading_rows(state, heading.interval, heading.field_s, heading.field_yaw, heading.sigma, heading.has_offset)
    assert np.max(np.abs(rows.residual)) < 2.0 * DEG


def test_a_field_that_was_calibrated_before_is_unchanged_and_gives_north() -> None:
    state = laps()
    mag = readings(state, np.zeros(3), np.eye(3), noise=0.0, unit=1.0 / 47.0)
    heading = heading_from_field(mag, state, DECLINATION, INCLINATION)
    assert heading is not None
    want = np.stack([np.interp(state.t[heading.interval], mag.t, mag.field_s[:, i]) for i in range(3)], axis=1)
    np.testing.assert_allclose(heading.field_s, want, atol=2e-3)  # readings are joined by straight lines here
    assert heading.offset_sigma < 1.0 * DEG
    corrected = heading_from_field(readings(state), state, DECLINATION, INCLINATION)
    assert corrected is not None
    assert corrected.offset_sigma > 30.0 * DEG  # corrected against the attitude: its mean is the attitude's own


def test_sigma_never_claims_more_than_a_kart_s_iron_allows() -> None:
    state = laps()
    clean = heading_from_field(readings(state, np.zeros(3), np.eye(3), noise=0.0), state, DECLINATION, INCLINATION)
    assert clean is not None
    assert clean.sigma == FLOOR


def test_many_headings_of_a_fitted_field_have_no_more_information_than_few() -> None:
    """The correction was fitted to the attitude they are to tell, and what it leaves comes back in every lap."""
    state = laps()
    heading = heading_from_field(readings(state), state, DECLINATION, INCLINATION)
    assert heading is not None
    # cosine and sine of the heading and of its double
    assert heading.sigma / np.sqrt(len(heading.interval) / 4.0) > 0.7 * DEG
    assert repeating(400) == pytest.approx(4.0 * repeating(100))


def test_headings_of_one_stand_together_tell_what_one_does() -> None:
    """The iron of one direction and an engine that idles err alike in all of them."""
    driven = laps()
    at_rest = np.arange(300, 600)
    R_ns = driven.R_ns.copy()
    R_ns[at_rest] = R_ns[300]
    state = replace(driven, R_ns=R_ns)
    heading = heading_from_field(readings(state), state, DECLINATION, INCLINATION, at_rest)
    assert heading is not None
    rests, sigma = np.isin(heading.interval, at_rest), np.asarray(heading.sigma)
    assert np.count_nonzero(rests) == 60
    assert np.ptp(sigma[rests]) == np.ptp(sigma[~rests]) == 0.0
    assert np.sum(sigma[rests] ** -2.0) == pytest.approx(sigma[~rests][0] ** -2.0)
    rows = heading_rows(state, heading.interval, heading.field_s, heading.field_yaw, heading.sigma, heading.has_offset)
    np.testing.assert_allclose(rows.sigma[:, 0], sigma)


def test_readings_are_averaged_around_their_keyframe_though_the_kart_turns() -> None:
    state = laps()
    noisy = heading_from_field(readings(state, np.zeros(3), np.eye(3), noise=3.0), state, DECLINATION, INCLINATION)
    assert noisy is not None
    # 3 uT against 23 uT is 7.5 deg a reading; ten of them, 0.3 rad of turning apart, are good to a third of that
    assert np.std(heading_error(state, noisy)) < 3.0 * DEG


def test_headings_are_a_second_apart_since_their_errors_last() -> None:
    state = laps()
    heading = heading_from_field(readings(state), state, DECLINATION, INCLINATION)
    assert heading is not None
    assert np.min(np.diff(state.t[heading.interval])) > 0.99
    assert len(heading.interval) > 180


def test_moments_under_a_bridge_are_left_out() -> None:
    state = laps()
    mag = readings(state)
    field = mag.field_s.copy()
    under = (mag.t % 40.0) < 3.0
    field[under] += [80.0, 60.0, -90.0]
    heading = heading_from_field(MagSamples(mag.t, field), state, DECLINATION, INCLINATION)
    assert heading is not None
    kept = state.t[heading.interval]
    assert not np.any((kept % 40.0 > 0.5) & (kept % 40.0 < 2.5))
    assert np.sqrt(np.mean(heading_error(state, heading) ** 2)) < 5.0 * DEG


def test_what_the_compass_read_before_the_first_keyframe_and_after_the_last_does_not_count() -> None:
    state = laps()
    mag = readings(state)
    beside = np.arange(0.1, 60.0, 0.1)
    t = np.concatenate([mag.t[0] - beside[::-1], mag.t, state.t[-1] + beside])
    stray = np.tile([300.0, -50.0, 80.0], (len(beside), 1))
    longer = MagSamples(t, np.concatenate([stray, mag.field_s, stray]))
    heading, usual = (heading_from_field(each, state, DECLINATION, INCLINATION) for each in (longer, mag))
    assert heading is not None and usual is not None
    np.testing.assert_array_equal(heading.interval, usual.interval)
    np.testing.assert_allclose(heading.field_s, usual.field_s)


class TestRefusal:
    def test_a_field_that_has_nothing_to_do_with_the_heading_is_refused(self) -> None:
        state = laps()
        t = readings(state).t
        noise = 20.0 * np.random.default_rng(0).normal(size=(len(t), 3))
        assert heading_from_field(MagSamples(t, noise), state, DECLINATION, INCLINATION) is None

    def test_a_sensor_that_stands_still_is_refused(self) -> None:
        state = laps()
        t = readings(state).t
        stuck = np.tile([20.0, -3.0, 40.0], (len(t), 1))
        assert heading_from_field(MagSamples(t, stuck), state, DECLINATION, INCLINATION) is None
        assert heading_from_field(MagSamples(t, np.zeros((len(t), 3))), state, DECLINATION, INCLINATION) is None

    def test_a_field_drowned_in_the_currents_of_the_engine_is_refused(self) -> None:
        state = laps()
        mag = readings(state)
        current = 60.0 * np.sin(1.7 * mag.t)[:, None] * [1.0, -0.6, 0.3]
        assert heading_from_field(MagSamples(mag.t, mag.field_s + current), state, DECLINATION, INCLINATION) is None

    def test_another_clock_that_does_not_overlap_is_refused(self) -> None:
        state = laps()
        mag = readings(state)
        assert heading_from_field(MagSamples(mag.t + 1e4, mag.field_s), state, DECLINATION, INCLINATION) is None

    def test_fifteen_seconds_are_too_few_to_judge(self) -> None:
        state = laps()
        short = replace(
            state, t=state.t[:75], **{name: getattr(state, name)[:75] for name in ("R_ns", "position_n", "velocity_n")}
        )
        assert heading_from_field(readings(state), short, DECLINATION, INCLINATION) is None


def test_errors_that_last_count_as_one() -> None:
    rng = np.random.default_rng(0)
    white = rng.normal(size=4000)
    slow = np.convolve(rng.normal(size=100_000), np.ones(10), mode="valid")
    assert _memory(white) < 1.5
    assert _memory(slow) == pytest.approx(10.0, rel=0.2)  # a moving sum of ten
