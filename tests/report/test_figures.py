"""Figures: which are drawn for which session, and that nothing in a name or in the data spoils them."""

import itertools
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib import image
from matplotlib.collections import LineCollection
from matplotlib.colorbar import Colorbar
from matplotlib.patches import Rectangle

from smoother.cli.directories import FIGURE_NAMES
from smoother.frames import rotation_from_euler
from smoother.report import figures, style
from smoother.report.drawing import Shown
from smoother.report.figures import FIGURES, overview, save_figures
from smoother.samples import Session
from smoother.trajectory import EstimateReport, Trajectory
from smoother.units import STANDARD_GRAVITY


def gps_only(trajectory: Trajectory) -> Trajectory:
    n = len(trajectory)
    unknown = np.full((n, 3), np.nan)
    report = EstimateReport(mode="gps-only", fixes=trajectory.report.fixes)
    blank = {"R_nb": np.full((n, 3, 3), np.nan), "acceleration_b": unknown, "angular_rate_b": unknown, "report": report}
    return Trajectory(**{**vars(trajectory), **blank})


def names(paths: list[Path]) -> list[str]:
    return [path.stem for path in paths]


def test_a_full_session_gets_every_figure_the_main_one_first(
    tmp_path: Path, session: Session, trajectory: Trajectory
) -> None:
    shares: list[float] = []
    paths = save_figures(Shown(session, trajectory, trajectory, "a session"), tmp_path, shares.append)
    assert names(paths) == list(FIGURES) == list(FIGURE_NAMES)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    for path in paths:
        pixels = image.imread(path)
        assert pixels.shape[1] >= 1300
        assert pixels[..., :3].std() > 0.05  # not blank


def test_a_gps_only_session_gets_the_figures_it_has_data_for(
    tmp_path: Path, session: Session, trajectory: Trajectory
) -> None:
    (tmp_path / "attitude.png").write_bytes(b"of an earlier run")
    paths = save_figures(Shown(session, gps_only(trajectory), None, "a session"), tmp_path)
    assert names(paths) == ["overview", "track", "speed", "residuals", "sigma"]
    assert not (tmp_path / "attitude.png").exists()


@pytest.mark.parametrize("heading", ["costs $1 or $\\frac{", "東京 Ō 🏎", "<script>", "%s {0}"])
def test_a_name_is_text_and_never_markup(
    tmp_path: Path, session: Session, trajectory: Trajectory, heading: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "FIGURES", {"overview": overview})  # all headings are made alike
    assert save_figures(Shown(session, gps_only(trajectory), None, heading), tmp_path)


@pytest.mark.parametrize(
    "name", ["monday", "Simulated session (kart_harsh, longmeadow)", "a long name of a session " * 5]
)
def test_a_heading_stays_on_the_figure(name: str) -> None:
    figure = style.new_figure(
        f"What the smoother expected minus each fix: {name} · 4 min 0 s, 4.85 km", is_laid_out=False
    )
    figure.draw_without_rendering()
    heading = figure._suptitle  # type: ignore[attr-defined]
    assert heading.get_window_extent().x1 < figure.bbox.x1
    assert heading.get_fontsize() == 13.0 or len(name) > 10


def test_the_map_keeps_to_the_track_when_fixes_and_baseline_stray(session: Session, trajectory: Trajectory) -> None:
    astray = Trajectory(**{**vars(trajectory), "position_n": trajectory.position_n * 1e4})
    figure = overview(Shown(session, trajectory, astray, "a session"))
    figure.canvas.draw()
    east = -trajectory.position_n[:, 1]
    for axes in figure.axes[:2]:
        left, right = axes.get_xlim()
        assert right - left < 4.0 * np.ptp(east)


