"""A velocity that its positions contradict: not used, and said so; one that agrees stays as it is."""

from pathlib import Path

import numpy as np
import pytest

from smoother.samples import GnssFixes
from smoother.session.csv_form import read_fixes
from smoother.session.fix_columns import fix_columns
from smoother.session.fixes import screen_fixes

SPEED = 14.0  # m/s
STUCK = slice(100, 500)


def lap(directory: Path, **columns: np.ndarray | None) -> tuple[GnssFixes, dict[str, str]]:
    """Fixes of two minutes round an oval at 5 Hz, 0.2 m noisy, with the columns changed, or left out for None."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 120.0, 0.2)
    course, speed = t / 5.0 + 0.3 * np.sin(t), SPEED + 4.0 * np.sin(t / 4.0)
    velocity = speed[:, None] * np.column_stack([np.cos(course), np.sin(course)])
    north, east = np.cumsum(velocity, axis=0).T * 0.2 + 0.2 * rng.standard_normal((2, t.size))
    table = {
        "t_s": t,
        "lat_deg": 45 + north / 111_195,
        "lon_deg": 12 + east / 111_195 / np.cos(np.pi / 4),
        "speed_mps": speed,
        "course_deg": np.degrees(course) % 360.0,
    } | columns
    names = [name for name, values in table.items() if values is not None]
    rows = np.column_stack([table[name] for name in names])
    path = directory / "gps.csv"
    np.savetxt(path, rows, fmt="%.8f", delimiter=",", header=",".join(names), comments="")
    fixes, problems = read_fixes(path)
    return fixes, {problem.code: problem.text for problem in problems}


def sound(directory: Path) -> GnssFixes:
    fixes, said = lap(directory)
    assert said == {} and np.isfinite(fixes.velocity_n[:, :2]).all()
    return fixes


def test_a_course_that_stands_still_while_the_kart_turns_is_not_used(tmp_path: Path) -> None:
    fixes, said = lap(tmp_path, course_deg=np.full(600, 90.0))
    assert np.isnan(fixes.velocity_n[:, 0]).all() and np.isfinite(fixes.speed).all()
    told = "gps.csv: course stands at 90 in 600 rows while the positions move otherwise; not used there"
    assert said == {"gps_course_stuck": told}


@pytest.mark.parametrize("stands_at", [0.0, SPEED])
def test_a_speed_that_stands_still_while_the_positions_move_is_not_used(tmp_path: Path, stands_at: float) -> None:
    fixes, said = lap(tmp_path, speed_mps=np.full(600, stands_at))
    assert np.isnan(fixes.velocity_n[:, 0]).all()
    assert f"speed stands at {stands_at:g} in 600 rows" in said["gps_speed_stuck"]


def test_a_steady_speed_round_a_small_circle_is_no_standing_column(tmp_path: Path) -> None:
    """In a second a kart turns by most of half a circle, and is nearer to where it was than it has gone."""
    turned = 2.5 * np.arange(0.0, 120.0, 0.2)
    lat, lon = 45 + 4.0 * np.sin(turned) / 111_195, 12 - 4.0 * np.cos(turned) / 111_195 / np.cos(np.pi / 4)
    course = np.degrees(turned) % 360.0
    fixes, said = lap(tmp_path, lat_deg=lat, lon_deg=lon, speed_mps=np.full(600, 10.0), course_deg=course)
    assert said == {} and np.isfinite(fixes.velocity_n[:, :2]).all()


@pytest.mark.parametrize("name", ["speed_mps", "course_deg"])
def test_a_column_that_stops_half_way_is_used_as_far_as_it_goes(tmp_path: Path, name: str) -> None:
    whole = sound(tmp_path)
    values = np.array(whole.speed if name == "speed_mps" else whole.course_deg)
    values[STUCK] = values[STUCK.start]
    fixes, said = lap(tmp_path, **{name: values})
    known = np.isfinite(fixes.velocity_n[:, 0])
    assert not known[STUCK].any() and np.count_nonzero(known) == 200
    assert [code.endswith("_stuck") for code in said] == [True]


def test_components_that_stand_still_are_not_used(tmp_path: Path) -> None:
    fixes, said = lap(tmp_path, speed_mps=None, course_deg=None, vel_n_mps=np.zeros(600), vel_e_mps=np.zeros(600))
    assert np.isnan(fixes.velocity_n).all() and "velocity stands at 0, 0 in 600 rows" in said["gps_velocity_stuck"]


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        (np.radians, "in radians"),
        (lambda c: (c + 180.0) % 360.0, "it pointed backwards"),
        (lambda c: (-c) % 360.0, "anticlockwise from north"),
        (lambda c: (90.0 - c) % 360.0, "anticlockwise from east, or latitude and longitude exchanged"),
    ],
)
def test_a_course_that_is_written_otherwise_is_not_used_and_named(tmp_path: Path, change, hint: str) -> None:
    course = np.array(sound(tmp_path).course_deg)
    fixes, said = lap(tmp_path, course_deg=change(course))
    assert np.isnan(fixes.velocity_n[:, 0]).all()
    assert said["gps_course_wrong"].endswith(f", as if {hint}; not used")


def components(directory: Path) -> tuple[np.ndarray, np.ndarray]:
    """North and east, m/s, of the velocities of `lap`."""
    north, west, _ = sound(directory).velocity_n.T
    return north, -west


@pytest.mark.parametrize("late", [0, 2])
def test_components_that_are_exchanged_are_exchanged_back(tmp_path: Path, late: int) -> None:
    north, east = (np.roll(values, late) for values in components(tmp_path))
    fixes, said = lap(tmp_path, speed_mps=None, course_deg=None, vel_n_mps=east, vel_e_mps=north)
    told = "gps.csv: by its positions its velocities north and east are exchanged; taken as such"
    assert said == {"gps_velocity_exchanged": told}
    np.testing.assert_allclose(fixes.velocity_n[:, 0], north, atol=1e-6)
    np.testing.assert_allclose(fixes.velocity_n[:, 1], -east, atol=1e-6)


def test_components_beside_places_that_are_exchanged_are_not(tmp_path: Path) -> None:
    """Columns refuse such places; other formats may hold them."""
    north, east = components(tmp_path)
    fixes, _ = lap(tmp_path)
    columns = fix_columns(fixes.t, fixes.lon_deg, fixes.lat_deg, velocity_north=north, velocity_east=east)
    fixes, problems = screen_fixes(columns, "heat.vbo")
    assert np.isnan(fixes.velocity_n).all()
    assert [p.code for p in problems] == ["gps_course_wrong"] and "longitude exchanged" in problems[0].text


@pytest.mark.filterwarnings("error")
def test_components_of_a_straight_road_do_not_tell_that_they_are_exchanged(tmp_path: Path) -> None:
    t = np.arange(0.0, 120.0, 0.2)
    north = 14.0 * t + 0.2 * np.random.default_rng(1).standard_normal(t.size)
    columns = {"lat_deg": 45 + north / 111_195, "lon_deg": 12.0 + 1e-7 * np.sin(t)}
    speed = 14.0 + 0.1 * np.sin(t)
    fixes, said = lap(tmp_path, speed_mps=None, course_deg=None, vel_n_mps=0.0 * t, vel_e_mps=speed, **columns)
    assert np.isnan(fixes.velocity_n).all() and set(said) == {"gps_course_wrong"}


def test_components_of_another_sign_are_not_exchanged(tmp_path: Path) -> None:
    north, east = components(tmp_path)
    fixes, said = lap(tmp_path, speed_mps=None, course_deg=None, vel_n_mps=north, vel_e_mps=-east)
    assert np.isnan(fixes.velocity_n).all() and set(said) == {"gps_course_wrong"}


def test_a_missing_course_is_told(tmp_path: Path) -> None:
    _, said = lap(tmp_path, course_deg=None)
    assert said == {"gps_no_course": "gps.csv: 600 moving fixes with a speed but no course; the speed is used alone"}


def test_a_kart_that_stands_and_one_that_runs_straight_are_believed(tmp_path: Path) -> None:
    t = np.arange(600) * 0.2
    still = np.zeros(600)
    noise = 0.3 * np.random.default_rng(1).standard_normal(600) / 111_195
    _, said = lap(tmp_path, speed_mps=still, course_deg=still, lat_deg=45 + noise, lon_deg=12 + noise)
    assert said == {}
    fixes, said = lap(
        tmp_path, speed_mps=still + 20.0, course_deg=still, lat_deg=45 + 20.0 * t / 111_195 + noise, lon_deg=12 + noise
    )
    assert said == {} and np.isfinite(fixes.velocity_n[:, 0]).all()


def pushed(
    lowest: float, pace: float = 1.2, noise: float = 0.3, until: float = 53.0, drift: float = 0.0, settles: float = 0.0
) -> dict[str, np.ndarray | None]:
    """Columns of a kart that stands 24 s, is pushed `until` s and driven for the rest; speeds below `lowest` are 0.

    drift : m/s by which positions come in from elsewhere while it stands. settles : s in which they do from 60 m west.
    """
    t = np.arange(0.0, 120.0, 0.2)
    speed = np.interp(t, [24.0, 25.0, until, until + 4.0], [0.0, pace, pace, 12.0])
    north, east = noise * np.random.default_rng(4).standard_normal((2, t.size))
    east -= 60.0 * np.exp(-t / settles) if settles else 0.0
    lat = 45 + (np.cumsum(speed) * 0.2 + drift * np.minimum(t, 24.0) + north) / 111_195
    sent = np.where(speed < lowest, 0.0, speed)
    return {
        "lat_deg": lat,
        "lon_deg": 12 + east / 111_195 / np.cos(np.pi / 4),
        "speed_mps": sent,
        "course_deg": 0.0 * t,
    }


@pytest.mark.parametrize("in_parts", [False, True])
def test_zeros_of_a_receiver_that_writes_them_for_low_speeds_are_unknown_where_it_moves(
    tmp_path: Path, in_parts: bool
) -> None:
    columns = pushed(2.0)
    if in_parts:
        north = columns["speed_mps"]
        columns |= {"vel_n_mps": north, "vel_e_mps": 0.0 * north, "speed_mps": None, "course_deg": None}
    fixes, said = lap(tmp_path, **columns)
    known = np.isfinite(fixes.velocity_n[:, 0])
    assert known[:110].all() and known[270:].all(), "at rest it has measured them"
    assert not known[130:260].any()
    count = np.count_nonzero(~known)
    text = f"gps.csv: speed is 0 in {count} rows while the positions move on, and never between 0 and 2.3 m/s; not"
    assert list(said) == ["gps_speed_threshold"] and said["gps_speed_threshold"].startswith(text)


@pytest.mark.parametrize(
    ("columns", "why"),
    [
        (pushed(0.3, drift=1.0), "slow speeds are sent: it is the positions that are wrong"),
        (pushed(2.0, pace=0.0), "it stands"),
        (pushed(2.0, pace=0.0, noise=3.0), "it stands, and the positions are noisy"),
        (pushed(2.0, pace=0.3, noise=0.1), "positions of a kart that stands wander as fast"),
        (pushed(2.0, until=26.0), "it drives off, in a second or two"),
        (pushed(2.0, pace=0.0, settles=15.0), "it stands while its receiver settles"),
        (pushed(2.0, pace=0.0, until=26.0, settles=40.0), "and drives off, another way, before it has"),
    ],
)
def test_zeros_of_a_kart_that_stands_are_measured(tmp_path: Path, columns: dict[str, np.ndarray], why: str) -> None:
    fixes, said = lap(tmp_path, **columns)
    assert said == {} and np.isfinite(fixes.velocity_n[:, 0]).all(), why


@pytest.mark.parametrize(("hole", "is_told"), [((0.0, 0.0), True), ((0.0, 190.0), False), ((150.0, 190.0), False)])
def test_a_kart_that_is_pushed_and_stands_again_is_told_from_a_receiver_that_settles_by_when(
    tmp_path: Path, hole: tuple[float, float], is_reported: bool
) -> None:
    """Without the motion sensor, both look alike in the first two minutes."""
    t = np.arange(0.0, 400.0, 0.2)
    t = t[(t < hole[0]) | (t >= hole[1])]
    speed = np.interp(t, [200.0, 201.0, 230.0, 231.0, 300.0, 304.0], [0.0, 1.2, 1.2, 0.0, 0.0, 12.0])
    lat = 45 + np.cumsum(speed) * 0.2 / 111_195
    sent = np.where(speed < 2.0, 0.0, speed)
    _, said = lap(tmp_path, t_s=t, lat_deg=lat, lon_deg=0.0 * t + 12.0, speed_mps=sent, course_deg=0.0 * t)
    assert list(said) == (["gps_speed_threshold"] if is_reported else [])


def stops(threshold: float, rate: float = 5.0, settles: float = 0.0) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns of a kart that stops three times, and its speed; it creeps up to the second stop and on from it.

    threshold : m/s, below which 0 is sent. settles : s in which positions come in from 12 m west.
    """
    t = np.arange(0.0, 115.0, 1.0 / rate)
    knots = [(12.0, 0.0), (15.0, 10.0), (30.0, 10.0), (33.0, 0.0), (39.0, 0.0), (42.0, 10.0), (52.0, 10.0)]
    knots += [(54.7, 1.1), (60.0, 1.1), (60.4, 0.0), (66.0, 0.0), (66.4, 1.1), (69.0, 1.1), (71.7, 10.0)]
    knots += [(85.0, 10.0), (88.0, 0.0), (94.0, 0.0), (97.0, 10.0)]
    speed = np.interp(t, *np.array(knots).T)
    north, east = 0.05 * np.random.default_rng(5).standard_normal((2, t.size))
    east -= 12.0 * np.exp(-t / settles) if settles else 0.0
    lat, lon = 45 + (np.cumsum(speed) / rate + north) / 111_195, 12 + east / 111_195 / np.cos(np.pi / 4)
    sent = np.where(speed < threshold, 0.0, speed)
    return {"t_s": t, "lat_deg": lat, "lon_deg": lon, "speed_mps": sent, "course_deg": 0.0 * t}, speed


