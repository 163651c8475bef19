"""docs/graph.md: its formulas against the residuals of a solved session, its figures and names against the code's."""

import importlib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from smoother.estimate.graph.arm import course
from smoother.estimate.graph.batch import Batch, DrivenMotion, Linear
from smoother.estimate.graph.expected import ExpectedMotion
from smoother.estimate.graph.increments import left_jacobian_inverse, linearize_increments
from smoother.estimate.graph.inertial import InertialGraph
from smoother.estimate.graph.inputs import Noise
from smoother.estimate.graph.response import evened, low_passed
from smoother.estimate.graph.rows import Rows, ground_rows
from smoother.estimate.graph.session_rows import expected_of
from smoother.estimate.graph.state import CONSTANTS_SIZE, ChainState, Constants

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph import batch as batch_module
from smoother.estimate.model.imu import DensePath, at_times, attitude_at
from smoother.estimate.model.inertial_noise import interval_noise
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.frames import GRAVITY_N, wrap_angle
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "graph.md").read_text(encoding="utf-8")
FIGURES = re.findall(r"^\| `(\w+)\.(\w+)` \| ([-\d.e]+)( deg)?", TEXT.partition("## Figures")[2], re.MULTILINE)


@pytest.mark.parametrize(("module", "name", "value", "unit"), FIGURES, ids=[f"{m}.{n}" for m, n, *_ in FIGURES])
def test_its_figures_are_those_of_the_code(module: str, name: str, value: str, unit: str) -> None:
    place = GraphOptions() if module == "GraphOptions" else importlib.import_module(f"smoother.estimate.graph.{module}")
    assert float(value) * (DEG if unit else 1.0) == pytest.approx(getattr(place, name), rel=1e-12)


def test_it_has_figures_and_whatever_it_names_is_there() -> None:
    assert len(FIGURES) > 40
    graph = ROOT / "smoother" / "estimate" / "graph"
    modules = {path.stem for path in graph.glob("*.py")}
    for module, name in re.findall(r"`(\w+)\.(\w+)`", TEXT):
        if module in modules and name != "py":
            assert hasattr(importlib.import_module(f"smoother.estimate.graph.{module}"), name), f"{module}.{name}"
    for name in re.findall(r"`([\w/]+\.py)`", TEXT):
        assert any((place / name).is_file() for place in (graph, graph.parent, ROOT)), name


@dataclass(frozen=True, eq=False)
class Linearized:
    """What the last linearisation of a session was made of, and the rows that came out."""

    batch: Batch
    graph: InertialGraph
    state: ChainState
    noise: Noise
    rows: dict[str, Rows]
    path: DensePath
    felt: ExpectedMotion

    @property
    def constants(self) -> Constants:
        return self.state.constants


@pytest.fixture(name="last", scope="module")
def last_fixture() -> Linearized:
    """The last step of a simulated kart that stands still at first: with wheels, and constants away from zero."""
    made = {}
    linearize = Batch.linear

    def kept(
        self: Batch, graph: InertialGraph, state: ChainState, noise: Noise, *motion: DrivenMotion, **how: bool
    ) -> Linear:
        out = linearize(self, graph, state, noise, *motion, **how)
        made.update(batch=self, graph=graph, state=state, noise=noise, rows=out.rows)
        return out

    simulation = simulate_preset("kart", seed=3, track="tinbarn", duration=80.0, motion_standstill=10.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch_module.Batch, "linear", kept)
        GraphSmoother().estimate(prepare(simulation.raw))
    path = made["batch"].path(made["state"])
    return Linearized(**made, path=path, felt=expected_of(made["batch"]._data, path, made["state"], made["noise"]))


@dataclass(frozen=True, eq=False)
class Between:
    """Keyframe before, share of the interval gone by, position and velocity on the cubic at times (N,)."""

    k: np.ndarray
    share: Array
    position_n: Array
    velocity_n: Array


def between(state: ChainState, t: Array) -> Between:
    T, p, v = state.interval, state.position_n, state.velocity_n
    k = np.floor((t - state.t[0]) / T).astype(int)
    s = (t - state.t[k])[:, None] / T
    position = (2 * s**3 - 3 * s**2 + 1) * p[k] + T * (s**3 - 2 * s**2 + s) * v[k]
    position += (3 * s**2 - 2 * s**3) * p[k + 1] + T * (s**3 - s**2) * v[k + 1]
    velocity = (6 * s**2 - 6 * s) / T * (p[k] - p[k + 1])
    velocity += (3 * s**2 - 4 * s + 1) * v[k] + (3 * s**2 - 2 * s) * v[k + 1]
    return Between(k, s[:, 0], position, velocity)