def test_a_session_of_two_rows_can_be_drawn(tmp_path: Path, session: Session, trajectory: Trajectory) -> None:
    two = {name: value[:2] for name, value in vars(trajectory).items() if isinstance(value, np.ndarray)}
    saved = save_figures(Shown(session, Trajectory(**two), None, "short"), tmp_path)
    assert {path.stem for path in saved} >= {"overview", "track", "speed"}
    assert all(path.stat().st_size > 1000 for path in saved)


def test_drawing_leaves_matplotlib_as_it_was(
    tmp_path: Path, session: Session, trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "FIGURES", {"overview": overview})
    before = dict(matplotlib.rcParams)
    save_figures(Shown(session, gps_only(trajectory), None, "a session"), tmp_path)
    assert dict(matplotlib.rcParams) == before


def test_thinning_keeps_every_peak_and_bounds_the_points() -> None:
    t = np.arange(100_000) / 50.0
    value = np.sin(t / 100.0)
    value[51_234] = 30.0
    value[77_777] = -30.0
    thin_t, thin = style.thinned(t, value, points=2000)
    assert len(thin_t) <= 2100
    assert thin.max() == 30.0
    assert thin.min() == -30.0
    assert np.all(np.diff(thin_t) > 0.0)
    assert (thin_t[0], thin_t[-1]) == (t[0], t[-1])


def test_a_running_median_removes_what_swings_five_times_a_second_and_keeps_what_lasts() -> None:
    t = np.arange(2000) / 50.0
    swinging = 0.14 + 0.01 * np.cos(2.0 * np.pi * 5.0 * t) + np.where(t > 20.0, 1.0, 0.0)
    median = style.running_median(t, swinging, seconds=1.0)
    np.testing.assert_allclose(median[(t > 0.5) & (t < 19.5)], 0.14, atol=0.004)
    np.testing.assert_allclose(median[(t > 20.5) & (t < 39.4)], 1.14, atol=0.004)
    unknown = np.append(swinging, np.nan)
    np.testing.assert_array_equal(style.running_median(np.append(t, 40.0), unknown, seconds=1.0), unknown)
    np.testing.assert_array_equal(style.running_median(t[:1], swinging[:1], seconds=1.0), swinging[:1])


def test_a_path_without_a_point_has_none_to_thin() -> None:
    """As fixes have none around a corner that an outage covers."""
    assert [len(values) for values in style.thinned_path(*np.empty((3, 0)), step=1.0)] == [0, 0, 0]


def test_a_thinned_path_keeps_its_ends_and_leaves_no_hole_and_no_crowd() -> None:
    way = np.concatenate([np.zeros(50), np.linspace(0.0, 100.0, 2001), [140.0]])  # a stand, a drive, a jump
    x, y, which = style.thinned_path(way, 2.0 * way, np.arange(len(way)), step=1.0)
    assert (which[0], which[-1]) == (0, len(way) - 1)
    apart = np.hypot(np.diff(x), np.diff(y))
    assert np.all(apart[:-2] > 0.8)
    assert np.all(apart[:-2] < 1.2)
    assert len(which) == pytest.approx(100.0 * np.sqrt(5.0), abs=4)


def test_ticks_are_drawn_where_matplotlib_would_put_them(tmp_path: Path) -> None:
    with matplotlib.rc_context(style.SETTLED):
        figure = style.new_figure("ticks", is_laid_out=False)
        upper, lower = style.rows(figure, 2)
        for axes in (upper, lower):
            axes.set_ylim(0.3, 40.0)
            axes.set_xlim(0.0, 610.0)
            style.clock_axis(axes, 610.0)
        upper.tick_params(labelbottom=False)
        style.logarithmic(upper)
        style.save(figure, tmp_path / "ticks.png")
    said = [[text.get_text() for text in axes.texts] for axes in (upper, lower)]
    assert said[0] == ["0.5", "1", "2", "5", "10", "20"]
    assert said[1] == ["0:00", "2:00", "4:00", "6:00", "8:00", "10:00", "10", "20", "30", "40"]


