"""A box on the steering wheel is told from one on the frame before anything is smoothed."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.initial.align import beginning
from smoother.estimate.preprocess import gains as on_wheel
from smoother.estimate.preprocess.gains import is_on_wheel, without_the_wheels
from smoother.fit.running import running_mean
from smoother.samples import GnssFixes, ImuSamples, Problem
from smoother.sim.motion import wander
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import MIRRORED_AXES, UNLIKE_AXES
from smoother.units import DEG

PRESETS = ["white", "kart", "kart_harsh"]


def driven(preset: str, seed: int, wheel: float = 0.0, seconds: float = 90.0) -> tuple[ImuSamples, GnssFixes]:
    raw = simulate_preset(preset, seed, duration=seconds, motion_steering=wheel).raw
    assert raw.imu is not None
    return beginning(raw.imu), raw.gnss


@pytest.mark.parametrize("preset", PRESETS)
def test_a_logger_on_the_wheel_is_seen_however_it_is_turned(preset: str) -> None:
    imu, fixes = driven(preset, 2, 10.0 * DEG)
    assert is_on_wheel(imu, fixes)
    for seed in range(3):
        R = so3.exp(np.random.default_rng(seed).normal(size=(1, 3)) * 2.0)[0]
        turned = replace(imu, specific_force_s=imu.specific_force_s @ R.T, angular_rate_s=imu.angular_rate_s @ R.T)
        assert is_on_wheel(turned, fixes)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("seconds", [45.0, 90.0])
def test_a_logger_on_the_frame_is_not_taken_for_one_on_the_wheel(preset: str, seconds: float) -> None:
    assert not any(is_on_wheel(*driven(preset, seed, seconds=seconds)) for seed in range(4))


@pytest.mark.parametrize("wheel", [0.0, 10.0 * DEG])
def test_quick_samples_tell_the_same_in_means(wheel: float, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = simulate_preset("kart", 2, duration=60.0, motion_steering=wheel, imu_rate=1000.0).raw
    assert raw.imu is not None
    imu, seen = beginning(raw.imu), []

    def count(values: np.ndarray, width: int) -> np.ndarray:
        seen.append(len(values))
        return running_mean(values, width)

    monkeypatch.setattr(on_wheel, "running_mean", count)
    assert is_on_wheel(imu, raw.gnss) == (wheel > 0.0)
    assert max(seen) == len(imu.t) // 4
    monkeypatch.setattr(on_wheel, "SHORTEST", 0.0)
    assert is_on_wheel(imu, raw.gnss) == (wheel > 0.0)


def test_a_logger_that_rocks_by_more_than_it_turns_is_loose_and_not_on_the_wheel() -> None:
    simulation = simulate_preset("kart", 2, duration=90.0, motion_steering=10.0 * DEG)
    assert simulation.raw.imu is not None
    imu, ahead_s = beginning(simulation.raw.imu), simulation.scenario.R_bs.T @ [1.0, 0.0, 0.0]
    rocks = wander(float(imu.t[0]), float(imu.t[-1]), 0.15, np.random.default_rng(4), 2.0)(imu.t)
    loose = replace(imu, angular_rate_s=imu.angular_rate_s + rocks[:, None] * ahead_s)
    assert is_on_wheel(imu, simulation.raw.gnss) and not is_on_wheel(loose, simulation.raw.gnss)


def test_vibration_that_is_folded_alike_into_two_axes_is_no_wheel() -> None:
    simulation = simulate_preset("kart", 2, duration=90.0, imu_rate=25.0)
    assert simulation.raw.imu is not None
    imu, (ahead_s, _, up_s) = beginning(simulation.raw.imu), simulation.scenario.R_bs
    folded = 80.0 * DEG * np.random.default_rng(4).normal(size=len(imu.t))
    shaken = replace(imu, angular_rate_s=imu.angular_rate_s + folded[:, None] * (up_s - 0.9 * ahead_s))
    assert not is_on_wheel(shaken, simulation.raw.gnss)


def test_an_engine_that_turns_about_as_often_as_samples_are_taken_is_no_wheel() -> None:
    simulation = simulate_preset("kart", 2, duration=90.0, imu_rate=100.0)
    assert simulation.raw.imu is not None
    imu, (ahead_s, _, up_s) = beginning(simulation.raw.imu), simulation.scenario.R_bs
    engine_hz = 100.0 + 14.0 * np.sin(2.0 * np.pi * imu.t / 9.0)
    folded = 100.0 * DEG * np.sin(2.0 * np.pi * np.cumsum(engine_hz) * 0.01)
    shaken = replace(imu, angular_rate_s=imu.angular_rate_s + folded[:, None] * (up_s - 0.9 * ahead_s))
    assert not is_on_wheel(shaken, simulation.raw.gnss)


def test_a_kart_that_did_not_drive_is_not_judged() -> None:
    imu, fixes = driven("kart", 2, 10.0 * DEG)
    still = replace(fixes, velocity_n=np.zeros_like(fixes.velocity_n))
    unknown = replace(fixes, velocity_n=np.full_like(fixes.velocity_n, np.nan))
    assert not is_on_wheel(imu, still) and not is_on_wheel(imu, unknown)
    dead = replace(imu, angular_rate_s=np.zeros_like(imu.angular_rate_s))
    assert not is_on_wheel(dead, fixes)


def test_a_wheel_explains_axes_that_disagree_but_not_mirrored_ones() -> None:
    apart, mirrored, other = (Problem(code, "") for code in (UNLIKE_AXES, MIRRORED_AXES, "heading_unknown"))
    assert without_the_wheels((apart, other)) == (other,)
    assert without_the_wheels((mirrored, apart)) == (mirrored, apart)


def test_of_a_long_session_a_part_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a day ten copies were in memory at once; the part begins where the kart drives off."""
    looked_at = []
    mean = on_wheel.running_mean

    def watched(values: np.ndarray, window: int) -> np.ndarray:
        looked_at.append(values)
        return mean(values, window)

    monkeypatch.setattr(on_wheel, "running_mean", watched)
    monkeypatch.setattr(on_wheel, "MOST", 10_000)
    for wheel in (0.0, 10.0 * DEG):
        imu, fixes = driven("kart", 3, wheel=wheel)
        quick = np.hypot(fixes.velocity_n[:, 0], fixes.velocity_n[:, 1]) > on_wheel.MIN_SPEED
        stands = replace(fixes, velocity_n=np.where(fixes.t[:, None] < fixes.t[quick][0] + 20.0, 0.0, fixes.velocity_n))
        assert is_on_wheel(imu, stands) == (wheel > 0.0)
        assert {len(values) for values in looked_at} == {10_000} and len(imu.t) > 15_000