def test_a_kart_that_creeps_up_to_its_stop_and_on_from_it_is_not_at_rest(tmp_path: Path) -> None:
    columns, speed = stops(1.4)
    fixes, said = lap(tmp_path, **columns)
    sent = fixes.velocity_n[:, 0]
    text = "while the positions move on or within 1 s of motion, and never between 0 and 1.4 m/s; not used there"
    assert list(said) == ["gps_speed_threshold"] and said["gps_speed_threshold"].endswith(text)
    assert np.isnan(sent[(speed > 0.0) & (columns["speed_mps"] == 0.0)]).all()
    assert np.isfinite(sent[speed > 1.4]).all()
    at_rest = np.any([abs(fixes.t - fixes.t[0] - middle) < 1.0 for middle in (36.0, 63.3, 91.0)], axis=0)
    assert np.all(sent[at_rest] == 0.0)


@pytest.mark.parametrize(
    ("threshold", "rate", "why"),
    [(0.6, 5.0, "so slow a speed may be the step of the column"), (1.4, 1.0, "a second apart, none between was due")],
)
def test_stops_may_show_no_slow_speed_by_chance(tmp_path: Path, threshold: float, rate: float, why: str) -> None:
    columns, _ = stops(threshold, rate)
    fixes, said = lap(tmp_path, **columns)
    assert said == {} and np.isfinite(fixes.velocity_n[:, 0]).all(), why


