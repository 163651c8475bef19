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
ROOM = 2.5  # least samples in the shortest period of a band
BLOCK = 256  # rows; errors of one block, 5 s or more, are independent of those of others
FEWEST_BLOCKS = 12  # for a sigma to 20 %; a minute of samples
LONGEST = 1200.0  # s; of longer sessions the part with most turning
# s; less than a period of the fastest band. Filters differ by up to 30 ms (MPU-9250 register map: 32.5 ms at 5 Hz, 2.9
# at 184 Hz), and a logger may read its sensors one after the other.
LARGEST = 0.15
SMALLEST = 0.005  # s; less changes the force by less than vibration does: 0.15 m/s^2 where the box turns at 3 rad/s
# of the left side over the right one; a lever of 5 mm makes 1.3 at 4 Hz, a filter at its edge 0.7
SIZES = (0.7, 1.4)
# sigmas by which the size is within SIZES, and bands where it is: one can be so by chance. Of 308 simulated karts with
# the box on the frame none has two such bands; at 1.5 sigmas one has
CERTAIN, FEWEST_BANDS = 2.5, 2
SIGNIFICANT, LIKELY = 5.0, 2.5  # sigmas
AT_ODDS = 3.0  # rms of the bands' deviations, in their sigmas, above which they contradict one another
FLOOR = 1e-6  # least noise, in parts of the power of the force: sensors round
USUAL = 3e-3  # s, prior: sensors of one chip are within 3 ms by its filters


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

    def identified(self) -> Identified:
        """The reported latency: the corrected one, or 0, with its sigma."""
        if self.is_found:
            return Identified(self.delay, self.sigma, "s", True, "identified")
        shown = math.hypot(self.delay, self.sigma) if self.is_seen else math.inf
        sigma = 1.0 / math.hypot(1.0 / shown, 1.0 / USUAL) if shown > 0.0 else USUAL
        return Identified(0.0, sigma, "s", sigma < 0.5 * USUAL, "default")


UNSEEN = ForceDelay(0.0, math.inf, False)


@dataclass(frozen=True)
class BandDelay:
    """Result of one band, Hz: delay s, and size of the left side over the right one.

    Both sigmas are infinite where the size shows that the band is useless.
    """

    low: float
    high: float
    delay: float
    sigma: float
    size: float
    size_sigma: float

    @property
    def correlated_error(self) -> float:
        """Error of the delay, s, by what is correlated with the turning: as much in quadrature as in phase.

        What is in phase shows in the size.
        """
        return abs(self.size - 1.0) / (2.0 * math.pi * math.sqrt(self.low * self.high))

    @property
    def holds(self) -> bool:
        """Whether the force changes in this band as in a sensor that is turned under a constant force."""
        margin = CERTAIN * self.size_sigma
        return SIZES[0] + margin < self.size < SIZES[1] - margin and abs(self.delay) < LARGEST and self.sigma > 0.0


def in_step(session: Session) -> tuple[Session, ForceDelay]:
    """Return the session with its force at the time of its rate, unchanged where no latency was found, and the latency.

    The uncertainty of the latency is added to that of the stamps.
    """
    assert session.imu is not None
    imu = session.imu
    found = force_delay(imu.t, imu.specific_force_s, imu.angular_rate_s)
    if found.is_found:
        imu = advanced(imu, found.delay)
    if found.unsure > 0.0:
        imu = replace(imu, stamp_sigma=math.hypot(imu.stamp_sigma, found.unsure))
    return session if imu is session.imu else replace(session, imu=imu), found


def force_delay(t: Array, specific_force_s: Array, angular_rate_s: Array) -> ForceDelay:
    """Return the delay of force (N, 3) m/s^2 behind rate (N, 3) rad/s, both stamped t (N,) s and in the same axes.

    The mean of the bands that hold, by their variances; its sigma grows where they differ by more than these predict.
    """
    held = [band for band in band_delays(t, specific_force_s, angular_rate_s) if band.holds]
    if len(held) < FEWEST_BANDS:
        return UNSEEN
    weight = np.array([math.hypot(band.sigma, band.correlated_error) for band in held]) ** -2.0
    delays = np.array([band.delay for band in held])
    mean = float(weight @ delays / weight.sum())
    at_odds = math.sqrt(float(weight @ (delays - mean) ** 2) / (len(held) - 1))
    if at_odds > AT_ODDS:
        return UNSEEN
    return ForceDelay(mean, max(1.0, at_odds) / math.sqrt(float(weight.sum())), True)


def band_delays(t: Array, specific_force_s: Array, angular_rate_s: Array) -> list[BandDelay]:
    """Return the result of each band that the samples are fast enough for; arguments as of :func:`force_delay`.

    Stamps may be uneven and have gaps: force and rate share them, so that their delay is hardly affected.
    """
    if len(t) < FEWEST_BLOCKS * BLOCK:
        return []
    period = median(np.diff(t))
    busy = _busiest(angular_rate_s, round(LONGEST / period))
    each = max(1, round(1.0 / (FASTEST * period)))
    n = len(angular_rate_s[busy]) // each // BLOCK * BLOCK
    if n < FEWEST_BLOCKS * BLOCK:
        return []
    force, rate = (
        values[busy][: n * each].reshape(n, each, 3).mean(axis=1).T for values in (specific_force_s, angular_rate_s)
    )
    rows = _Rows(force, rate, each * period)
    return [rows.band(*band) for band in BANDS if ROOM * band[1] * each * period <= 1.0]


