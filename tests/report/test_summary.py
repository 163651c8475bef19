"""summary.json: complete, and strict JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.judge.quality import Quality
from smoother.frames import euler_from_rotation
from smoother.report.files import to_json
from smoother.report.summary import distance_driven, is_reported, mounting_angles, summary
from smoother.samples import Problem, Session
from smoother.trajectory import Identified, Sigmas, Trajectory

COLUMNS = ("position_n", "velocity_n", "R_nb", "acceleration_b", "angular_rate_b")


@pytest.fixture
def document(session: Session, trajectory: Trajectory) -> dict[str, object]:
    flawed = Session(
        **{**vars(session), "problems": (Problem("row", "1 row dropped"), Problem("row", "1 row dropped"))}
    )
    quality = Quality(False, ("because",), {"far_fix_share": 0.3})
    made = summary(flawed, trajectory, quality, {"reading": 0.1}, {"rate_hz": 50.0})
    return dict(json.loads(to_json(made)))


def test_the_summary_has_the_fields_of_the_contract(document: dict[str, object]) -> None:
    wanted = {"version", "inputs", "counts", "origin", "problems", "identified", "residuals", "quality", "timings"}
    assert wanted <= set(document)
    assert "laps" not in document  # absent until laps are found, not empty


def test_problems_of_reader_and_estimator_stand_once_each(document: dict[str, object]) -> None:
    assert document["problems"] == [
        {"code": "row", "text": "1 row dropped", "count": 1},
        {"code": "short", "text": "a short session", "count": 2},
    ]


def test_identified_values_have_sigma_unit_and_source(document: dict[str, object]) -> None:
    identified = document["identified"]
    assert isinstance(identified, dict)
    assert identified["gps_position_latency"] == {
        "value": 0.12,
        "sigma": 0.01,
        "unit": "s",
        "observable": True,
        "source": "identified",
    }


@pytest.mark.parametrize("R_bs", [np.eye(3), so3.exp(np.array([0.3, -0.4, 1.8])), so3.exp(np.array([2.0, 0.5, -1.0]))])
def test_a_mounting_s_angles_have_the_sigma_that_turns_about_the_kart_s_axes_give_them(R_bs: np.ndarray) -> None:
    sigma, rng = np.array([0.002, 0.004, 0.01]), np.random.default_rng(1)
    angles, sigmas = mounting_angles(Identified(R_bs.tolist(), sigma.tolist(), "1 (sigma: rad)", True, "identified"))
    turned = so3.exp(rng.normal(size=(20_000, 3)) * sigma) @ R_bs
    scattered = np.degrees(np.stack(euler_from_rotation(turned), axis=1)) - angles
    np.testing.assert_allclose(np.std(scattered, axis=0), sigmas, rtol=0.03)


def test_the_verdict_comes_with_its_reasons(document: dict[str, object]) -> None:
    assert document["quality"] == {"passed": False, "reasons": ["because"], "measures": {"far_fix_share": 0.3}}


def test_what_is_typical_is_not_that_of_a_pause(session: Session, trajectory: Trajectory) -> None:
    """Of 200 s of rows the last 165 are of a time without fixes, and a thousand times as unsure."""
    t = np.arange(0.0, 200.0, 0.1)
    rows = np.arange(len(t)) % len(trajectory)
    sigmas = trajectory.sigmas
    assert sigmas is not None
    growth = np.where(t > 35.0, 1000.0, 1.0)
    columns = {name: values[rows] for name, values in vars(trajectory).items() if name in COLUMNS}
    paused = Sigmas(**{name: (values[rows].T * growth).T for name, values in vars(sigmas).items()})
    few = replace(session, gnss=session.gnss.select(session.gnss.t < 6.0))
    made = summary(few, Trajectory(t=t, **columns, sigmas=paused), Quality(True, (), {}), {}, {})
    typical = made["sigma_median"]
    assert isinstance(typical, dict)
    assert typical["speed_mps"] == pytest.approx(0.1)
    assert typical["yaw_deg"] == pytest.approx(np.degrees(0.01))


def test_the_distance_is_that_of_the_antenna_over_ground(session: Session, trajectory: Trajectory) -> None:
    steps = trajectory.position_n[1:, :2] - trajectory.position_n[:-1, :2]
    path = float(((steps**2).sum(axis=1) ** 0.5).sum())
    # the path of the true positions: chords of 20 ms are shorter than the arc by less than 1e-4 of it
    assert distance_driven(trajectory) == pytest.approx(path, rel=1e-3)


def test_nine_numbers_of_the_compass_are_for_the_document_alone() -> None:
    soft = Identified(np.eye(3).tolist(), np.full((3, 3), 0.1).tolist(), "1", True, "identified")
    hard = Identified([1.0, 2.0, 3.0], [0.1, 0.1, 0.1], "of the readings", True, "identified")
    assert not is_reported("mag_soft_iron", soft, "full")
    assert is_reported("mag_hard_iron", hard, "full")