def test_positions_that_settle_before_the_kart_drives_off_leave_its_zeros_measured(tmp_path: Path) -> None:
    fixes, _ = lap(tmp_path, **stops(1.4, settles=4.0)[0])
    assert np.all(fixes.velocity_n[fixes.t - fixes.t[0] < 10.5, 0] == 0.0)


def circles(
    directory: Path, radius: float, speed: float, rate: float, delay: float
) -> tuple[GnssFixes, dict[str, str]]:
    """Two minutes of circles; the velocities come `delay` s behind their positions."""
    t = np.arange(0.0, 120.0, 1.0 / rate)
    turned = speed / radius * t
    lat, lon = 45 + radius * np.sin(turned) / 111_195, 12 - radius * np.cos(turned) / 111_195 / np.cos(np.pi / 4)
    course = np.degrees(turned - speed / radius * delay) % 360.0
    return lap(directory, t_s=t, lat_deg=lat, lon_deg=lon, speed_mps=np.full(t.size, speed), course_deg=course)


@pytest.mark.parametrize(
    ("radius", "speed", "rate", "delay"), [(5.0, 8.5, 5.0, 0.6), (8.0, 11.0, 10.0, 0.6), (5.0, 8.5, 1.0, 0.0)]
)
def test_a_course_that_comes_late_is_not_a_wrong_one(
    tmp_path: Path, radius: float, speed: float, rate: float, delay: float
) -> None:
    """A skid pad turns the kart by 60 degrees within the delay of a slow receiver, or from one fix to half way on."""
    fixes, said = circles(tmp_path, radius, speed, rate, delay)
    assert said == {} and np.isfinite(fixes.velocity_n[:, :2]).all()