def inside(last: Linearized) -> np.ndarray:
    t = last.batch._data.t
    return (t - 0.5 > last.state.t[0]) & (t < last.state.t[-1])


def level(last: Linearized, values: Array, t: Array) -> Array:
    return np.column_stack([*at_times(last.path, values[:, :2], t).T, 0.0 * t])


def test_it_names_every_factor(last: Linearized) -> None:
    assert {"gps_position", "gps_velocity", "slip", "heading", "standstill"} <= set(last.rows)
    for name in (*last.rows, "ground"):
        assert f"`{name}`" in TEXT


def test_inertial(last: Linearized) -> None:
    state, done, T = last.state, last.graph._increments, last.state.interval
    bias = np.hstack([state.accel_bias_s, state.gyro_bias_s])
    moved = np.einsum("nqij,nj->nqi", done.by_bias, bias[:-1] - np.r_[done.accel_bias, done.gyro_bias])
    R, R_next, p, v = state.R_ns[:-1], state.R_ns[1:], state.position_n, state.velocity_n
    gained = [np.einsum("kij,kj->ki", R, done.shift[:, i] + moved[:, 1 + i]) for i in range(2)]
    r_R = so3.log(R_next.transpose(0, 2, 1) @ R @ so3.exp(done.turn + moved[:, 0]))
    ahead = p[:-1] + T * v[:-1] + 0.5 * T**2 * GRAVITY_N + gained[0] - p[1:], v[:-1] + T * GRAVITY_N + gained[1] - v[1:]
    r_p, r_v = (np.einsum("kij,klj,kl->ki", left_jacobian_inverse(r_R), R_next, miss) for miss in ahead)
    want = np.hstack([r_R, r_p, r_v, bias[:-1] - bias[1:]])
    np.testing.assert_allclose(linearize_increments(done, state).residual, want, atol=1e-12)


def test_inertial_covariance(last: Linearized) -> None:
    """Of white noise and walks over an interval at rest, where force hardly leans; and densities, also in holes."""
    noise, T, binned = last.noise.inertial, last.state.interval, last.batch._binned
    assert binned.rough is not None
    assert binned.blind is not None
    holes = binned.missing
    u = (1.0 - np.exp(-binned.blind)) * np.sqrt(np.minimum(binned.blind, 2.0))
    assert noise.local is not None
    place = np.interp(0.5 * (binned.t[1:] + binned.t[:-1]), noise.local.t, noise.local.ratio)
    assert np.ptp(place) > 0.2
    q2_a = noise.accel**2 * place * (1.0 + noise.accel_share * (binned.rough[:, 0] - 1.0))
    q2_a += holes * (8.0 * u[:, 0]) ** 2
    q2_g = noise.gyro**2 * (1.0 + noise.gyro_share * (binned.rough[:, 1] - 1.0)) + holes * (0.5 * u[:, 1]) ** 2
    assert 0.0 < np.mean(holes > 0.0) < 0.1
    for q2, density in zip((q2_a, q2_g), interval_noise(binned, noise), strict=True):
        np.testing.assert_allclose(density**2, q2)
    speed = np.linalg.norm(last.state.velocity_n[:-1], axis=1)
    k = int(np.argmin(np.where(holes == 0.0, speed, np.inf)))
    own = np.diag(np.linalg.inv(_information(last)[k]))
    assert np.sum(own[0:3]) == pytest.approx(3.0 * q2_g[k] * T, rel=0.05)
    assert np.sum(own[6:9]) == pytest.approx(3.0 * q2_a[k] * T, rel=0.1)
    np.testing.assert_allclose(own[9:12], noise.accel_bias_walk**2 * T, rtol=1e-6)
    np.testing.assert_allclose(own[12:15], noise.gyro_bias_walk**2 * T, rtol=1e-6)


def _information(last: Linearized) -> Array:
    """Of the inertial residuals, (K-1, 15, 15)."""
    whitening = last.graph._whitening(last.noise.inertial)
    return np.asarray(whitening.transpose(0, 2, 1) @ whitening)


