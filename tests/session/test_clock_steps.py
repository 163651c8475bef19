"""A clock that steps ahead while the kart drives on, and holes in the recording, which are none."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import RawImu, RawMag, RawSession
from smoother.session.clock_steps import clock_steps, without_clock_steps
from smoother.session.load import load_raw
from smoother.sim.record import write_csv
from smoother.sim.scenario import Interval
from smoother.sim.simulation import Simulation, simulate_preset


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 3, duration=120.0, gnss_outages=(Interval(80.0, 4.0),), imu_rate=50.0)


@pytest.fixture(scope="module")
def raw(simulation: Simulation) -> RawSession:
    return simulation.raw


def stepping(since: float, step: float) -> Callable[[Array], Array]:
    return lambda t: np.asarray(t + np.where(t > since, step, 0.0))


@pytest.mark.parametrize("since", [30.05, 41.7, 53.3, 66.1, 97.5])
@pytest.mark.parametrize("step", [0.5, 1.0, 18.0])
def test_a_step_is_found_wherever_the_kart_is(raw: RawSession, since: float, step: float) -> None:
    gnss = replace(raw.gnss, t=stepping(since, step)(raw.gnss.t))
    at, steps = clock_steps(gnss)
    assert raw.gnss.t[at].tolist() == [raw.gnss.t[raw.gnss.t <= since][-1]]
    assert steps == pytest.approx([step], abs=0.05)


def test_samples_of_a_clock_of_their_own_stay(raw: RawSession) -> None:
    given = replace(raw.gnss, t=stepping(50.0, 1.0)(raw.gnss.t))
    found = without_clock_steps(given, raw.imu, raw.mag, "gps.csv")
    np.testing.assert_allclose(found.gnss.t, raw.gnss.t, atol=0.05)
    assert found.imu is raw.imu or np.array_equal(found.imu.t, raw.imu.t)  # type: ignore[union-attr]
    (said,) = found.problems
    assert (said.code, said.text.startswith("gps.csv: its clock steps ahead by 1")) == ("clock_step", True)


def test_samples_of_the_same_clock_are_closed_with_the_fixes(raw: RawSession) -> None:
    assert raw.imu is not None and raw.mag is not None
    later = stepping(50.0, 1.0)
    imu: RawImu = replace(raw.imu, t=later(raw.imu.t))
    mag: RawMag = replace(raw.mag, t=later(raw.mag.t))
    found = without_clock_steps(replace(raw.gnss, t=later(raw.gnss.t)), imu, mag, "x.vbo")
    assert found.imu is not None and found.mag is not None
    np.testing.assert_allclose(found.gnss.t, raw.gnss.t, atol=0.05)
    np.testing.assert_allclose(found.imu.t, raw.imu.t, atol=0.05)
    np.testing.assert_allclose(found.mag.t, raw.mag.t, atol=0.05)


def test_a_hole_is_no_step_nor_is_anything_at_rest(raw: RawSession) -> None:
    assert clock_steps(raw.gnss)[0].size == 0  # the outage of 4 s
    parked = simulate_preset("kart", 3, duration=60.0, motion_driving=False, gnss_outages=()).raw.gnss
    assert clock_steps(replace(parked, t=stepping(30.0, 1.0)(parked.t)))[0].size == 0
    few = slice(0, 6)
    short = {name: v[few] for name, v in vars(raw.gnss).items() if v is not None}
    assert clock_steps(replace(raw.gnss, **short))[0].size == 0


def test_two_steps(raw: RawSession) -> None:
    both = stepping(45.0, 0.7)(stepping(70.0, 2.0)(raw.gnss.t))
    found = without_clock_steps(replace(raw.gnss, t=both), None, None, "gps.csv")
    np.testing.assert_allclose(found.gnss.t, raw.gnss.t, atol=0.08)
    assert len(found.problems) == 2


def test_a_session_is_read_without_the_step(simulation: Simulation, tmp_path: Path) -> None:
    write_csv(simulation, tmp_path)
    table = (tmp_path / "gps.csv").read_text(encoding="utf-8").splitlines()
    rows = [row.split(",", 1) for row in table[1:]]
    rows = [[f"{float(t) + (1.0 if float(t) > 60.0 else 0.0):.6f}", rest] for t, rest in rows]
    before = load_raw(tmp_path).gnss.t
    (tmp_path / "gps.csv").write_text("\n".join([table[0], *(",".join(row) for row in rows)]), encoding="utf-8")
    after = load_raw(tmp_path)
    np.testing.assert_allclose(after.gnss.t, before, atol=0.02)
    assert "clock_step" in [problem.code for problem in after.problems]


@pytest.mark.parametrize(
    "recording",
    [
        "kart_adria_first_half",
        "kart_lignano_racebox",
        "kart_massafinalese_racechrono",
        "kart_okc_doves",
        "car_comma2k19",
    ],
)
def test_real_recordings(recording: str, data_directory: Path) -> None:
    raw = load_raw(data_directory / recording)
    assert clock_steps(raw.gnss)[0].size == 0
    k = int(0.6 * len(raw.gnss))
    t = raw.gnss.t + np.where(np.arange(len(raw.gnss)) > k, 1.0, 0.0)
    at, steps = clock_steps(replace(raw.gnss, t=t))
    assert at.tolist() == [k]
    assert steps == pytest.approx([1.0], abs=0.1)