@pytest.mark.parametrize(("speed", "noise"), [(0.0, 5.0), (1.5, 1.0), (1.5, 5.0), (8.0, 2.0), (15.0, 5.0), (25.0, 5.0)])
@pytest.mark.parametrize("rate", [1.0, 5.0, 25.0])
def test_a_steady_velocity_is_believed_where_it_is_the_positions_that_are_noisy(
    tmp_path: Path, speed: float, noise: float, rate: float
) -> None:
    t = np.arange(0.0, 300.0, 1.0 / rate)
    north, east = noise * np.random.default_rng(3).standard_normal((2, t.size))
    lat, lon = 45 + (speed * t + north) / 111_195, 12 + east / 111_195 / np.cos(np.pi / 4)
    sent = {"speed_mps": np.full(t.size, speed), "course_deg": np.zeros(t.size)}
    fixes, said = lap(tmp_path, t_s=t, lat_deg=lat, lon_deg=lon, **sent)
    assert said == {} and np.isfinite(fixes.velocity_n[:, :2]).all()
    fixes, said = lap(
        tmp_path,
        t_s=t,
        lat_deg=lat,
        lon_deg=lon,
        vel_n_mps=sent["speed_mps"],
        vel_e_mps=0.0 * t,
        speed_mps=None,
        course_deg=None,
    )
    assert said == {} and np.isfinite(fixes.velocity_n[:, :2]).all()


