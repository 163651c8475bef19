"""Identified values on the terminal: the sigma says how many digits both have."""

import numpy as np
import pytest

from smoother import so3
from smoother.cli.tables import _identified
from smoother.trajectory import Identified


@pytest.mark.parametrize(
    ("name", "value", "sigma", "unit", "said"),
    [
        ("gps_position_latency", 0.3304, 0.01257, "s", "0.330 ± 0.013 s (identified)"),
        ("gps_offset_tau", 61.7, 12.3, "s", "62 ± 12 s (identified)"),
        ("gyro_noise", np.radians(0.01234), np.radians(0.00045), "rad/s", "0.01234 ± 0.00045 deg/s (identified)"),
        (
            "lever_arm_b",
            [0.0464, -0.0033, -0.00004],
            [0.05, 0.012, 0.5],
            "m",
            "0.046, -0.003 ± 0.050, 0.012 m forward, left; up not known (identified)",
        ),
        ("gps_offset_sigma", 1.234, None, "m", "1.23 m (identified)"),
    ],
)
def test_value_and_sigma_have_two_digits_of_the_sigma(
    name: str, value: object, sigma: object, unit: str, said: str
) -> None:
    assert _identified(name, Identified(value, sigma, unit, True, "identified")) == said


def test_of_a_stated_arm_all_is_known() -> None:
    stated = Identified([0.046, -0.003, 0.3], None, "m", True, "configured")
    assert _identified("lever_arm_b", stated) == "0.05, 0.00, 0.30 m forward, left, up (configured)"


def test_a_mounting_has_the_sigma_of_each_of_its_angles() -> None:
    """A box turned by 90 deg rolls about the kart's axis to the left."""
    R_bs = so3.exp(np.radians(np.array([0.0, 0.0, 90.0])))
    sigma = np.radians([0.5, 1.1, 2.2]).tolist()
    said = _identified("R_bs", Identified(R_bs.tolist(), sigma, "1 (sigma: rad)", True, "identified"))
    assert said == "roll 0.0 ± 1.1, pitch 0.00 ± 0.50, yaw 90.0 ± 2.2 deg (identified)"


def test_a_mounting_that_is_straight_is_not_turned_by_less_than_nothing() -> None:
    R_bs = so3.exp(np.radians(np.array([0.02, -0.03, -0.04])))
    assert "-0.0" not in _identified("R_bs", Identified(R_bs.tolist(), None, "", True, "identified"))
