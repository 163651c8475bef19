"""Latency of the accelerometer behind the gyroscope, from a slowly changing force in rotating axes.

Gravity and centripetal acceleration change slowly; in the axes of a sensor that is turned quickly (on a steering wheel,
in a hand) they change with its rotation, `df/dt = -w x f`. A latency of the force delays the left side against the
right. Jerk, bumps, and the lever of the sensor are noise. Where they are correlated with the rotation (a car leans as
the lateral acceleration grows), the left side also has another amplitude: several times the right one in cars and in
karts with the logger on the frame. So a latency is only accepted where both amplitudes agree.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, median
from smoother.disc import pieces, release, roomy
from smoother.samples import ImuSamples, Session
from smoother.trajectory import Identified

BANDS = ((0.5, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0))  # Hz: octaves, of turning that is faster than bends
FASTEST = 50.0  # Hz; six samples to the shortest period. More are averaged
ROOM = 2.5  # samples of a band in a period of its upper end: what it takes for products with the slow force not to fold
BLOCK = 256  # rows; errors of one block, 5 s or more, are taken for independent of those of others
FEWEST_BLOCKS = 12  # that tell a sigma to 20 %; a minute of samples
LONGEST = 1200.0  # s; of longer sessions the part with most turning
# s; less than a period of the fastest band, whose turns might be taken for one another. Filters differ by up to 30 ms
# (MPU-9250 register map: 32.5 ms at 5 Hz, 2.9 at 184 Hz), and a logger may read its sensors one after the other.
LARGEST = 0.15
SMALLEST = 0.005  # s; less changes the force by less than vibration does: 0.15 m/s^2 where the box turns at 3 rad/s
# of the left side over the right one; a lever of 5 mm makes 1.3 at 4 Hz, a filter at its edge 0.7
SIZES = (0.7, 1.4)
# sigmas by which the size is within SIZES, and bands where it is: one can be so by chance. Of 308 simulated karts with
# the box on the frame none has two such bands; at 1.5 sigmas one has
CERTAIN, FEWEST_BANDS = 2.5, 2
SIGNIFICANT, LIKELY = 5.0, 2.5  # sigmas
AT_ODDS = 3.0  # rms of the bands' deviations, in their sigmas, from which on they do not say the same
FLOOR = 1e-6  # of the power of the force, that is noise at least: sensors round
_SOLUTIONS = 3  # of delay, size and noise, in turns


@dataclass(frozen=True)
class ForceDelay:
    """delay s of the force behind the rate and its sigma; is_seen: whether it is observable; else 0 and infinite."""

    delay: float
    sigma: float
    is_seen: bool

    @property
    def is_found(self) -> bool:
        """Whether there is a latency to correct."""
        return self.is_seen and abs(self.delay) > max(SMALLEST, SIGNIFICANT * self.sigma)

    @property
    def unsure(self) -> float:
        """Uncertainty of times, s: sigma of a corrected latency, the whole of a likely one."""
        if self.is_found:
            return self.sigma
        is_likely = self.is_seen and abs(self.delay) > LIKELY * self.sigma
        return math.sqrt(self.delay**2 - self.sigma**2) if is_likely else 0.0


UNSEEN = ForceDelay(0.0, math.inf, False)


@dataclass(frozen=True)
class BandDelay:
    """Result of one band, Hz: delay s, size of the left side over the right one, correlation of both.

    Its sigmas are infinite where the size shows that it is useless.
    """

    low: float
    high: float
    delay: float
    sigma: float
    size: float
    size_sigma: float
    correlation: float

    @property
    def beside(self) -> float:
        """Error of the delay, s, by what goes along with the turning: as much a quarter of a period off as in step.

        What is in step shows in the size.
        """
        return abs(self.size - 1.0) / (2.0 * math.pi * math.sqrt(self.low * self.high))

    @property
    def holds(self) -> bool:
        """Whether the force changes in this band as in a sensor that is turned under a constant force."""
        margin = CERTAIN * self.size_sigma
        return SIZES[0] + margin < self.size < SIZES[1] - margin and abs(self.delay) < LARGEST and self.sigma > 0.0


def force_delay(t: Array, specific_force_s: Array, angular_rate_s: Array) -> ForceDelay:
    """Return the delay of force (N, 3) m/s^2 behind rate (N, 3) rad/s, both stamped t (N,) s and in the same axes.

    The mean of the bands that hold, by their variances, which count what goes along with the turning; its sigma grows
    where they differ by more than those tell.
    """
    held = [band for band in band_delays(t, specific_force_s, angular_rate_s) if band.holds]
    if len(held) < FEWEST_BANDS:
        return UNSEEN
    weight = np.array([math.hypot(band.sigma, band.beside) for band in held]) ** -2.0
    delays = np.array([band.delay for band in held])
    mean = float(weight @ delays / weight.sum())
    at_odds = math.sqrt(float(weight @ (delays - mean) ** 2) / (len(held) - 1))
    if at_odds > AT_ODDS:
        return UNSEEN
    return ForceDelay(mean, max(1.0, at_odds) / math.sqrt(float(weight.sum())), True)


def band_delays(t: Array, specific_force_s: Array, angular_rate_s: Array) -> list[BandDelay]:
    """What each band says that the samples are fast enough for; arguments as of :func:`force_delay`.

    Stamps may be uneven and have gaps: force and rate share them, so that their delay is hardly touched.
    """
    if len(t) < FEWEST_BLOCKS * BLOCK:
        return []
    period = median(np.diff(t))
    busy = _busiest(angular_rate_s, round(LONGEST / period))
    each = max(1, round(1.0 / (FASTEST * period)))
    force, rate = _thinned(specific_force_s[busy], each), _thinned(angular_rate_s[busy], each)
    n = force.shape[1] // BLOCK * BLOCK
    if n < FEWEST_BLOCKS * BLOCK:
        return []
    force, rate = force[:, :n], rate[:, :n]
    mean = force.mean(axis=1)
    spectra = _Spectra(_spectrum(force - mean[:, None]), _spectrum(rate), mean, n, n * each * period)
    return [spectra.band(*band) for band in BANDS if ROOM * band[1] <= 1.0 / (each * period)]


def _busiest(rate: Array, n: int) -> slice:
    """The n rows of rate (N, 3) with most turning, all if there are no more."""
    if len(rate) <= n:
        return slice(None)
    some = max(1, n // 1000)
    turning = np.concatenate([[0.0], np.cumsum(np.sum(rate[::some] ** 2, axis=1))])
    first = some * int(np.argmax(turning[n // some :] - turning[: -(n // some)]))
    return slice(first, first + n)


def _thinned(values: Array, each: int) -> Array:
    """Means (3, N // each) of `each` neighbours of values (N, 3)."""
    n = len(values) // each
    mean = np.tile(np.eye(3), each) / each
    return np.asarray(mean @ values[: n * each].reshape(n, 3 * each).T)


def _spectrum(values: Array) -> np.ndarray:
    """Fourier transform of values (3, n), which fade in and out over a block: the two ends need not meet."""
    edge = np.sin(0.5 * np.pi * (np.arange(BLOCK) + 0.5) / BLOCK) ** 2
    faded = values.copy()
    faded[:, :BLOCK] *= edge
    faded[:, -BLOCK:] *= edge[::-1]
    return np.fft.rfft(faded)


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Fourier transforms (3, n // 2 + 1) of n rows of force about its mean (3,) and rate, which last for `span` s."""

    force: np.ndarray
    rate: np.ndarray
    mean: Array
    n: int
    span: float

    def band(self, low: float, high: float) -> BandDelay:
        """Delay and size between two frequencies, Hz, by weighted least squares.

        The slow force is as late as all of it: it is taken to the time of the rate once a delay is known.
        """
        found = self._fitted(low, high, 0.0)
        return self._fitted(low, high, found.delay) if found.holds and abs(found.delay) > SMALLEST else found

    def _fitted(self, low: float, high: float, late: float) -> BandDelay:
        coarser = min(16, 1 << int(math.log2(self.n / (self.span * ROOM * high))))
        band = _Band(math.ceil(low * self.span), math.ceil(high * self.span), self.n // coarser, self.span)
        below = _Band(0, band.first, band.n, self.span)
        slow = below.rows(self.force[:, : band.first] * np.exp(below.omega * late)) + self.mean[:, None] * coarser
        fast = band.rows(self.rate[:, band.first : band.last])
        turned = np.cross(slow, fast, axis=0) / coarser
        x = np.fft.rfft(turned)[:, band.first : band.last]
        y = band.omega * self.force[:, band.first : band.last]
        return _fitted(low, high, x, y, band, BLOCK // coarser)


@dataclass(frozen=True, eq=False)
class _Band:
    """Frequencies first <= k < last of spectra of n rows that last for `span` s."""

    first: int
    last: int
    n: int
    span: float

    @property
    def omega(self) -> np.ndarray:
        """Factors (last - first,) of a derivative by time, rad/s times i."""
        return np.asarray(2j * np.pi / self.span * np.arange(self.first, self.last))

    def rows(self, spectrum: np.ndarray) -> Array:
        """Rows (3, n) of a spectrum (3, last - first) that is zero elsewhere."""
        whole = np.zeros((3, self.n // 2 + 1), dtype=np.complex128)
        whole[:, self.first : self.last] = spectrum
        return np.fft.irfft(whole, self.n)


def _fitted(low: float, high: float, x: np.ndarray, y: np.ndarray, band: _Band, block: int) -> BandDelay:
    """The delay and size for which y(t) = size x(t - delay) + noise, from spectra (3, b); rows of a block: `block`.

    The noise has a covariance of its own, found from what is left: jerk is strongest where there is no turning under a
    force, so that the axes of the box do not matter. Sigmas are from the scatter between blocks (the sandwich of White
    1980), whatever the noise's colour.
    """
    floor = FLOOR * np.eye(3) * max(float(np.sum(np.abs(y) ** 2)), 1e-30)
    delay, size, left = 0.0, 0.0, y
    weight = np.eye(3)
    for solution in range(_SOLUTIONS):
        weight = np.linalg.inv((left @ left.conj().T).real + floor)
        cross = np.sum((weight @ x).conj() * y, axis=0)
        delay = _peak(cross, band.omega, delay if solution else None, high)
        later = x * np.exp(-band.omega * delay)
        power = float(np.sum((weight @ x).conj() * x).real)
        size = float(np.sum(cross * np.exp(band.omega * delay)).real) / max(power, 1e-300)
        left = y - size * later
    whole = float(np.sum((weight @ y).conj() * y).real)
    correlation = size * math.sqrt(power / max(whole, 1e-300))
    if not SIZES[0] < size < SIZES[1]:
        return BandDelay(low, high, delay, math.inf, size, math.inf, correlation)
    rest, by_size, by_delay = (band.rows(s) for s in (left, later, -size * band.omega * later))
    sigmas = [_sigma(weight @ slope, slope, rest, block) for slope in (by_size, by_delay)]
    return BandDelay(low, high, delay, sigmas[1], size, sigmas[0], correlation)


def _peak(cross: np.ndarray, omega: np.ndarray, near: float | None, high: float) -> float:
    """The delay, s, within LARGEST, by which the cross spectrum (b,) is most in step; from `near` on if that is known.

    omega (b,) rad/s times i. Newton's method, from the best of delays a tenth of the shortest period apart.
    """
    if near is None:
        delays = np.arange(-LARGEST, LARGEST, 0.1 / high)
        turned, turn, steps = cross * np.exp(-omega * LARGEST), np.exp(omega * 0.1 / high), []
        for _ in delays:  # products cost less than exponentials
            steps.append(float(np.sum(turned.real)))
            turned = turned * turn
        near = float(delays[int(np.argmax(steps))])
    for _ in range(4):
        turned = omega * cross * np.exp(omega * near)
        slope, bend = float(np.sum(turned).real), float(np.sum(omega * turned).real)
        if bend >= 0.0:
            break
        near = min(max(near - slope / bend, -LARGEST), LARGEST)
    return near


def _sigma(weighted: Array, slope: Array, rest: Array, block: int) -> float:
    """Sigma of what the rows change by `slope` (3, n) with, from scores summed over blocks; the faded ones left out."""
    score = np.sum(weighted * rest, axis=0).reshape(-1, block).sum(axis=1)[1:-1]
    information = float(np.sum(weighted * slope))
    return math.sqrt(float(score @ score)) / information if information > 0.0 else math.inf


# Force and rate of one time: an accelerometer that is late behind its gyroscope, taken to the gyroscope's time.

# s, beforehand: sensors of one chip, as loggers have them, are within 3 ms by its filters, which
# is what the sigmas of the GPS delays count on. (Of two chips it may be ten times that, and then those are off by it.)
USUAL = 3e-3


def in_step(session: Session) -> tuple[Session, ForceDelay]:
    """Return the session with its force at the time of its rate, and what was found; as it is where nothing was.

    Its stamps are as unsure as that leaves them (:attr:`ForceDelay.unsure`).
    """
    assert session.imu is not None
    imu = session.imu
    found = force_delay(imu.t, imu.specific_force_s, imu.angular_rate_s)
    if found.is_found:
        imu = advanced(imu, found.delay)
    if found.unsure > 0.0:
        imu = replace(imu, stamp_sigma=math.hypot(imu.stamp_sigma, found.unsure))
    return session if imu is session.imu else replace(session, imu=imu), found


def advanced(imu: ImuSamples, delay: float) -> ImuSamples:
    """Return the samples with the force of `delay` s later; at the last ones, that have none, what is there last.

    Between samples by cubics with slopes from the samples on either side, which at 25 Hz keep 98 % of what changes four
    times a second where straight lines keep 88 %; beside a gap the force stays near what it is at the edge.
    """
    force = roomy(imu.specific_force_s.shape)
    for part in pieces(len(imu.t)):
        force[part] = _cubic(imu.t, imu.specific_force_s, np.clip(imu.t[part] + delay, imu.t[0], imu.t[-1]))
        release(imu, force)
    return replace(imu, specific_force_s=force)


def _cubic(t: Array, values: Array, at: Array) -> Array:
    """Values (M, c) at times `at` (M,) within t (N,), of `values` (N, c). Source: Catmull & Rom 1974.

    Stamps may be uneven: slopes are those of the chords from neighbour to neighbour, which beside a gap are gentle.
    """
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    before, after = np.maximum(k - 1, 0), np.minimum(k + 2, len(t) - 1)
    step = t[k + 1] - t[k]
    u = ((at - t[k]) / step)[:, None]
    first, second = values[k], values[k + 1]
    rise = (second - values[before]) * (step / (t[k + 1] - t[before]))[:, None]
    later_rise = (values[after] - first) * (step / (t[after] - t[k]))[:, None]
    change = second - first
    bend, twist = 3.0 * change - 2.0 * rise - later_rise, rise + later_rise - 2.0 * change
    return np.asarray(first + u * (rise + u * (bend + u * twist)))


def identified(found: ForceDelay) -> Identified:
    """The reported latency: the corrected one, or 0, with its sigma."""
    if found.is_found:
        return Identified(found.delay, found.sigma, "s", True, "identified")
    told = math.hypot(found.delay, found.sigma) if found.is_seen else math.inf
    sigma = 1.0 / math.hypot(1.0 / told, 1.0 / USUAL) if told > 0.0 else USUAL
    return Identified(0.0, sigma, "s", sigma < 0.5 * USUAL, "default")