def _busiest(rate: Array, n: int) -> slice:
    """The n rows of rate (N, 3) with most turning, all if there are no more."""
    if len(rate) <= n:
        return slice(None)
    some = max(1, n // 1000)
    turning = np.concatenate([[0.0], np.cumsum(np.sum(rate[::some] ** 2, axis=1))])
    first = some * int(np.argmax(turning[n // some :] - turning[: -(n // some)]))
    return slice(first, first + n)


class _Rows:
    """Spectra of force and rate (3, n), `step` s apart."""

    def __init__(self, force: Array, rate: Array, step: float) -> None:
        self._n = force.shape[1]
        self._mean = force.mean(axis=1, keepdims=True)
        self._omega = 2j * np.pi * np.fft.rfftfreq(self._n, step)  # of a derivative by time
        edge = np.sin(0.5 * np.pi * (np.arange(BLOCK) + 0.5) / BLOCK) ** 2
        window = np.concatenate([edge, np.ones(self._n - 2 * BLOCK), edge[::-1]])
        self._force, self._rate = np.fft.rfft((force - self._mean) * window), np.fft.rfft(rate * window)

    def band(self, low: float, high: float) -> BandDelay:
        """Delay and size between two frequencies, Hz.

        The slow force is as late as all of it: it is advanced once a delay is known.
        """
        found = self._fitted(low, high, 0.0)
        return self._fitted(low, high, found.delay) if found.holds and abs(found.delay) > SMALLEST else found

    def _fitted(self, low: float, high: float, late: float) -> BandDelay:
        """Delay and size for which y(t) = size x(t - delay) + noise, by least squares; y: df/dt, x: -w x f.

        The noise has a covariance (3, 3) of its own, from the residuals. Sigmas are from the scatter between blocks
        (the sandwich of White 1980).
        """
        frequency = self._omega.imag / (2.0 * np.pi)
        inside, below = (frequency >= low) & (frequency < high), frequency < low
        slow = self._mean + self._filtered(self._force[:, below] * np.exp(self._omega[below] * late), below)
        x = np.fft.rfft(np.cross(slow, self._filtered(self._rate[:, inside], inside), axis=0))[:, inside]
        omega = self._omega[inside]
        y = omega * self._force[:, inside]
        floor = FLOOR * np.eye(3) * max(float(np.sum(np.abs(y) ** 2)), 1e-30)
        delay, left = 0.0, y
        for turn in range(3):  # of delay, size and noise
            weight = np.linalg.inv((left @ left.conj().T).real + floor)
            cross = np.sum((weight @ x).conj() * y, axis=0)
            delay = _peak(cross, omega, delay if turn else None, high)
            later = x * np.exp(-omega * delay)
            power = float(np.sum((weight @ x).conj() * x).real)
            size = float(np.sum(cross * np.exp(omega * delay)).real) / max(power, 1e-300)
            left = y - size * later
        if not SIZES[0] < size < SIZES[1]:
            return BandDelay(low, high, delay, math.inf, size, math.inf)
        rest, by_size, by_delay = (self._filtered(z, inside) for z in (left, later, -size * omega * later))
        return BandDelay(
            low, high, delay, _sigma(weight @ by_delay, by_delay, rest), size, _sigma(weight @ by_size, by_size, rest)
        )

    def _filtered(self, spectrum: np.ndarray, inside: np.ndarray) -> Array:
        """Rows (3, n) of a spectrum at the frequencies `inside` (n // 2 + 1,), zero elsewhere."""
        whole = np.zeros((3, len(inside)), dtype=np.complex128)
        whole[:, inside] = spectrum
        return np.fft.irfft(whole, self._n)


def _peak(cross: np.ndarray, omega: np.ndarray, near: float | None, high: float) -> float:
    """The delay, s, within LARGEST, at which the cross-correlation of spectrum `cross` (b,) is largest.

    By Newton's method from `near`, or from the best of delays a tenth of the shortest period apart.
    """
    if near is None:
        delays = np.arange(-LARGEST, LARGEST, 0.1 / high)
        near = float(delays[int(np.argmax((np.exp(np.outer(delays, omega)) @ cross).real))])
    for _ in range(4):
        turned = omega * cross * np.exp(omega * near)
        slope, bend = float(np.sum(turned).real), float(np.sum(omega * turned).real)
        if bend >= 0.0:
            break
        near = min(max(near - slope / bend, -LARGEST), LARGEST)
    return near


def _sigma(weighted: Array, slope: Array, rest: Array) -> float:
    """Sigma of a parameter with Jacobian `slope` (3, n), from scores summed over blocks; the faded ones left out."""
    score = np.sum(weighted * rest, axis=0).reshape(-1, BLOCK).sum(axis=1)[1:-1]
    information = float(np.sum(weighted * slope))
    return math.sqrt(float(score @ score)) / information if information > 0.0 else math.inf


def advanced(imu: ImuSamples, delay: float) -> ImuSamples:
    """Return the samples with the force of `delay` s later, held at the last ones.

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

    Slopes are those of the chords from neighbour to neighbour, which beside a gap are gentle.
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