def test_gps_position(last: Linearized) -> None:
    data, state, c = last.batch._data, last.state, last.constants
    use = inside(last)
    t = data.t[use]
    at, R = between(state, t - c.position_latency), attitude_at(last.path, t - c.position_latency)
    later = np.clip((t - last.batch._priors.constants[0] - state.t[at.k]) / state.interval, 0.0, 1.0)[:, None]
    offset = (1.0 - later) * state.offset_n[at.k] + later * state.offset_n[at.k + 1]
    want = at.position_n + R @ c.lever_arm_s + offset - data.position_n[use]
    np.testing.assert_allclose(last.rows["gps_position"].residual[use], want, atol=1e-9)
    sigma = data.position_scale[use, None] * last.noise.position
    np.testing.assert_allclose(last.rows["gps_position"].sigma[use], sigma)


def test_doppler_velocity(last: Linearized) -> None:
    data, state, c, felt, path = last.batch._data, last.state, last.constants, last.felt, last.path
    use, dt, rho = inside(last), last.path.t[1] - last.path.t[0], last.constants.velocity_response
    t = data.t[use] - c.velocity_latency
    arm_n = attitude_at(path, t) @ c.lever_arm_s
    swing = np.interp(t, path.t, felt.turn_rate)[:, None] * np.column_stack([-arm_n[:, 1], arm_n[:, 0], 0.0 * t])
    assert felt.followed is not None
    beta = rho * level(last, np.gradient(felt.followed.acceleration_n, dt, axis=0), t)
    u = min(max((rho - 0.001) / 0.003, 0.0), 1.0)
    if u > 0.0:
        tau, arm = math.sqrt(2.0 * rho), path.R_ns @ c.lever_arm_s
        x = felt.followed.velocity_n[:, :2]
        x = x + felt.followed.turn_rate[:, None] * np.column_stack([-arm[:, 1], arm[:, 0]])
        y, z = level(last, low_passed(x, dt, tau), t + tau), level(last, evened(x, dt, tau), t)
        rounded = (1.0 - c.evenness) * y + c.evenness * z - level(last, x, t)
        beta = beta + u**2 * (3.0 - 2.0 * u) * (rounded - beta)
    arm = path.R_ns @ c.lever_arm_s
    u = felt.slow.velocity_n[:, :2] + felt.slow.turn_rate[:, None] * np.column_stack([-arm[:, 1], arm[:, 0]])
    psi = course(u)
    angle = np.interp(t - c.course_delay, path.t, psi) - np.interp(t, path.t, psi)
    assert np.max(np.abs(angle)) > 1e-5
    antenna = (between(state, t).velocity_n + swing)[:, :2] @ [1.0, 1.0j] * np.exp(1.0j * angle)
    want = np.column_stack([antenna.real, antenna.imag, 0.0 * t]) + beta + c.doppler_bias_n - data.velocity_n[use]
    np.testing.assert_allclose(last.rows["gps_velocity"].residual[use, :2], want[:, :2], atol=1e-9)


def test_the_loss(last: Linearized) -> None:
    for name in ("gps_position", "gps_velocity", "slip"):
        rows = last.rows[name]
        known = np.isfinite(rows.sigma)
        q, m = np.sum(np.where(known, rows.residual / rows.sigma, 0.0) ** 2, axis=1), known.sum(axis=1)
        np.testing.assert_allclose(rows.weight, np.minimum(1.0, 9.0 * m / (2.0 * np.maximum(q, 1e-9))), rtol=1e-9)
    for name in set(last.rows) - {"gps_position", "gps_velocity", "slip", "slip_start"}:
        np.testing.assert_array_equal(last.rows[name].weight, 1.0)


def test_slow_offset(last: Linearized) -> None:
    o, sigma = last.state.offset_n, last.noise.offset_sigma
    phi = math.exp(-last.state.interval / last.noise.offset_tau)
    steps, start = last.rows["gps_offset"], last.rows["gps_offset_start"]
    np.testing.assert_allclose(steps.residual, o[1:] - phi * o[:-1], atol=1e-12)
    np.testing.assert_allclose(steps.sigma[0], sigma * math.sqrt(1.0 - phi**2))
    np.testing.assert_allclose((start.residual[0], start.sigma[0]), (o[0], sigma))


