"""Every residual against its formula, every Jacobian against a numerical one, at random states."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.graph.expected import ExpectedMotion, Motion, expected_motion
from smoother.estimate.graph.heading import Heading
from smoother.estimate.graph.imu import BinnedImu, DensePath, dense_path
from smoother.estimate.graph.inertial_noise import InertialNoise
from smoother.estimate.graph.rows import (
    Rows,
    after_step,
    bracket,
    ground_rows,
    heading_rows,
    hermite_position,
    hermite_velocity,
    offset_rows,
    position_rows,
    prior_row,
    standstill_rows,
    velocity_rows,
)
from smoother.estimate.graph.state import (
    ACCEL_BIAS,
    CONSTANTS_SIZE,
    COURSE_DELAY,
    EVENNESS,
    GYRO_BIAS,
    KEYFRAME_SIZE,
    LEVER_ARM,
    OFFSET,
    POSITION_LATENCY,
    ROTATION,
    ROW_CONSTANTS_SIZE,
    TRANSLATION,
    VELOCITY,
    VELOCITY_LATENCY,
    VELOCITY_RESPONSE,
    ChainState,
    Constants,
)
from smoother.frames import GRAVITY_N

# Many bins: between their edges the turn rate is read off a straight line, which is not what is tested here
K, T, N_BINS = 7, 0.2, 200
START = 3.0
TIMES = START + np.array([0.23, 0.31, 0.59, 0.6, 0.87, 1.03, 1.199])
N = len(TIMES)


def random_state(seed: int, turning: float) -> tuple[ChainState, BinnedImu]:
    """Keyframes on a random cubic, whose velocities contradict their inertial samples by decimetres.

    turning: rad/s about up; without it the box keeps one random attitude, and every Jacobian is exact.
    """
    rng = np.random.default_rng(seed)
    t = START + T * np.arange(K)
    R0 = so3.exp(rng.normal(size=3))
    rate = turning * R0[2]
    R_ns = R0 @ so3.exp((t - START)[:, None] * rate)
    size = np.array([1.0, 10.0, 3.0, 2.0])
    position, velocity = np.empty((K, 3)), np.empty((K, 3))
    for i in range(3):
        axis = np.polynomial.Polynomial(size * rng.normal(size=4))
        position[:, i], velocity[:, i] = axis(t - START), axis.deriv()(t - START)
    accel_bias, gyro_bias = np.tile(0.3 * rng.normal(size=3), (K, 1)), np.tile(0.1 * rng.normal(size=3), (K, 1))
    constants = Constants(
        rng.uniform(0.02, 0.2),
        rng.uniform(0.02, 0.2),
        0.5 * rng.normal(size=3),
        heading_offset=rng.normal(),
        doppler_bias_n=0.1 * rng.normal(size=3),
        accel_error=0.01 * rng.normal(size=(3, 2)),
        gyro_error=0.01 * rng.normal(size=3),
    )
    state = ChainState(t, R_ns, position, velocity, accel_bias, gyro_bias, rng.normal(size=(K, 3)), constants)
    force = np.einsum("kji,kj->ki", R_ns[:-1], 3.0 * rng.normal(size=(K - 1, 3)) - GRAVITY_N) + accel_bias[0]
    rates = np.broadcast_to(rate + gyro_bias[0], (K - 1, N_BINS, 3))
    no = np.zeros(K - 1)
    return state, BinnedImu(t, T / N_BINS, np.repeat(force[:, None], N_BINS, axis=1), rates, no)


def path_of(state: ChainState, binned: BinnedImu) -> DensePath:
    return dense_path(binned, state.R_ns, state.position_n, state.velocity_n, state.accel_bias_s, state.gyro_bias_s)


def numerical(make: Callable[[ChainState], Rows], state: ChainState) -> list[np.ndarray]:
    """Jacobians of every row by its left and right keyframe and by the constants, by central differences."""
    size = K * KEYFRAME_SIZE

    def moved(x: np.ndarray) -> np.ndarray:
        constants = np.zeros(CONSTANTS_SIZE)
        constants[:ROW_CONSTANTS_SIZE] = x[size:]
        return make(state.retract(x[:size].reshape(K, KEYFRAME_SIZE), constants)).residual

    J = so3.numerical_jacobian(moved, np.zeros(size + ROW_CONSTANTS_SIZE), step=1e-5)
    by_keyframe = J[:, :, :size].reshape(*J.shape[:2], K, KEYFRAME_SIZE)
    rows = make(state)
    row = np.arange(len(rows.interval))
    ends = [by_keyframe[row, :, rows.interval + i] for i in range(2)]
    others = by_keyframe.copy()
    for i in range(2):
        others[row, :, rows.interval + i] = 0.0
    np.testing.assert_allclose(others, 0.0, atol=1e-8)  # nothing but the keyframes around it moves a row; rounding does
    by_constants = J[:, :, size:]
    if rows.name == "gps_velocity":
        by_constants[:, 2, VELOCITY_LATENCY] = 0.0  # left out on purpose: a bounce is not to be fitted by a delay
        less = replace(
            state, constants=replace(state.constants, velocity_response=-1e-5)
        )  # above 0 it bends, as a root
        by_constants[:, :, VELOCITY_RESPONSE.start] = (rows.residual - make(less).residual) / 1e-5
    return [*ends, by_constants]


def assert_jacobians(make: Callable[[ChainState], Rows], state: ChainState, tolerance: float = 1e-7) -> None:
    """Every column of every row. `tolerance` is of the largest entry of a row's Jacobian."""
    rows = make(state)
    analytic = [rows.left, rows.right, rows.constants]
    for name, have, want in zip(("left", "right", "constants"), analytic, numerical(make, state), strict=True):
        scale = np.maximum(1.0, np.max(np.abs(want), axis=(1, 2), keepdims=True))
        np.testing.assert_allclose(have / scale, want / scale, rtol=0.0, atol=tolerance, err_msg=name)


