"""What is reported of a session's constants."""

import math
from dataclasses import replace

import numpy as np
import pytest

from smoother.config import SessionConfig
from smoother.estimate.factors.graph import Priors
from smoother.estimate.fixes.reported_noise import noise_of_fixes, scatter_of_fixes
from smoother.estimate.model.heading import FieldFit, Heading
from smoother.estimate.model.noise import InertialNoise, Noise
from smoother.estimate.model.state import CONSTANTS, CONSTANTS_SIZE
from smoother.estimate.output.estimated import Estimated, Known, Uncertainty
from smoother.estimate.output.identified import field_values, identified_values
from smoother.estimate.output.joint import WindowsJoint
from smoother.estimate.output.mounting import FittedMounting
from smoother.estimate.output.problems import early
from smoother.estimate.output.residuals import NoiseUncertainty
from smoother.samples import Sampling
from smoother.trajectory import Identified

from .still_state import state_of

UNKNOWN = NoiseUncertainty(0.7, 0.7, np.full(3, 0.7), np.full(3, 0.7), np.zeros(3), np.zeros(3))


def found(
    sigma: float = 2e-3,
    tau_spread: float = math.inf,
    *,
    is_steered: bool = False,
    holds_height: bool = False,
    drives: bool = True,
    gyro: float = 0.01,
    uncertainty: NoiseUncertainty = UNKNOWN,
) -> Estimated:
    """Constants known to `sigma`, with priors of 0.25."""
    half, no = np.full(3, 0.5), np.empty((2, 0))
    constants = {
        "position_latency": np.array([0.12]),
        "velocity_latency": np.array([0.2]),
        "lever_arm": np.array([0.3, 0.4, 0.0]),
        "heading_offset": np.array([0.1]),
    }
    beforehand = {c.name: (np.zeros(c.size), np.full(c.size, 0.25)) for c in CONSTANTS}
    beforehand["slip"] = (np.zeros(4), np.array([0.5, 0.01, 2e-3, 1.0]))
    scales = {"accel_scale": np.full(6, 0.01), "gyro_scale": np.full(3, 0.01)}
    noise = Noise(InertialNoise(0.1, gyro, 0.003, 1e-4), half, half, half, 60.0, constants=scales)
    known = Known(
        noise,
        uncertainty,
        Priors(0.5, 0.05, np.zeros(3), beforehand, np.array([0.0, 0.0, 1.0]) if holds_height else None),
        sigma**2 * np.eye(CONSTANTS_SIZE),
        np.zeros((3, 3)),
        None,
        tau_spread,
        True,
        drives,
    )
    state = state_of(np.arange(2.0), np.tile(np.eye(3), (2, 1, 1)), is_steered=is_steered, **constants)
    return Estimated(state, known, Uncertainty(no, no, no, no), {}, WindowsJoint([]))


def told(
    sampled_every: float, stamp_sigma: float = 0.0, config: SessionConfig | None = None, **given: object
) -> dict[str, Identified]:
    """What is reported of what was :func:`found`."""
    mounting, sampling = FittedMounting(np.eye(3), np.full(3, 0.01), True, True), Sampling(sampled_every, stamp_sigma)
    return identified_values(found(**given), mounting, config or SessionConfig(), np.zeros(3), sampling)  # type: ignore[arg-type]


@pytest.mark.parametrize("key", ["gps_position_latency", "gps_velocity_latency"])
def test_half_an_interval_of_the_sample_times_is_unknown(key: str) -> None:
    """Half a period lies between both: as sigma, that of any time within it. Filters hold it back by 1.5 ms or so."""
    assert told(0.0)[key].sigma == pytest.approx(math.hypot(2e-3, 1.5e-3))
    assert told(0.02)[key].sigma == pytest.approx(math.hypot(2e-3, 1.5e-3, 0.01 / math.sqrt(3.0)))
    assert told(0.02)[key].value == told(0.0)[key].value
    assert told(0.02)["lever_arm_b"].sigma == told(0.0)["lever_arm_b"].sigma


def test_coarse_stamps_widen_the_sigmas_of_delays() -> None:
    for config in (SessionConfig(), SessionConfig(imu_delay=0.0)):
        of_stamps = told(0.0, stamp_sigma=0.05, config=config)["gps_velocity_latency"].sigma
        assert of_stamps == pytest.approx(0.05, rel=0.01)


def test_where_the_delay_of_the_samples_is_stated_their_moment_is_known() -> None:
    stated = told(0.02, config=SessionConfig(imu_delay=0.0059))
    assert stated["gps_velocity_latency"].sigma == pytest.approx(2e-3)


def test_a_leaning_antenna_resembles_a_late_receiver() -> None:
    """Half a metre above the box; as the height of the arm is not known, neither is that."""
    known, unknown = told(0.0, sigma=2e-4), told(0.0, sigma=2e-4, holds_height=True)
    assert known["gps_velocity_response"].sigma == pytest.approx(2e-4)
    assert unknown["gps_velocity_response"].sigma == pytest.approx(math.hypot(2e-4, 1.1e-3))


