"""--set NAME=VALUE: every figure of a scenario can be set, and a mistake is named."""

import numpy as np
import pytest

from smoother.cli.scenario_settings import listed, parsed
from smoother.errors import UsageError
from smoother.sim.motion import Spin, Stop
from smoother.sim.presets import draw_scenario
from smoother.sim.scenario import Interval, with_changes


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("gnss.white_horizontal=0.3", 0.3),
        ("gnss.velocity=no", False),
        ("imu.bits=12", 12),
        ("imu.accel_range=none", None),
        ("imu.harmonics=1,0.5", (1.0, 0.5)),
        ("gnss.outages=60:5,120:10", (Interval(60.0, 5.0), Interval(120.0, 10.0))),
        ("gnss.outages=", ()),
        ("motion.stops=100:20", (Stop(100.0, 20.0),)),
        ("motion.spins=100:2.5,200:3", (Spin(100.0, 2.5), Spin(200.0, 3.0))),
        ("start_unix=1.7e9", 1.7e9),
    ],
)
def test_a_text_becomes_a_value_of_the_figure_s_type(setting: str, value: object) -> None:
    (read,) = parsed([setting]).values()
    assert read == value
    assert type(read) is type(value)


def test_vectors_and_matrices_are_numbers_with_commas() -> None:
    changes = parsed(["lever_arm_b=0.1,0.2,0.3", "imu.accel_matrix=1,0,0,0,1,0,0,0,2"])
    assert changes["lever_arm_b"] == pytest.approx([0.1, 0.2, 0.3])
    assert np.diag(changes["imu.accel_matrix"]) == pytest.approx([1.0, 1.0, 2.0])


def test_a_jump_has_a_start_a_length_and_a_displacement() -> None:
    (jump,) = parsed(["gnss.jumps=30:2:10:-5:0"])["gnss.jumps"]
    assert (jump.start, jump.duration) == (30.0, 2.0)
    assert jump.offset_n == pytest.approx([10.0, -5.0, 0.0])


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("gnss.rate", "NAME=VALUE"),
        ("gnss.rate=quick", "a number expected"),
        ("gnss.rate=none", "cannot be left out"),
        ("imu.bits=1.5", "a whole number expected"),
        ("gnss.velocity=perhaps", "true or false expected"),
        ("gnss.outages=60", "start:length"),
        ("lever_arm_b=1,2", "3 or 9 numbers"),
        ("lever_arm_b=1,2,nan", "3 or 9 numbers"),
    ],
)
def test_a_value_of_the_wrong_kind_is_refused_with_what_was_expected(setting: str, words: str) -> None:
    with pytest.raises(UsageError, match=words) as error:
        parsed([setting])
    assert setting in str(error.value)


def test_an_unknown_figure_is_refused_with_the_nearest() -> None:
    scenario = draw_scenario("kart", np.random.default_rng(1))
    with pytest.raises(UsageError, match=r"gnss\.white_horizontal"):
        with_changes(scenario, parsed(["gnss.white_horizntal=1"]))


def test_every_listed_figure_can_be_set_to_what_is_listed() -> None:
    for preset in ("white", "kart", "kart_harsh"):
        rows = dict(listed(preset, 7, {}))
        assert {"gnss.offset_tau", "imu.gyro_noise", "mag.soft_iron", "motion.power", "lever_arm_b"} <= set(rows)
        again = parsed([f"{name}={value}" for name, value in rows.items()])
        assert dict(listed(preset, 8, again)) == rows


@pytest.mark.parametrize("setting", ["gnss.outages=nan:5", "motion.stops=20:nan", "imu.harmonics=1,nan"])
def test_a_list_with_what_is_no_number_is_refused(setting: str) -> None:
    with pytest.raises(UsageError, match=f"^--set {setting}: a list .* expected$"):
        parsed([setting])