def turn_without_bias(state: ChainState, path: DensePath, gyro: np.ndarray) -> np.ndarray:
    """What the rows of the receiver are given: turns about up at the edges, the bias of their interval removed."""
    rate_s = gyro - state.gyro_bias_s[np.minimum(np.arange((K - 1) * N_BINS + 1) // N_BINS, K - 2)]
    return np.sum(path.R_ns[:, 2, :] * rate_s, axis=1)


def felt_on(path: DensePath, state: ChainState, turn_rate: np.ndarray) -> ExpectedMotion:
    """The given turn about up (M,), and the velocity and acceleration of the cubic that the keyframes are on."""
    cubics = [np.polynomial.Polynomial.fit(state.t, axis, 3) for axis in state.position_n.T]
    velocity_n, acceleration_n = (np.stack([axis.deriv(m)(path.t) for axis in cubics], axis=1) for m in (1, 2))
    return ExpectedMotion(velocity_n, acceleration_n, turn_rate)


def swinging(
    constants: Constants, K: int = K
) -> tuple[ChainState, DensePath, ExpectedMotion, Callable[..., np.ndarray]]:
    """Keyframes on a level chicane at 1 Hz, their path and the motion; and that motion's derivative m at t, (N, 3)."""
    t, pace = START + T * np.arange(K), 2.0 * np.pi

    def swing(t: np.ndarray, m: int) -> np.ndarray:
        phase = pace * t + 0.5 * np.pi * m
        return 0.4 * pace**m * np.stack([np.sin(phase), np.sin(phase + 1.0), 0.0 * t], axis=1)

    zeros, edges = np.zeros((K, 3)), START + T / N_BINS * np.arange((K - 1) * N_BINS + 1)
    R_ns = np.tile(np.eye(3), (K, 1, 1))
    state = ChainState(t, R_ns, swing(t, 0), swing(t, 1), zeros, zeros, zeros, constants)
    force = np.diff(swing(edges, 1), axis=0).reshape(K - 1, N_BINS, 3) * N_BINS / T - GRAVITY_N
    path = path_of(state, BinnedImu(t, T / N_BINS, force, np.zeros_like(force), np.zeros(K - 1)))
    return state, path, ExpectedMotion(swing(edges, 1), swing(edges, 2), np.zeros(len(edges))), swing


def position_maker(binned: BinnedImu, gyro: np.ndarray, t: np.ndarray = TIMES) -> Callable[[ChainState], Rows]:
    def make(state: ChainState) -> Rows:
        shape = (len(t), 3)
        path = path_of(state, binned)
        return position_rows(
            state,
            path,
            felt_on(path, state, turn_without_bias(state, path, gyro)),
            t,
            np.ones(shape),
            np.ones(shape),
            0.05,
        )

    return make


def velocity_maker(binned: BinnedImu, gyro: np.ndarray, t: np.ndarray = TIMES) -> Callable[[ChainState], Rows]:
    def make(state: ChainState) -> Rows:
        path, shape = path_of(state, binned), (len(t), 3)
        felt = felt_on(path, state, turn_without_bias(state, path, gyro))
        return velocity_rows(state, path, felt, t, np.ones(shape), np.ones(shape))

    return make


def hopping() -> tuple[ChainState, DensePath, Callable[[np.ndarray], np.ndarray]]:
    """Keyframes of a car that drives straight on and hops on its tyres, their path, and its velocity at t, (N, 3).

    The samples tell everything of it. It hops eight to twelve times a second, by a decimetre a second.
    """
    rng = np.random.default_rng(0)
    hz = np.concatenate([rng.uniform(0.1, 0.6, 20), rng.uniform(8.0, 12.0, 40)])
    speed = np.concatenate([np.full(20, 0.3), np.full(40, 0.1 / np.sqrt(20.0))])
    phase = rng.uniform(0.0, 2.0 * np.pi, 60)

    def velocity_n(t: np.ndarray) -> np.ndarray:
        ahead = np.cos(2.0 * np.pi * np.outer(t, hz) + phase) @ speed
        return np.asarray(ahead[:, None] * [1.0, 0.0, 0.0] + [20.0, 0.0, 0.0])

    def position_n(t: np.ndarray) -> np.ndarray:
        ahead = np.sin(2.0 * np.pi * np.outer(t, hz) + phase) @ (speed / (2.0 * np.pi * hz))
        return np.asarray((ahead + 20.0 * t)[:, None] * [1.0, 0.0, 0.0])

    n, n_bins = 1501, 5
    t = T * np.arange(n)
    zeros, edges = np.zeros((n, 3)), T / n_bins * np.arange((n - 1) * n_bins + 1)
    constants = Constants(0.0, 0.0, np.zeros(3))
    state = ChainState(t, np.tile(np.eye(3), (n, 1, 1)), position_n(t), velocity_n(t), zeros, zeros, zeros, constants)
    force = np.diff(velocity_n(edges), axis=0).reshape(n - 1, n_bins, 3) * n_bins / T - GRAVITY_N
    path = path_of(state, BinnedImu(t, T / n_bins, force, np.zeros_like(force), np.zeros(n - 1)))
    return state, path, velocity_n


def test_the_slow_offset_is_that_of_the_receiver_s_own_time() -> None:
    """Read as long before the stamp as fixes are usually late, however late these are found to be."""
    state, path, felt, _ = swinging(Constants(0.11, 0.0, np.zeros(3)))
    t, nothing = state.t[2:4] + 0.15, np.zeros((2, 3))  # the place is read at 0.04 of an interval, the offset at 0.09
    rows = position_rows(state, path, felt, t, nothing, np.ones((2, 3)), 0.06)
    np.testing.assert_allclose(rows.right[:, :, OFFSET], np.tile(0.09 / T * np.eye(3), (2, 1, 1)), atol=1e-9)
    wandering = replace(state, offset_n=np.outer(state.t, [1.0, -2.0, 0.5]))
    moved = position_rows(wandering, path, felt, t, nothing, np.ones((2, 3)), 0.06).residual - rows.residual
    np.testing.assert_allclose(moved, np.outer(t - 0.06, [1.0, -2.0, 0.5]), atol=1e-9)


@pytest.mark.parametrize("share", [0.2, 0.3, 0.7, 0.8])
@pytest.mark.parametrize(("column", "most"), [(VELOCITY_LATENCY, 4e-3), (VELOCITY_RESPONSE, 1e-3)])
def test_what_the_curve_misses_between_two_keyframes_is_no_property_of_the_receiver(
    column: slice, most: float, share: float
) -> None:
    """Wherever in their intervals the velocities fall; with a hop in the slopes it is 10 ms and more, or 3e-3 s^2."""
    state, path, velocity_n = hopping()
    felt = expected_motion(path, np.eye(3), InertialNoise(0.1, 1e-3, 0.003, 1e-4), None, T)
    t = state.t[5:-5] + share * T
    rows = velocity_rows(state, path, felt, t, velocity_n(t), np.ones((len(t), 3)))
    residual, slope = rows.residual[:, 0], rows.constants[:, 0, column.start]
    assert np.std(residual) > 0.05  # there is much that the curve misses
    assert abs(residual @ slope / (slope @ slope)) < most


@pytest.mark.parametrize("make", [position_maker, velocity_maker])
class TestReceiverJacobians:
    @pytest.mark.parametrize("seed", range(4))
    def test_they_are_exact_at_random_states(self, make, seed: int) -> None:
        state, binned = random_state(seed, turning=0.0)
        # in bins of 1 ms velocities are straight lines, to this share of the Jacobian
        assert_jacobians(make(binned, state.gyro_bias_s[0]), state, 1e-3)

    @pytest.mark.parametrize("rate", [-1.5, 1.5])
    def test_they_hold_while_turning_to_the_share_of_a_turn_that_fits_between_two_keyframes(self, make, rate) -> None:
        state, binned = random_state(1, turning=rate)
        gyro = rate * state.R_ns[0][2] + state.gyro_bias_s[0]
        # turns of 0.3 rad: a tilt of one end is spread along straight lines, not along the turn, which
        # is wrong by a quarter of the turn in the middle
        assert_jacobians(make(binned, gyro), state, 0.25 * 0.3 * np.linalg.norm(state.constants.lever_arm_s))
        # what the constants do is known at the time of the fix itself
        want, have = numerical(make(binned, gyro), state)[2], make(binned, gyro)(state).constants
        np.testing.assert_allclose(have, want, rtol=0.0, atol=2e-3 * np.max(np.abs(want)))

    def test_a_delay_is_the_same_as_keyframes_that_move_on_along_the_motion_whatever_that_is(self, make) -> None:
        """Else what positions and velocities disagree about would pass for a delay of both against the samples."""
        state, binned = random_state(3, turning=0.0)
        state = replace(state, constants=replace(state.constants, lever_arm_s=np.zeros(3)))
        rng = np.random.default_rng(0)
        n_edges = (K - 1) * N_BINS + 1
        felt = ExpectedMotion(rng.normal(size=(n_edges, 3)), rng.normal(size=(n_edges, 3)), np.zeros(n_edges))
        path, measured, sigma = path_of(state, binned), np.zeros((N, 3)), np.ones((N, 3))
        if make is position_maker:
            rows, column = position_rows(state, path, felt, TIMES, measured, sigma, 0.0), POSITION_LATENCY
        else:
            rows, column = velocity_rows(state, path, felt, TIMES, measured, sigma), VELOCITY_LATENCY
        step = np.zeros((K, KEYFRAME_SIZE))
        step[:, TRANSLATION] = np.einsum("kji,kj->ki", state.R_ns, felt.velocity_n[::N_BINS])
        step[:, VELOCITY] = felt.acceleration_n[::N_BINS]
        moved = after_step(rows, step, np.zeros(CONSTANTS_SIZE)).residual - rows.residual
        if make is velocity_maker:
            moved[:, 2] = 0.0  # see :func:`numerical`
        np.testing.assert_allclose(rows.constants[:, :, column.start], -moved, atol=1e-9)

    def test_at_the_ends_of_the_chain_and_beyond_they_stay_finite(self, make) -> None:
        state, binned = random_state(2, turning=1.0)
        t = np.array([START - 5.0, START, START + (K - 1) * T, START + (K - 1) * T + 5.0])
        rows = make(binned, np.zeros(3), t)(state)
        for part in (rows.residual, rows.left, rows.right, rows.constants):
            assert np.all(np.isfinite(part))
        assert np.all((rows.interval >= 0) & (rows.interval <= K - 2))


@pytest.mark.parametrize("seed", range(3))
class TestOtherJacobians:
    def test_heading(self, seed: int) -> None:
        state, _ = random_state(seed, turning=1.0)
        field_s = np.einsum("kji,kj->ki", state.R_ns[[0, 2, 5]], np.random.default_rng(seed).normal(size=(3, 3)))
        interval = np.array([0, 2, 5])

        def make(state: ChainState) -> Rows:
            return heading_rows(state, Heading(interval, field_s, 0.1, 0.05, 1.0))

        # the field's dip couples roll and pitch into its yaw; the rows leave that out on purpose
        rows = make(state)
        for row, (k, left, right, constants) in enumerate(zip(interval, *numerical(make, state), strict=True)):
            up_s = state.R_ns[k][2]
            assert rows.left[row, 0, ROTATION] @ up_s == pytest.approx(left[0, ROTATION] @ up_s, abs=1e-7)
            np.testing.assert_allclose(
                rows.left[row, 0, ROTATION] - up_s * (rows.left[row, 0, ROTATION] @ up_s), 0.0, atol=1e-12
            )
            np.testing.assert_allclose(rows.left[row, 0, ROTATION.stop :], left[0, ROTATION.stop :], atol=1e-9)
            np.testing.assert_allclose(rows.right[row], right, atol=1e-9)
            np.testing.assert_allclose(rows.constants[row], constants, atol=1e-7)

    def test_standstill(self, seed: int) -> None:
        state, _ = random_state(seed, turning=0.3)
        # turns of 0.06 rad between keyframes, far more than at rest, of which the logarithm's own slope is half
        assert_jacobians(lambda s: standstill_rows(s, np.array([0, 3, 5]), 0.03, 2e-3), state, 0.75 * 0.06)

    def test_ground(self, seed: int) -> None:
        state, _ = random_state(seed, turning=1.0)
        assert_jacobians(lambda s: ground_rows(s, 1.0, np.array([0, 2, 5]), np.array([3.0, 3.0, -4.0])), state)

    def test_offset(self, seed: int) -> None:
        state, _ = random_state(seed, turning=1.0)
        for part in range(2):
            assert_jacobians(lambda s, part=part: offset_rows(s, np.array([2.0, 2.0, 3.4]), 60.0)[part], state)

    def test_prior(self, seed: int) -> None:
        state, _ = random_state(seed, turning=1.0)
        part = slice(ACCEL_BIAS.start, GYRO_BIAS.stop)

        def make(state: ChainState) -> Rows:
            return prior_row("bias", np.concatenate([state.accel_bias_s[0], state.gyro_bias_s[0]]), np.ones(6), part)

        assert_jacobians(make, state)


class TestResiduals:
    def test_an_antenna_s_position_and_velocity_are_those_of_a_point_of_a_turning_body(self) -> None:
        """A circle at constant speed, seen late by an antenna off the centre: residuals vanish at the truth."""
        radius, pace, arm_s = 20.0, 0.6, np.array([0.4, -0.3, 0.5])
        position_latency, velocity_latency, offset_n = 0.13, 0.21, np.array([1.5, -0.7, 2.0])
        t = START + T * np.arange(K)

        def at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            yaw = pace * t
            R = so3.exp(np.stack([0.0 * t, 0.0 * t, yaw], axis=1))
            p = radius * np.stack([np.sin(yaw), -np.cos(yaw), 0.0 * t], axis=1)
            return R, p, radius * pace * np.stack([np.cos(yaw), np.sin(yaw), 0.0 * t], axis=1)

        zeros = np.zeros((K, 3))
        doppler_bias_n = np.array([0.03, -0.05, 0.1])
        constants = Constants(position_latency, velocity_latency, arm_s, doppler_bias_n=doppler_bias_n)
        state = ChainState(t, *at(t), zeros, zeros, np.tile(offset_n, (K, 1)), constants)
        force = np.array([0.0, radius * pace**2, 9.80665])
        rate = np.array([0.0, 0.0, pace])
        binned = BinnedImu(
            t,
            T / N_BINS,
            np.tile(force, (K - 1, N_BINS, 1)),
            np.tile(rate, (K - 1, N_BINS, 1)),
            zeros[1:, 0],
        )
        rates, ask, ones = np.full((K - 1) * N_BINS + 1, pace), t[0] + np.array([0.5, 0.83, 1.1]), np.ones((3, 3))
        path = path_of(state, binned)
        R, p, _ = at(ask - position_latency)
        fix = p + R @ arm_s + offset_n
        rows = position_rows(state, path, felt_on(path, state, rates), ask, fix, ones, position_latency)
        np.testing.assert_allclose(rows.residual, 0.0, atol=1e-4)
        R, _, v = at(ask - velocity_latency)
        doppler = v + np.einsum("nij,j->ni", R, np.cross(rate, arm_s)) + doppler_bias_n
        rows = velocity_rows(state, path, felt_on(path, state, rates), ask, doppler, ones)
        np.testing.assert_allclose(rows.residual, 0.0, atol=1e-3)

    # of a quick one, the second derivative is enough
    @pytest.mark.parametrize(("tau", "share"), [(0.05, 0.25), (0.15, 0.05)])
    def test_a_low_pass_is_a_delay_and_a_response_of_half_its_square(self, tau: float, share: float) -> None:
        state, path, felt, swing = swinging(Constants(0.0, tau, np.zeros(3), velocity_response=0.5 * tau**2))
        t, pace = state.t[2:-1] + tau, 2.0 * np.pi
        angle, gain = np.arctan(pace * tau), np.cos(np.arctan(pace * tau))
        late = gain * swing(t - angle / pace, 1)
        rows = velocity_rows(state, path, felt, t, late, np.ones((len(t), 3)))
        begun = (
            np.exp(-(t - tau - path.t[0]) / tau) < 0.01
        )  # the motion began at the path's first time, for all it says
        missed = late - swing(t - tau, 1)
        assert np.max(np.abs(missed)) > 0.1
        assert np.max(np.abs(rows.residual[begun])) < share * np.max(np.abs(missed))
        np.testing.assert_array_equal(rows.constants[:, 2, VELOCITY_RESPONSE], 0.0)  # up is left to the samples

    def test_the_slope_by_the_response_is_that_of_the_low_pass(self) -> None:
        def residual(response: float) -> tuple[np.ndarray, np.ndarray]:
            state, path, felt, _ = swinging(Constants(0.0, 0.0, np.zeros(3), velocity_response=response))
            t = state.t[4:-1]  # by then, what was before the path is forgotten
            rows = velocity_rows(state, path, felt, t, np.zeros((len(t), 3)), np.ones((len(t), 3)))
            return rows.residual, rows.constants[:, :, VELOCITY_RESPONSE.start]

        step = 1e-4
        for response in (-0.002, 0.002, 0.005):
            slope = (residual(response + step)[0] - residual(response - step)[0]) / (2.0 * step)
            np.testing.assert_allclose(residual(response)[1], slope, atol=0.03 * np.max(np.abs(slope)))

    def test_a_mean_over_a_time_is_an_even_filter(self) -> None:
        """Of a low-pass as round as that, quick motion is late by other times."""
        seconds, pace = 0.4, 2.0 * np.pi
        missed = []
        for evenness in (0.0, 1.0):
            constants = Constants(
                0.0, 0.5 * seconds, np.zeros(3), velocity_response=seconds**2 / 24.0, evenness=evenness
            )
            state, path, felt, swing = swinging(constants, 41)
            t = state.t[12:-12] + 0.5 * seconds
            mean = np.sinc(seconds * pace / (2.0 * np.pi)) * swing(t - 0.5 * seconds, 1)
            rows = velocity_rows(state, path, felt, t, mean, np.ones((len(t), 3)))
            missed.append(np.max(np.abs(rows.residual)))
        assert missed[1] < 0.1
        assert missed[0] > 2.0 * missed[1]

    @pytest.mark.parametrize("late", [0.1, -0.1])
    def test_a_course_that_is_late_turns_velocities_back_and_leaves_their_size(self, late: float) -> None:
        """On the chicane beside 12 m/s ahead, by the motion of a moment before."""
        ahead_n = np.array([12.0, 0.0, 0.0])

        def rows(course_delay: float) -> tuple[Rows, np.ndarray, np.ndarray]:
            constants = Constants(0.0, 0.0, np.zeros(3), course_delay=course_delay)
            state, path, felt, swing = swinging(constants)
            t = state.t[1:-1]
            moved = replace(state, velocity_n=state.velocity_n + ahead_n)
            moved = replace(moved, position_n=state.position_n + (state.t - START)[:, None] * ahead_n)
            felt, shape = replace(felt, velocity_n=felt.velocity_n + ahead_n), (len(t), 3)
            made = velocity_rows(moved, path, felt, t, np.zeros(shape), np.ones(shape))
            return made, swing(t, 1) + ahead_n, swing(t - course_delay, 1) + ahead_n

        (made, now_n, then_n), (without, _, _) = rows(late), rows(0.0)
        size, of_then = (np.linalg.norm(each, axis=1, keepdims=True) for each in (now_n, then_n))
        want = then_n / of_then * size - now_n
        assert np.max(np.abs(want)) > 1.0
        np.testing.assert_allclose(made.residual - without.residual, want, atol=0.005)
        step = 1e-4
        slope = (rows(late + step)[0].residual - rows(late - step)[0].residual) / (2.0 * step)
        np.testing.assert_allclose(made.constants[:, :, COURSE_DELAY.start], slope, atol=0.01 * np.max(np.abs(slope)))

    @pytest.mark.parametrize("response", [-0.002, 0.0, 0.002, 0.005])
    def test_the_slope_by_evenness_is_what_it_does_to_velocities(self, response: float) -> None:
        def rows(evenness: float) -> Rows:
            constants = Constants(0.0, 0.0, np.zeros(3), velocity_response=response, evenness=evenness)
            state, path, felt, _ = swinging(constants)
            t = state.t[4:-1]
            return velocity_rows(state, path, felt, t, np.zeros((len(t), 3)), np.ones((len(t), 3)))

        slope = 0.5 * (rows(1.3).residual - rows(-0.7).residual)
        np.testing.assert_allclose(rows(0.3).constants[:, :, EVENNESS.start], slope, atol=1e-12)
        assert np.any(slope != 0.0) == (response > 1e-3)  # one that is within its noise has no shape

    @pytest.mark.parametrize("evenness", [0.0, 0.5, 1.0])
    def test_slopes_by_a_filter_are_of_slow_motion(self, evenness: float) -> None:
        """As those by latencies are; of quick motion, filters that are alike in slow motion show different things."""
        constants = Constants(0.0, 0.1, np.zeros(3), velocity_response=0.01, evenness=evenness)
        state, path, motion, _ = swinging(constants)
        pace = 2.0 * np.pi * 2.0
        jerked = replace(
            motion,
            velocity_n=motion.velocity_n + np.sin(pace * path.t)[:, None] / pace * [3.0, 1.5, 0.0],
            acceleration_n=motion.acceleration_n + 3.0 * np.cos(pace * path.t)[:, None] * [1.0, 0.5, 0.0],
        )
        shape = (len(TIMES), 3)
        beside, without = (
            velocity_rows(state, path, felt, TIMES, np.zeros(shape), np.ones(shape))
            for felt in (
                replace(jerked, followed=jerked, shown=motion),
                replace(motion, followed=motion, shown=motion),
            )
        )
        for column in (VELOCITY_RESPONSE, EVENNESS):
            np.testing.assert_allclose(beside.constants[:, :, column], without.constants[:, :, column])
        assert np.max(np.abs(beside.residual - without.residual)) > 0.05  # what is shown holds the quick motion

    def test_a_component_that_is_not_known_has_no_weight_and_spoils_nothing(self) -> None:
        state, binned = random_state(0, turning=1.0)
        measured, sigma = np.zeros((N, 3)), np.ones((N, 3))
        measured[:, 2], sigma[1, 0], measured[2] = np.nan, np.inf, np.nan
        path = path_of(state, binned)
        felt = felt_on(path, state, np.zeros((K - 1) * N_BINS + 1))
        for rows in (
            position_rows(state, path, felt, TIMES, measured, sigma, 0.0),
            velocity_rows(state, path, felt, TIMES, measured, sigma),
        ):
            np.testing.assert_array_equal(rows.information[:, 2], 0.0)
            assert rows.information[1, 0] == 0.0
            np.testing.assert_array_equal(rows.information[2], 0.0)
            np.testing.assert_array_equal(rows.information[0, :2], 1.0)
            assert np.all(np.isfinite(rows.residual))

    def test_heading_is_the_yaw_of_the_field_and_wraps(self) -> None:
        state, _ = random_state(0, turning=0.0)
        constants = replace(state.constants, heading_offset=0.2)
        state = replace(state, constants=constants)
        field_n = np.array([-1.0, -1e-3, -2.0])  # yaw just above minus half a turn
        heading = Heading(np.array([1]), (state.R_ns[1].T @ field_n)[None], 3.1, 0.05, 1.0)
        rows = heading_rows(state, heading)
        want = np.arctan2(-1e-3, -1.0) - 3.1 - 0.2 + 2.0 * np.pi
        np.testing.assert_allclose(rows.residual, [[want]], atol=1e-12)
        np.testing.assert_array_equal(rows.sigma, [[0.05]])

    def test_standstill_asks_for_no_speed_and_no_turn(self) -> None:
        state, _ = random_state(0, turning=1.0)
        rows = standstill_rows(state, np.array([2]), 0.03, 2e-3)
        np.testing.assert_allclose(rows.residual[0, :3], state.velocity_n[2])
        np.testing.assert_allclose(so3.exp(rows.residual[0, 3:]), state.R_ns[2].T @ state.R_ns[3], atol=1e-12)
        np.testing.assert_array_equal(rows.sigma[0], [0.03] * 3 + [2e-3] * 3)

    def test_the_offset_s_process_is_stationary(self) -> None:
        """Start and steps together give every keyframe the sigma asked for, and neighbours the right correlation."""
        sigma, tau = np.array([2.0, 3.0, 4.0]), 5.0
        state, _ = random_state(0, turning=0.0)
        start, steps = offset_rows(state, sigma, tau)
        H = np.zeros((3 * K, 3 * K))
        for rows in (start, steps):
            for row, k in enumerate(rows.interval):
                J = np.zeros((3, 3 * K))
                J[:, 3 * k : 3 * k + 3], J[:, 3 * k + 3 : 3 * k + 6] = (
                    rows.left[row][:, OFFSET],
                    rows.right[row][:, OFFSET],
                )
                H += (J.T * rows.information[row]) @ J
        P = np.linalg.inv(H).reshape(K, 3, K, 3)
        for k in range(K):
            np.testing.assert_allclose(np.sqrt(np.diag(P[k, :, k])), sigma)
        np.testing.assert_allclose(np.diag(P[1, :, 4]), sigma**2 * np.exp(-3.0 * T / tau))


class TestHermite:
    def test_times_fall_between_the_keyframes_around_them(self) -> None:
        state, _ = random_state(0, turning=0.0)
        b = bracket(state, START + np.array([0.0, 0.05, 0.3, 1.2, 9.0, -9.0]))
        np.testing.assert_array_equal(b.interval, [0, 0, 1, 5, 5, 0])
        np.testing.assert_allclose(b.share, [0.0, 0.25, 0.5, 1.0, 1.0, 0.0], atol=1e-9)
        assert b.length == pytest.approx(T)

    def test_weights_reproduce_any_cubic_and_its_slope(self) -> None:
        state, _ = random_state(0, turning=0.0)
        cubic = np.polynomial.Polynomial([0.3, -2.0, 1.5, 4.0])
        slope = cubic.deriv()
        b = bracket(state, TIMES)
        left, right = state.t[b.interval], state.t[b.interval + 1]
        ends = (cubic(left), slope(left), cubic(right), slope(right))
        np.testing.assert_allclose(sum(w * e for w, e in zip(hermite_position(b), ends, strict=True)), cubic(TIMES))
        np.testing.assert_allclose(sum(w * e for w, e in zip(hermite_velocity(b), ends, strict=True)), slope(TIMES))


def test_a_small_step_moves_the_real_residual_as_predicted() -> None:
    state, binned = random_state(3, turning=0.0)
    rng = np.random.default_rng(0)
    step, constants = 1e-4 * rng.normal(size=(K, KEYFRAME_SIZE)), 1e-4 * rng.normal(size=CONSTANTS_SIZE)
    step[:, GYRO_BIAS] = step[0, GYRO_BIAS]
    make = position_maker(binned, state.gyro_bias_s[0])
    predicted = after_step(make(state), step, constants)
    np.testing.assert_allclose(make(state.retract(step, constants)).residual, predicted.residual, atol=5e-6)


def test_slopes_by_arm_and_latency_are_of_one_motion() -> None:
    """What turns faster than keyframes follow swings the antenna, but tells no arm that a latency could not take."""
    constants = Constants(0.01, 0.02, np.array([0.4, -0.2, 0.1]))
    state, path, motion, _ = swinging(constants)
    quick = np.cos(2.0 * np.pi * 6.0 * path.t)
    slow = 0.5 * np.cos(2.0 * np.pi * 0.5 * path.t)
    followed = Motion(motion.velocity_n, motion.acceleration_n, slow)
    both = replace(motion, turn_rate=slow + quick, followed=followed)
    shape = (len(TIMES), 3)

    def rows(felt: ExpectedMotion) -> Rows:
        return velocity_rows(state, path, felt, TIMES, np.zeros(shape), np.ones(shape))

    alone = rows(replace(motion, turn_rate=slow))
    np.testing.assert_allclose(rows(both).constants[:, :, LEVER_ARM], alone.constants[:, :, LEVER_ARM], atol=1e-12)
    np.testing.assert_allclose(
        rows(both).constants[:, :2, VELOCITY_LATENCY], alone.constants[:, :2, VELOCITY_LATENCY], atol=1e-12
    )
    turn = np.interp(TIMES - constants.velocity_latency, path.t, quick)
    swing = np.cross(turn[:, None] * [0.0, 0.0, 1.0], constants.lever_arm_s)
    np.testing.assert_allclose(rows(both).residual - alone.residual, swing, atol=1e-9)


def test_latencies_arm_and_response_are_told_by_slow_motion() -> None:
    constants = Constants(0.01, 0.02, np.array([0.4, -0.2, 0.1]))
    state, path, motion, _ = swinging(constants)
    quick = np.cos(2.0 * np.pi * 4.0 * path.t)
    kerbs = motion.acceleration_n + quick[:, None] * [1.0, 0.5, 0.0]
    shaken = Motion(motion.velocity_n, kerbs, motion.turn_rate + quick)
    shape = (len(TIMES), 3)

    def slopes(followed: Motion) -> np.ndarray:
        felt = replace(motion, acceleration_n=kerbs, turn_rate=shaken.turn_rate, followed=followed)
        return velocity_rows(state, path, felt, TIMES, np.zeros(shape), np.ones(shape)).constants

    calm = Motion(motion.velocity_n, motion.acceleration_n, motion.turn_rate)
    slow, whole = slopes(calm), slopes(shaken)
    alone = velocity_rows(state, path, motion, TIMES, np.zeros(shape), np.ones(shape)).constants
    for column in (LEVER_ARM, VELOCITY_LATENCY, VELOCITY_RESPONSE):
        np.testing.assert_allclose(slow[:, :, column], alone[:, :, column], atol=1e-12)
        assert not np.allclose(slow[:, :, column], whole[:, :, column], atol=1e-3)


def test_a_low_pass_is_told_by_the_same_motion_as_a_second_derivative() -> None:
    """Vibration that the sampling folds is in the expected motion; the receiver does not show it, smoothed or not."""
    constants = Constants(0.0, 0.0, np.array([0.4, -0.2, 0.1]), velocity_response=0.0013)
    state, path, motion, _ = swinging(constants)
    pace = 2.0 * np.pi * 4.0
    shaken = 3.0 * np.cos(pace * path.t)[:, None] * [1.0, 0.5, 0.0]
    vibrating = replace(
        motion,
        velocity_n=motion.velocity_n + np.sin(pace * path.t)[:, None] / pace * [3.0, 1.5, 0.0],
        acceleration_n=motion.acceleration_n + shaken,
        turn_rate=motion.turn_rate + np.cos(pace * path.t),
        followed=motion,
    )
    shape = (len(TIMES), 3)
    without, beside = (
        velocity_rows(state, path, felt, TIMES, np.zeros(shape), np.ones(shape))
        for felt in (replace(motion, followed=motion), vibrating)
    )
    np.testing.assert_allclose(beside.constants[:, :, VELOCITY_RESPONSE], without.constants[:, :, VELOCITY_RESPONSE])