def test_an_arm_along_the_course_shows_less_of_antenna_and_receiver() -> None:
    """The nose is beside the course by the slip, 0.01 rad per m/s^2; the box goes round the column."""
    frame, wheel = (told(0.0, sigma=2e-4, is_steered=is_steered) for is_steered in (False, True))
    assert frame["gps_velocity_response"].sigma == pytest.approx(2e-4)
    assert wheel["gps_velocity_response"].sigma == pytest.approx(math.hypot(2e-4, 0.01 * 0.5))
    assert frame["lever_arm_b"].sigma == pytest.approx(np.full(3, 2e-4))
    assert wheel["lever_arm_b"].sigma == pytest.approx(np.hypot(2e-4, [0.1, 0.1, 0.0]))


def test_a_parked_kart_has_its_priors_and_no_more() -> None:
    assert told(0.02, drives=False)["gps_position_latency"].sigma == pytest.approx(0.25)


@pytest.mark.parametrize(("spread", "observable"), [(math.inf, False), (0.2, True)])
def test_how_large_the_wander_is_shows_with_how_long_it_lasts(spread: float, observable: bool) -> None:
    value = told(0.0, tau_spread=spread)["gps_offset_sigma"]
    assert value.observable == observable


def test_the_sigma_of_a_noise_follows_from_the_session() -> None:
    """As any box's where nothing tells it, and then it is a default."""
    spreads = np.array([0.05, 0.05, 0.3]), np.array([0.1, 0.1, 0.7])
    each = replace(UNKNOWN, accel=0.1, gyro=0.2, position=spreads[0], velocity=spreads[1])
    known, unknown = told(0.0, uncertainty=each), told(0.0)
    for name, spread in (("accel_noise", 0.1), ("gyro_noise", 0.2)):
        assert known[name].sigma == pytest.approx(spread * np.asarray(known[name].value))
        assert (known[name].observable, known[name].source) == (True, "identified")
        assert unknown[name].sigma == pytest.approx(0.7 * np.asarray(unknown[name].value))
        assert (unknown[name].observable, unknown[name].source) == (False, "default")
    half = np.full(3, 0.5)
    assert known["gps_position_noise"] == noise_of_fixes(half, each.position, "m", np.zeros(3))
    assert known["gps_velocity_noise"] == noise_of_fixes(half, each.velocity, "m/s")


def test_what_the_wander_goes_between_keyframes_is_no_noise_of_fixes() -> None:
    each = replace(UNKNOWN, position=np.full(3, 0.1), wandered=np.array([0.09, 0.09, 1.0]))
    noise = told(0.0, uncertainty=each)["gps_position_noise"]
    assert noise.value == pytest.approx([0.4, 0.4, 0.02])
    assert noise == scatter_of_fixes(np.full(3, 0.5), each.position, each.wandered, 0.02)


def test_a_wander_may_hide_beneath_the_noise() -> None:
    hidden = told(0.0, uncertainty=replace(UNKNOWN, hidden=np.array([1.0, 1.0, 2.0])))["gps_offset_sigma"]
    assert hidden.sigma == pytest.approx(np.hypot(0.25, [1.0, 1.0, 2.0]))


def test_a_compass_that_is_not_used_has_no_values() -> None:
    solved = found(1e-2)
    assert field_values(None, solved) == {}
    calibrated = Heading(np.arange(3), np.zeros((3, 3)), 0.0, 0.1, 0.012)
    values = field_values(calibrated, solved)
    assert list(values) == ["mag_heading_offset"]  # iron is the calibration's
    offset = values["mag_heading_offset"]
    assert (offset.value, offset.sigma, offset.observable) == (0.1, pytest.approx(0.01), False)
    fit = FieldFit(40.0 * np.eye(3), np.ones(3), np.full((3, 3), 1.0), np.full(3, 2.0), turned=0.1)
    values = field_values(replace(calibrated, fit=fit, offset_sigma=0.8), solved)
    assert values["mag_heading_offset"].observable
    assert values["mag_hard_iron"].sigma == [2.0, 2.0, 2.0]
    np.testing.assert_allclose(values["mag_soft_iron"].value, np.eye(3))
    np.testing.assert_allclose(values["mag_soft_iron"].sigma, 1.0 / 40.0)
    stands = replace(calibrated, fit=replace(fit, turned=1e-3))
    assert list(field_values(stands, solved)) == ["mag_heading_offset"]


@pytest.mark.parametrize(("value", "said"), [(-0.8, True), (-0.06, False), (0.1, False)])
def test_fixes_that_come_before_they_are_true_are_named(value: float, said: bool) -> None:
    latency = Identified(value, 0.006, "s", True, "identified")
    problems = early({"gps_position_latency": latency})
    assert [p.code for p in problems] == (["gps_early"] if said else [])
    assert not early({"gps_position_latency": Identified(value, 0.25, "s", False, "default")})