def test_wheels(last: Linearized) -> None:
    state, c, T, v = last.state, last.constants, last.state.interval, last.state.velocity_n
    quick = np.maximum(np.hypot(v[:, 0], v[:, 1]), 4.0)
    left_n = np.column_stack([-v[:, 1], v[:, 0], 0.0 * quick]) / quick[:, None]
    jerk_n = np.gradient(last.felt.acceleration_n, last.path.t[1] - last.path.t[0], axis=0)
    a, j = (
        np.sum(left_n * at_times(last.path, values, state.t), axis=1) for values in (last.felt.acceleration_n, jerk_n)
    )
    L = np.sqrt(0.3**2 + (a / 10.0) ** 2 + (j / 25.0) ** 2)
    ahead_n = state.R_ns @ c.level_axes_s[0]
    beside = np.arctan2(v[:, 1], v[:, 0]) - np.arctan2(ahead_n[:, 1], ahead_n[:, 0])
    usual = c.slip[0] + c.slip[1] * a + c.slip[2] * j + c.slip[3] * a / quick**2
    s, own = wrap_angle(beside - usual) / L, 0.05 / quick / L
    rows, phi, k = last.rows["slip"], math.exp(-T / 2.0), last.rows["slip"].interval
    assert last.noise.slip is not None
    assert len(k) > 200
    np.testing.assert_allclose(rows.residual[:, 0], s[k + 1] - phi * s[k], atol=1e-12)
    variance = last.noise.slip.sigma**2 * (1.0 - phi**2) + own[k + 1] ** 2 + phi**2 * own[k] ** 2
    np.testing.assert_allclose(rows.sigma[:, 0] ** 2, variance)
    begins = last.rows["slip_start"].interval
    np.testing.assert_allclose(last.rows["slip_start"].residual[:, 0], s[begins], atol=1e-12)
    np.testing.assert_allclose(last.rows["slip_start"].sigma[:, 0] ** 2, last.noise.slip.sigma**2 + own[begins] ** 2)


def test_heading_standstill_and_ground(last: Linearized) -> None:
    state, heading = last.state, last.batch._data.heading
    assert heading is not None
    field_n = np.einsum("nij,nj->ni", state.R_ns[heading.interval], heading.field_s)
    want = np.arctan2(field_n[:, 1], field_n[:, 0]) - heading.field_yaw - last.constants.heading_offset
    np.testing.assert_allclose(last.rows["heading"].residual[:, 0], wrap_angle(want), atol=1e-12)
    rows, k = last.rows["standstill"], last.rows["standstill"].interval
    turn = so3.log(state.R_ns[k].transpose(0, 2, 1) @ state.R_ns[k + 1])
    np.testing.assert_allclose(rows.residual, np.hstack([state.velocity_n[k], turn]), atol=1e-12)
    np.testing.assert_allclose(rows.sigma, np.tile(np.repeat([0.02, 3e-4], 3), (len(k), 1)))
    at = np.array([3, 30])
    ground = ground_rows(state, 1.0, at, np.array([2.0, -1.0])).residual[:, 0]
    np.testing.assert_allclose(ground, state.position_n[at, 2] + state.offset_n[at, 2] - [2.0, -1.0])


def test_priors(last: Linearized) -> None:
    state, priors = last.state, last.batch._priors
    bias = np.concatenate([state.accel_bias_s[0], state.gyro_bias_s[0] - priors.gyro_bias_mean])
    np.testing.assert_allclose(last.rows["bias_prior"].residual[0], bias, atol=1e-12)
    np.testing.assert_array_equal(last.rows["pose_prior"].residual, 0.0)
    assert priors.holds_height
    assert sum(_sizes()) == CONSTANTS_SIZE


def _sizes() -> Iterator[int]:
    """How many numbers the table of constants has in each of its rows."""
    table = TEXT.partition("And 31 constants")[2].partition("## What is solved")[0]
    for row in re.findall(r"^\| \$.*$", table, re.MULTILINE):
        symbol, code = (cell.strip() for cell in row.split("|")[1:3])
        size = re.search(r"\((\d)(?: × (\d))?\)", f"{symbol} {code}")
        yield code.count("`") // 2 if size is None else math.prod(int(n) for n in size.groups() if n)