CLIMB = 0.4 * np.cos(np.arange(0.0, 120.0, 0.2) / 6.0)  # m/s, on hills of 5 m


@pytest.mark.parametrize(
    ("factor", "said"),
    [(1.0, ""), (0.8, ""), (-1.0, "fall where its heights rise"), (3.6, "3.5 times what its heights rise")],
)
def test_velocities_upwards_that_contradict_the_heights_are_not_used(tmp_path: Path, factor: float, said: str) -> None:
    noise = 0.3 * np.random.default_rng(8).standard_normal(600)
    fixes, told = lap(tmp_path, alt_m=np.cumsum(CLIMB) * 0.2 + noise, vel_u_mps=factor * CLIMB)
    assert list(told) == (["gps_climb_wrong"] if said else [])
    assert said in told.get("gps_climb_wrong", "")
    assert np.isnan(fixes.velocity_n[:, 2]).all() == bool(said) and np.isfinite(fixes.velocity_n[:, :2]).all()


@pytest.mark.parametrize(
    ("factor", "is_feet"), [(1.0, False), (1.2, False), (2.5, False), (1.0 / 0.3048, True), (3.8, False), (10.0, False)]
)
def test_heights_in_feet_are_told_by_the_velocities_upwards_and_turned_into_metres(
    tmp_path: Path, factor: float, is_feet: bool
) -> None:
    height = 120.0 + np.cumsum(CLIMB) * 0.2 + 0.3 * np.random.default_rng(8).standard_normal(600)
    fixes, told = lap(tmp_path, alt_m=factor * height, vel_u_mps=CLIMB)
    assert list(told) == (["gps_height_unit"] if is_feet else [])
    np.testing.assert_allclose(fixes.alt_m, height if is_feet else factor * height, atol=1e-3)
    assert np.isfinite(fixes.velocity_n[:, 2]).all()
    assert told.get("gps_height_unit", "as if in feet; taken as such").endswith("as if in feet; taken as such")