def test_labels_of_panels_above_one_another_stand_in_one_line_and_on_the_paper(
    tmp_path: Path, session: Session, trajectory: Trajectory
) -> None:
    for name, draw in FIGURES.items():
        figure = draw(Shown(session, trajectory, trajectory, "a session"))
        assert figure is not None, name
        style.save(figure, tmp_path / "figure.png")
        columns: dict[float, list[float]] = {}
        for axes in figure.axes:
            if axes.get_ylabel():
                label = axes.yaxis.label.get_window_extent()
                assert label.x0 > 5.0, (name, axes.get_ylabel())
                columns.setdefault(round(axes.get_position().x0, 3), []).append(label.x1)
        for right_edges in columns.values():
            assert np.ptp(right_edges) < 1.0, name


def test_thinning_lives_with_stretches_that_are_unknown() -> None:
    t = np.arange(10_000.0)
    value = np.where((t > 2000) & (t < 8000), np.nan, 1.0)
    _, thin = style.thinned(t, value, points=500)
    assert np.isnan(thin).any()
    assert np.isfinite(thin).any()


@pytest.mark.parametrize(
    ("seconds", "step", "text"),
    [
        (0.0, 1.0, "0:00"),
        (65.0, 5.0, "1:05"),
        (59.5, 0.5, "0:59.5"),
        (3661.0, 600.0, "1:01:01"),
        (119.9999999999, 1.0, "2:00"),
    ],
)
def test_the_clock_reads_minutes_and_seconds(seconds: float, step: float, text: str) -> None:
    assert style.clock(seconds, step) == text


def test_a_heading_that_turns_faster_than_pixels_can_show_is_still_drawn(
    session: Session, trajectory: Trajectory
) -> None:
    n = 20_000
    yaw = np.linspace(0.0, 2.0 * np.pi * n / 15, n)  # fifteen rows to a turn, a turn to half a pixel
    zero = np.zeros((n, 3))
    R_nb = rotation_from_euler(0.0 * yaw, 0.0 * yaw, yaw)
    turning = Trajectory(np.linspace(0.0, 86400.0, n), zero, zero, R_nb, zero, zero)
    figure = figures.attitude(Shown(session, turning, None, "a day"))
    assert figure is not None
    degrees = np.asarray(figure.axes[2].lines[0].get_ydata(), dtype=np.float64)
    assert np.mean(np.isfinite(degrees)) > 0.9
    assert np.ptp(degrees[np.isfinite(degrees)]) > 300.0


@pytest.mark.parametrize(("tilt", "said"), [(0.0, "baseline"), (30.0, "baseline, in places off the scale")])
def test_attitudes_of_the_baseline_that_leave_the_axes_are_noted(
    session: Session, trajectory: Trajectory, tilt: float, said: str
) -> None:
    roll, pitch, yaw = trajectory.euler.T
    tilted = replace(trajectory, R_nb=rotation_from_euler(roll + np.radians(tilt), pitch, yaw))
    figure = figures.attitude(Shown(session, trajectory, tilted, "a session"))
    assert figure is not None
    legend = figure.axes[0].get_legend()
    assert legend is not None and [text.get_text() for text in legend.get_texts()] == [said, "smoothed"]


def test_the_band_of_an_attitude_lies_inside_its_axes(session: Session, trajectory: Trajectory) -> None:
    assert trajectory.sigmas is not None
    unsure = replace(trajectory, sigmas=replace(trajectory.sigmas, attitude=np.full((len(trajectory), 3), 0.2)))
    figure = figures.attitude(Shown(session, unsure, None, "a session"))
    assert figure is not None
    for i in range(2):
        low, high = figure.axes[i].get_ylim()
        angle = np.degrees(trajectory.euler[:, i])
        assert low < angle.min() - np.degrees(0.4) and angle.max() + np.degrees(0.4) < high


