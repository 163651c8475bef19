"""How a kart is driven round a track: line, speed within grip, braking and power, slip, kerbs, stops. Makes a Truth.

The plan is made over distance (path, curvature, speed by a forward and a backward pass), then laid out over time on
a fine grid whose values become the control points of the truth's B-spline. Using them as control points, rather than
interpolating them, cannot overshoot and bounds the jerk; the spline, not the plan, is the truth.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.ndimage import gaussian_filter1d

from smoother.arrays import Array
from smoother.sim.figures import require_figures
from smoother.sim.track import Track
from smoother.sim.truth import Clock, Truth
from smoother.units import DEG, STANDARD_GRAVITY

_STEP = 0.02  # s between control points: the truth holds motion up to about 15 Hz
_PLAN_STEP = 1.0  # m between nodes of the speed plan
MARGIN = 5.0  # s of truth before the first and after the last sample, for latencies and filters


@dataclass(frozen=True)
class Stop:
    """A stop on the track (driver change, pit): about `time` s after the start of the session, for `duration` s."""

    time: float
    duration: float


@dataclass(frozen=True)
class Spin:
    """A spin: from `time` s on the kart turns once about itself within `duration` s, and slides along its line."""

    time: float
    duration: float


@dataclass(frozen=True)
class Motion:
    """How the kart is driven. SI; accelerations in units of g where the name says so.

    driving False leaves the kart standing on the grid for the whole session. standstill: seconds at rest before the
    start, None is a rolling start. Figures are those of rental to racing karts with slicks. With `steering` the
    attitude of the truth is still the kart's; that of the logger is its mounting, turned by the wheel.
    """

    driving: bool = True
    standstill: float | None = None
    stops: tuple[Stop, ...] = ()
    spins: tuple[Spin, ...] = ()
    grip_g: float = 1.75  # lateral, in g
    braking_g: float = 0.95
    traction_g: float = 0.42
    power: float = 105.0  # W per kg at the wheels, kart and driver
    drag: float = 0.0025  # 1/m: deceleration is drag * speed^2
    top_speed: float = 33.0  # m/s
    grid_distance: float = 25.0  # m from the grid to the line
    line_sigma: float = 0.45  # m, how far the line wanders from lap to lap, one sigma
    line_length: float = 45.0  # m between independent values of the line
    grip_sigma: float = 0.03  # how much of the grip the driver leaves unused, one sigma
    grip_length: float = 120.0  # m
    lapse_rate: float = 0.0  # 1/km: places where the driver brakes too early or misses the apex
    lapse_depth: tuple[float, float] = (0.15, 0.45)  # of the grip that is left unused there, from the least to the most
    lapse_length: float = 15.0  # m to either side, one sigma
    slip_per_acceleration: float = 0.0045  # rad per m/s^2 of lateral acceleration: about 4.5 deg at 1.75 g
    slip_sigma: float = 0.25  # of that, how differently each corner is taken
    slip_length: float = 25.0  # m
    slip_lead: float = 0.12  # s by which the heading leads the path into a turn
    roll_per_acceleration: float = 0.0015  # rad per m/s^2: 1.5 deg at 1.75 g, a stiff frame on soft tyres
    pitch_per_acceleration: float = 0.0012  # rad per m/s^2
    steering: float = (
        0.0  # rad, one sigma of the angle of a steering wheel that carries the logger; 0: it is on the frame
    )
    steering_length: float = 0.15  # s between independent values of it: turning of up to 3 Hz
    steering_per_curvature: float = 0.0  # rad m: how far that wheel turns with the bend, beside it; karts 1.2 to 4
    column: float = 40.0 * DEG  # by which the wheel's column rises from the level towards the driver
    roughness: float = 0.25 * DEG  # rad, roll and pitch of the asphalt, one sigma
    roughness_length: float = 6.0  # m
    kerb_height: float = 0.012  # m, mean height of a kerb hit; 0 for none
    kerb_length: float = 0.6  # m, one sigma of the bump along the path
    kerb_roll: float = 0.6 * DEG  # rad
    kerb_rate: float = 0.7  # of the apexes that are hit
    rpm_low: float = 6000.0  # at walking pace
    rpm_high: float = 16000.0  # at top speed

    def __post_init__(self) -> None:
        lengths = ("line_length", "grip_length", "lapse_length", "slip_length", "roughness_length", "kerb_length")
        sigmas = ("line_sigma", "grip_sigma", "slip_sigma", "steering", "roughness", "lapse_rate", "standstill")
        limits = ("grip_g", "braking_g", "traction_g", "power", "top_speed", "steering_length")
        require_figures(self, "motion", sigmas, (*lengths, *limits))


def drive(track: Track, motion: Motion, duration: float, rng: np.random.Generator, clock: Clock | None = None) -> Truth:
    """Return the truth of a session of `duration` s on `track`, with :data:`MARGIN` s more at either end."""
    time = np.arange(-MARGIN - 3 * _STEP, duration + MARGIN + 4 * _STEP, _STEP)
    line_rng, surface_rng, kerb_rng = rng.spawn(3)
    path = _choose_path(track, motion, time, line_rng)
    speed = _speed_over_time(path, motion, time)
    turned = _spun(motion.spins, time)
    control = _control_points(track, motion, path, speed, turned, surface_rng, kerb_rng)
    return Truth(track.origin, control, float(time[0]), _STEP, clock or Clock())


@dataclass(frozen=True, eq=False)
class _Path:
    """The driven line. Nodes (K,): distance along the centre line, length driven, curvature, grip; offset to the left
    (m) over that distance."""

    distance: Array
    length: Array
    curvature: Array
    grip: Array
    offset: BSpline


def _choose_path(track: Track, motion: Motion, time: Array, rng: np.random.Generator) -> _Path:
    # Nobody averages more than 90 % of top speed on a kart track, so the path never ends before the session does.
    reach = 0.9 * motion.top_speed * (time[-1] - time[0]) + track.length if motion.driving else 10.0 * _PLAN_STEP
    start = -motion.grid_distance if motion.standstill is not None else -rng.uniform(0.0, track.length)
    distance = start + np.arange(0.0, reach, _PLAN_STEP)
    offset = wander(distance[0], distance[-1], motion.line_length, rng, motion.line_sigma)
    unused = wander(distance[0], distance[-1], motion.grip_length, rng, motion.grip_sigma)
    plan = _plan_position(track, offset, distance)
    step = np.diff(plan, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(step, axis=1))])
    curvature = np.gradient(heading, 0.5 * (length[1:] + length[:-1]))
    used = (1.0 - np.abs(unused(distance))) * (1.0 - _lapses(motion, distance, rng.spawn(1)[0]))
    grip = STANDARD_GRAVITY * motion.grip_g * used
    return _Path(distance, length, np.append(curvature, curvature[-1]), grip, offset)


def _lapses(motion: Motion, distance: Array, rng: np.random.Generator) -> Array:
    """Share (K,) of the grip that is left unused by lapses, over the distance (K,) m driven; the larger of two."""
    share = np.zeros_like(distance)
    count = rng.poisson(motion.lapse_rate * (distance[-1] - distance[0]) / 1000.0)
    places, depths = rng.uniform(distance[0], distance[-1], count), rng.uniform(*motion.lapse_depth, count)
    for place, depth in zip(places, depths, strict=True):
        i, j = np.searchsorted(distance, [place - 5.0 * motion.lapse_length, place + 5.0 * motion.lapse_length])
        bump = depth * np.exp(-0.5 * ((distance[i:j] - place) / motion.lapse_length) ** 2)
        share[i:j] = np.maximum(share[i:j], bump)
    return share


def wander(start: float, stop: float, length: float, rng: np.random.Generator, sigma: float) -> BSpline:
    """Smooth random function on [start, stop], Gaussian of standard deviation `sigma`, forgotten after `length`."""
    count = int(np.ceil((stop - start) / length)) + 6
    knots = start + length * (np.arange(count + 6) - 5.0)
    scale = sigma / np.sqrt(0.394)  # mean square of the quintic B-spline's weights
    return BSpline(knots, scale * rng.standard_normal(count), 5)


def _plan_position(track: Track, offset: BSpline, distance: Array) -> Array:
    tangent = track.tangent(distance)
    left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    return np.asarray(track.centre(distance)[:, :2] + offset(distance)[:, None] * left)


def _speed_over_time(path: _Path, motion: Motion, time: Array) -> Array:
    """Speed along the path (N,) m/s at `time` (N,) s, smoothed as hand and foot are slow."""
    if not motion.driving:
        return np.zeros_like(time)
    # s; smoothing and slip lead move the kart up to 0.9 s before the plan
    launch = time[0] if motion.standstill is None else motion.standstill + 1.0
    waits = np.zeros(len(path.length))
    speed, reached = _speed_over_path(path, motion, waits)
    for stop in sorted(motion.stops, key=lambda stop: stop.time):
        node = int(np.searchsorted(reached + np.cumsum(waits), stop.time - launch))
        if 0 < node < len(waits):
            waits[node] = stop.duration
    if np.any(waits):
        speed, reached = _speed_over_path(path, motion, waits)
    arrival = launch + reached + np.cumsum(waits) - waits
    at_node = np.flatnonzero(waits)
    knots = np.insert(arrival, at_node + 1, arrival[at_node] + waits[at_node])
    planned = np.interp(time, knots, np.insert(speed, at_node + 1, 0.0))
    # s; foot and hand are not faster (jerk below about 60 m/s^3)
    return np.asarray(gaussian_filter1d(planned, 0.12 / _STEP, mode="nearest"))


def _speed_over_path(path: _Path, motion: Motion, waits: Array) -> tuple[Array, Array]:
    """Fastest speed (K,) m/s within grip, braking and power, at rest where `waits`; time (K,) s to reach each node.

    Source: the forward-backward pass of quasi-steady lap simulation, with a friction ellipse.
    """
    curvature = np.maximum(np.abs(path.curvature), 1e-6)
    limit = np.minimum(np.sqrt(path.grip / curvature), motion.top_speed)
    limit[waits > 0.0] = 0.0
    if motion.standstill is not None:
        limit[0] = 0.0
    demand = (curvature / path.grip) ** 2  # share of the grip used for turning, over speed^4
    step = np.diff(path.length)
    backward = _pass(limit[::-1], demand[::-1], step[::-1], motion.braking_g * STANDARD_GRAVITY, np.inf, -motion.drag)
    traction = motion.traction_g * STANDARD_GRAVITY
    speed = _pass(backward[::-1], demand, step, traction, motion.power, motion.drag)
    mean = np.maximum(0.5 * (speed[1:] + speed[:-1]), 1e-3)
    return speed, np.concatenate([[0.0], np.cumsum(step / mean)])


def _pass(limit: Array, demand: Array, step: Array, push: float, power: float, drag: float) -> Array:
    """Speeds (K,) below `limit` (K,) that accelerate from node to node by no more than push, power and drag allow."""
    squares, out = (limit * limit).tolist(), []
    square = squares[0]
    out.append(square)
    for ceiling, used, ds in zip(squares[1:], demand.tolist(), step.tolist(), strict=False):
        left = max(0.0, 1.0 - used * square * square) ** 0.5
        strongest = min(push, power / max(square, 1e-6) ** 0.5)
        square = min(ceiling, max(0.0, square + 2.0 * ds * (strongest * left - drag * square)))
        out.append(square)
    return np.asarray(np.sqrt(np.array(out)))


def _control_points(
    track: Track,
    motion: Motion,
    path: _Path,
    speed: Array,
    turned: Array,
    surface: np.random.Generator,
    kerbs: np.random.Generator,
) -> Array:
    """Control points of the truth, (N, CHANNELS), at the times of `speed` (N,); turned (N,) rad, by spins."""
    driven = np.concatenate([[0.0], np.cumsum(0.5 * _STEP * (speed[1:] + speed[:-1]))])
    distance = CubicSpline(path.length, path.distance)(driven)
    heading = _heading(track, path.offset, distance)
    lateral = _smooth(speed * np.gradient(heading, _STEP))
    forward = np.gradient(speed, _STEP)
    bump, tilt = _kerbs(motion, path, driven, kerbs)
    ends = (path.distance[0], path.distance[-1])
    rough = [wander(*ends, motion.roughness_length, surface, motion.roughness)(distance) for _ in range(2)]
    sliding = 1.0 + wander(*ends, motion.slip_length, surface, motion.slip_sigma)(distance)
    slip = motion.slip_per_acceleration * _earlier(lateral, motion.slip_lead) * sliding
    roll = motion.roll_per_acceleration * lateral + rough[0] + tilt
    pitch = -motion.pitch_per_acceleration * _smooth(forward) - np.arctan(track.slope(distance)) + rough[1]
    north_west = _plan_position(track, path.offset, distance)
    up = track.centre(distance)[:, 2] + bump
    engine = _engine(motion, speed, forward)
    return np.column_stack([north_west, up, roll, pitch, heading + slip + turned, *engine])


def _spun(spins: tuple[Spin, ...], time: Array) -> Array:
    """Turn (N,) rad by all spins at `time` (N,) s; rate and acceleration of each begin and end with none."""
    share = [np.clip((time - spin.time) / spin.duration, 0.0, 1.0) for spin in spins]
    return np.asarray(2.0 * np.pi * sum((s**3 * (10.0 - 15.0 * s + 6.0 * s**2) for s in share), np.zeros_like(time)))


def _heading(track: Track, offset: BSpline, distance: Array) -> Array:
    """Direction of the path, (N,) rad anticlockwise from north, unwrapped."""
    tangent = track.tangent(distance)
    stretch = 1.0 - track.curvature(distance) * offset(distance)
    swerve = np.arctan2(offset(distance, nu=1), stretch)
    return np.asarray(np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])) + swerve)


def _smooth(values: Array) -> Array:
    return np.asarray(gaussian_filter1d(values, 0.06 / _STEP, mode="nearest"))  # s: smoothing of attitudes


def _earlier(values: Array, lead: float) -> Array:
    """Return values (N,) as they will be `lead` s later."""
    index = np.arange(len(values))
    return np.asarray(np.interp(index + lead / _STEP, index, values))


def _kerbs(motion: Motion, path: _Path, driven: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Height (N,) m and roll (N,) rad of the kerbs hit at the insides of corners, over the length driven (N,)."""
    height, roll = np.zeros_like(driven), np.zeros_like(driven)
    bend = np.abs(path.curvature)
    apexes = np.flatnonzero((bend[1:-1] > 0.025) & (bend[1:-1] >= bend[:-2]) & (bend[1:-1] > bend[2:])) + 1
    apexes = apexes[path.length[apexes] < driven[-1]]
    hit = rng.random(len(apexes)) < motion.kerb_rate
    places = path.length[apexes] + rng.normal(0.0, 1.5, len(apexes))
    strength = rng.uniform(0.4, 1.6, len(apexes))
    for apex, place, size in zip(apexes[hit], places[hit], strength[hit], strict=True):
        i, j = np.searchsorted(driven, [place - 5.0 * motion.kerb_length, place + 5.0 * motion.kerb_length])
        bump = size * np.exp(-0.5 * ((driven[i:j] - place) / motion.kerb_length) ** 2)
        height[i:j] += motion.kerb_height * bump
        roll[i:j] += np.sign(path.curvature[apex]) * motion.kerb_roll * bump  # the inner wheels climb
    return height, roll


def _engine(motion: Motion, speed: Array, forward: Array) -> tuple[Array, Array, Array]:
    """Revolutions, throttle and running (0..1), each (N,). One gear: rpm follows speed."""
    rpm = motion.rpm_low + (motion.rpm_high - motion.rpm_low) * speed / motion.top_speed
    revolutions = np.cumsum(rpm) * (_STEP / 60.0)
    strongest = np.minimum(motion.traction_g * STANDARD_GRAVITY, motion.power / np.maximum(speed, 1.0))
    throttle = _smooth(np.clip((forward + motion.drag * speed**2) / strongest, 0.0, 1.0))
    walk = np.clip(speed / 3.0, 0.0, 1.0)
    return revolutions, throttle, walk * walk * (3.0 - 2.0 * walk)
