import numpy as np
import pytest

from smoother.errors import UsageError
from smoother.sim.scenario import GnssErrors, ImuErrors, MagErrors, Scenario, with_changes


def test_a_figure_is_changed_by_its_path_and_nothing_else():
    scenario = Scenario()
    changed = with_changes(scenario, {"gnss.rate": 10.0, "imu_jitter": 1e-3, "duration": 60.0, "motion.driving": False})
    assert (changed.gnss.rate, changed.imu.jitter, changed.duration) == (10.0, 1e-3, 60.0)
    assert not changed.motion.driving
    assert (changed.gnss.offset_tau, changed.imu.rate) == (scenario.gnss.offset_tau, scenario.imu.rate)
    assert scenario.gnss.rate == 5.0


def test_a_sensor_can_be_left_out():
    assert with_changes(Scenario(), {"mag": None, "imu": None}).imu is None


def test_unknown_figure_names_the_nearest():
    with pytest.raises(UsageError, match=r"gnss\.rat.*gnss.rate"):
        with_changes(Scenario(), {"gnss.rat": 1.0})
    with pytest.raises(UsageError, match=r"the nearest is 'gnss[._]"):  # and never a group of them
        with_changes(Scenario(), {"gnss.foo": 1.0})


def test_figure_of_a_missing_sensor_is_refused():
    with pytest.raises(UsageError, match="has no mag"):
        with_changes(Scenario(mag=None), {"mag.noise": 0.1})


def test_unknown_track_and_impossible_duration_are_refused():
    with pytest.raises(UsageError, match="larkfield"):
        Scenario(track="monaco")
    for duration in (0.0, -1.0, float("nan")):
        with pytest.raises(UsageError, match="more than 0 s"):
            Scenario(duration=duration)


@pytest.mark.parametrize("kind", [ImuErrors, GnssErrors, MagErrors])
def test_rate_must_be_above_zero(kind):
    with pytest.raises(UsageError, match="rate"):
        kind(rate=0.0)


def test_vectors_are_checked_and_read_only():
    with pytest.raises(UsageError, match="accel_bias"):
        ImuErrors(accel_bias=np.zeros(2))
    errors = ImuErrors(accel_bias=[0.1, 0.2, 0.3])
    assert errors.accel_bias.dtype == np.float64 and not errors.accel_bias.flags.writeable


@pytest.mark.parametrize(
    ("figure", "value"),
    [
        ("gnss.white_horizontal", float("nan")),
        ("gnss.white_horizontal", -0.3),
        ("gnss.velocity_sigma", float("inf")),
        ("gnss.offset_tau", 0.0),
        ("gnss.hacc_factor", -1.0),
        ("imu.gyro_noise", -1e-3),
        ("imu.accel_range", 0.0),
        ("imu.clock_offset", float("nan")),
        ("mag.noise", -1.0),
        ("mag.resolution", -0.15),
        ("motion.line_sigma", -1.0),
        ("motion.top_speed", float("nan")),
        ("motion.slip_length", 0.0),
    ],
)
def test_a_figure_that_no_sensor_and_no_driver_has_is_refused(figure: str, value: float) -> None:
    with pytest.raises(UsageError, match=rf"^{figure} is {value:g}; it has to be a number"):
        with_changes(Scenario(), {figure: value})


def test_a_start_that_is_no_number_is_refused() -> None:
    with pytest.raises(UsageError, match=r"^start_unix is nan; it has to be a number$"):
        with_changes(Scenario(), {"start_unix": float("nan")})