def test_heights_of_noise_alone_are_not_taken_for_feet(tmp_path: Path) -> None:
    noise = np.random.default_rng(8).standard_normal(600)
    _, told = lap(tmp_path, alt_m=(0.05 * np.cumsum(CLIMB) * 0.2 + noise) / 0.3048, vel_u_mps=0.05 * CLIMB)
    assert told == {}


def test_velocities_upwards_that_wander_as_much_as_they_climb_do_not_clearly_contradict_the_heights(
    tmp_path: Path,
) -> None:
    """By such errors heights seem to rise by half; in 24 times CLIMB_TIME that may be all of it as well."""
    wandering = 0.4 * np.cos(np.arange(0.0, 120.0, 0.2) / 4.1)
    fixes, told = lap(tmp_path, alt_m=np.cumsum(CLIMB) * 0.2, vel_u_mps=CLIMB + wandering)
    assert told == {} and np.isfinite(fixes.velocity_n).all()


def test_velocities_upwards_on_the_flat_are_left_alone(tmp_path: Path) -> None:
    """Where neither goes up or down, both are noise, and say nothing of each other."""
    rng = np.random.default_rng(9)
    _, told = lap(tmp_path, alt_m=rng.standard_normal(600), vel_u_mps=0.1 * rng.standard_normal(600))
    assert told == {}


@pytest.mark.parametrize("every", [2, 5])
def test_a_velocity_that_is_renewed_less_often_than_the_positions_counts_once(tmp_path: Path, every: int) -> None:
    whole = sound(tmp_path)
    held = np.arange(600) // every * every
    sent = {"speed_mps": np.asarray(whole.speed)[held], "course_deg": np.asarray(whole.course_deg)[held]}
    fixes, said = lap(tmp_path, **sent)
    np.testing.assert_array_equal(np.isfinite(fixes.velocity_n[:, 0]), held == np.arange(600))
    new = f"speed and course are new in one of {every} rows only, and repeated in {600 - 600 // every} rows"
    assert new in said["gps_velocity_repeated"]


@pytest.mark.parametrize("every", [2, 5, 10])
def test_of_a_kart_that_stands_such_a_velocity_is_measured_as_often(tmp_path: Path, every: int) -> None:
    """Positions wander where nothing moves, by noise or as they settle: only the zeros say that it stands."""
    whole = sound(tmp_path)
    # of which no two rows in a row are the same
    stands, wander = np.arange(600) < 200, 3e-6 * np.random.default_rng(6).standard_normal(600)
    held = np.where(stands, 0, np.arange(600) // every * every)
    sent = {
        "speed_mps": np.where(stands, 0.0, np.asarray(whole.speed)[held]),
        "course_deg": np.asarray(whole.course_deg)[held],
        "lat_deg": np.where(stands, whole.lat_deg[200], whole.lat_deg) + wander,
        "lon_deg": np.where(stands, whole.lon_deg[200], whole.lon_deg),
    }
    fixes, said = lap(tmp_path, **sent)
    assert "gps_velocity_repeated" in said
    np.testing.assert_array_equal(np.isfinite(fixes.velocity_n[:, 0]), np.arange(600) % every == 0)


def test_a_coarse_or_steady_velocity_is_repeated_now_and_then_and_stays(tmp_path: Path) -> None:
    whole = sound(tmp_path)
    speed, course = np.asarray(whole.speed), np.asarray(whole.course_deg)
    for step in (0.1, 0.5, 2.0):
        coarse = {"speed_mps": np.round(speed / step) * step, "course_deg": np.round(course / 10.0) * 10.0}
        fixes, said = lap(tmp_path, **coarse)
        assert "gps_velocity_repeated" not in said
        assert np.isfinite(fixes.velocity_n[:, 0]).all()