@pytest.mark.parametrize("spike", [0.0, 9.0])
def test_spikes_cut_by_the_axes_of_accelerations_are_noted(
    session: Session, trajectory: Trajectory, spike: float
) -> None:
    acceleration = np.clip(trajectory.acceleration_b, -1.0, 1.0)
    acceleration[700, 2] = spike * STANDARD_GRAVITY
    figure = figures.accelerations(Shown(session, replace(trajectory, acceleration_b=acceleration), None, "a session"))
    assert figure is not None
    told = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert told == (["spikes go on to 9 g"] if spike else [])


def test_the_frame_on_the_map_is_what_the_close_up_shows(
    tmp_path: Path, session: Session, trajectory: Trajectory
) -> None:
    corner = trajectory.rows(slice(600, 850))  # so short that the close-up, which is wider than high, shows more
    for draw, drive in itertools.product((overview, figures.track), (trajectory, corner)):
        with matplotlib.rc_context(style.SETTLED):
            figure = draw(Shown(session, drive, drive, "a session"))
            style.save(figure, tmp_path / "figure.png")  # after which limits are final
        (whole,) = (axes for axes in figure.axes if axes.patches)
        (close,) = (axes for axes in figure.axes if axes.get_title(loc="left").startswith("Corner at"))
        (frame,) = (patch for patch in whole.patches if isinstance(patch, Rectangle))
        left, bottom, width, height = frame.get_bbox().bounds
        np.testing.assert_allclose((left, left + width), close.get_xlim(), rtol=1e-9)
        np.testing.assert_allclose((bottom, bottom + height), close.get_ylim(), rtol=1e-9)
        (west, east), (south, north) = whole.get_xlim(), whole.get_ylim()
        assert west <= left < left + width <= east and south <= bottom < bottom + height <= north


@pytest.fixture(scope="module")
def spiked(trajectory: Trajectory) -> Trajectory:
    """It with spikes that are known to be unsure."""
    assert trajectory.sigmas is not None
    velocity, sigma = trajectory.velocity_n.copy(), trajectory.sigmas.speed.copy()
    velocity[500:520], sigma[500:520] = [120.0, 0.0, 0.0], 100.0
    return replace(trajectory, velocity_n=velocity, sigmas=replace(trajectory.sigmas, speed=sigma))


def test_a_spike_that_is_not_sure_is_left_out_of_the_scale_of_speed(
    session: Session, trajectory: Trajectory, spiked: Trajectory
) -> None:
    assert _speed_limits(session, spiked) == pytest.approx(_speed_limits(session, trajectory))


def test_a_spike_that_is_not_sure_is_left_out_of_the_colours_of_the_map(
    session: Session, trajectory: Trajectory, spiked: Trajectory
) -> None:
    plain, bar = (_colours(session, one) for one in (trajectory, spiked))
    assert bar.vmax == pytest.approx(plain.vmax, rel=0.02)  # ends of lines beside the spike are thinned otherwise
    assert (plain.extend, bar.extend) == ("neither", "max")


def _colours(session: Session, trajectory: Trajectory) -> Colorbar:
    figure = overview(Shown(session, trajectory, None, "x"))
    (line,) = (line for line in figure.axes[0].collections if isinstance(line, LineCollection))
    assert line.colorbar is not None
    return line.colorbar


def test_a_receiver_without_speed_is_not_named_beside_the_speed(session: Session, trajectory: Trajectory) -> None:
    unknown = np.full_like(session.gnss.velocity_n, np.nan)
    mute = replace(session, gnss=replace(session.gnss, velocity_n=unknown))
    for one, named in ((session, ["GPS", "smoothed"]), (mute, ["smoothed"])):
        legend = figures.speed(Shown(one, trajectory, None, "x")).axes[0].get_legend()
        assert legend is not None and [text.get_text() for text in legend.get_texts()] == named


def _speed_limits(session: Session, trajectory: Trajectory) -> tuple[float, float]:
    return figures.speed(Shown(session, trajectory, None, "x")).axes[0].get_ylim()
