"""The graph of some seconds as factors of GTSAM: its optimizers and Marginals find what the loop and the sweep do."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import V, X

from smoother import api
from smoother.errors import UsageError
from smoother.estimate.output.short_graph import ShortGraph
from smoother.prepare import prepare
from smoother.samples import Session


@pytest.fixture(name="session", scope="module")
def _session() -> Session:
    drive = api.simulate("kart", 7, duration=60.0, gnss_outages=(), wheel_rate=20.0, wheel_scale=0.03)
    return prepare(drive.raw)


@pytest.fixture(name="short", scope="module")
def _short(session: Session) -> ShortGraph:
    return api.short_graph(session, 30.0, 6.0)


@pytest.fixture(name="solved", scope="module")
def _solved(short: ShortGraph) -> gtsam.Values:
    values = short.values
    for _ in range(6):
        values = short.step(values)
    return values


def whole(short: ShortGraph, values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    out = gtsam.NonlinearFactorGraph()
    for factors in short.factors(values).values():
        out.push_back(factors)
    return out


def test_it_has_the_rows_of_the_table_that_the_seconds_have(short: ShortGraph) -> None:
    factors = short.factors(short.values)
    assert list(factors) == ["prior", "imu", "gps_position", "gps_velocity", "gps_offset", "wheel_speed"]
    assert factors["imu"].size() == len(short.t) - 1
    keys = set(factors["wheel_speed"].at(0).keys())
    assert {short.keys[name] for name in ("wheel_scale", "wheel_slip", "wheel_side")} < keys
    assert short.t[0] == pytest.approx(30.0, abs=0.2) and short.t[-1] == pytest.approx(36.0, abs=0.2)


def test_optimizers_of_gtsam_end_where_the_loop_ends(short: ShortGraph, solved: gtsam.Values) -> None:
    graph, sigmas = whole(short, solved), short.covariances(solved)
    for optimizer in (gtsam.GaussNewtonOptimizer, gtsam.LevenbergMarquardtOptimizer):
        found = optimizer(graph, short.values).optimize()
        assert graph.error(found) < 0.5 * graph.error(short.values)
        for k in range(len(short.t)):
            apart = found.atVector(V(k)) - solved.atVector(V(k))
            assert np.all(np.abs(apart) < 0.05 * np.sqrt(np.diag(sigmas[V(k)])))
            turn = found.atPose3(X(k)).between(solved.atPose3(X(k)))
            assert np.all(np.abs(gtsam.Pose3.Logmap(turn)) < 0.05 * np.sqrt(np.diag(sigmas[X(k)])))


def test_the_sweep_gives_the_covariances_of_marginals(short: ShortGraph, solved: gtsam.Values) -> None:
    marginals, covariances = gtsam.Marginals(whole(short, solved), solved), short.covariances(solved)
    assert set(covariances) == set(solved.keys())
    for key, covariance in covariances.items():
        expected = marginals.marginalCovariance(key)
        sigma = np.sqrt(np.diag(expected))
        np.testing.assert_allclose(covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-6)


def test_a_robust_weight_is_in_the_noise_of_a_custom_factor(session: Session) -> None:
    short = api.short_graph(session, 30.0, 6.0)
    position = short.graph.measured.position_n
    position[5, 0] += 30.0
    at = short.factors(short.values)["gps_position"]
    shares = [f.whitenedError(short.values) for f in (at.at(i) for i in range(at.size()))]
    limit = np.sqrt(4.5 * 3.0)
    assert np.linalg.norm(shares[5]) == pytest.approx(limit, rel=1e-6)


def test_seconds_outside_the_session_are_an_error(session: Session) -> None:
    with pytest.raises(UsageError, match=r"no keyframes from 500\.0 s on"):
        api.short_graph(session, 500.0, 6.0)
