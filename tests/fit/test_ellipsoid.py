import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import least_squares
from scipy.stats import chi2

from smoother import so3
from smoother.fit import quadric
from smoother.fit.ellipsoid import FitError, _foot_points, fit_ellipsoid

TRIANGLE = ([0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2])
CENTRE = np.array([10.0, -20.0, 30.0])


def directions(n, rng):
    u = rng.normal(size=(n, 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


def matrix(values):
    A = np.zeros((3, 3))
    A[TRIANGLE] = values
    return A + np.triu(A, 1).T


def random_ellipsoid(rng):
    """Centre, and a symmetric matrix to the unit sphere with semi-axes of 33 to 100: strong soft iron."""
    _, axes = np.linalg.eigh(matrix(rng.normal(size=6)))
    return rng.normal(size=3) * 40.0, axes @ np.diag(rng.uniform(0.01, 0.03, 3)) @ axes.T


def readings(centre, A, n, noise, rng):
    return centre + directions(n, rng) @ np.linalg.inv(A) + noise * rng.normal(size=(n, 3))


def parameters(centre, A):
    return np.concatenate([centre, A[TRIANGLE]])


def independent_fit(points, start):
    """Orthogonal distances, foot points by constrained minimisation of nothing but geometry: free surface points."""
    n = len(points)

    def residual(x):
        centre, A, angles = x[:3], matrix(x[3:9]), x[9:].reshape(n, 2)
        u = np.stack(
            [
                np.sin(angles[:, 0]) * np.cos(angles[:, 1]),
                np.sin(angles[:, 0]) * np.sin(angles[:, 1]),
                np.cos(angles[:, 0]),
            ]
        )
        return (points - centre - np.linalg.solve(A, u).T).ravel()

    u = (points - start[:3]) @ matrix(start[3:])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    angles = np.stack([np.arccos(u[:, 2]), np.arctan2(u[:, 1], u[:, 0])], axis=1)
    # the matrix entries are a thousand times smaller than the rest
    scale = np.concatenate([np.full(3, 50.0), np.full(6, 0.02), np.full(2 * n, 0.05)])
    return least_squares(
        residual, np.concatenate([start, angles.ravel()]), x_scale=scale, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )


def test_exact_points_give_the_ellipsoid_back():
    rng = np.random.default_rng(1)
    centre, A = random_ellipsoid(rng)
    fit = fit_ellipsoid(readings(centre, A, 200, 0.0, rng))
    np.testing.assert_allclose(fit.centre, centre, atol=1e-8)
    np.testing.assert_allclose(fit.to_unit_sphere, A, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(fit.semi_axes, np.sort(1.0 / np.linalg.eigvalsh(A))[::-1], rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(fit.apply(centre + directions(9, rng) @ np.linalg.inv(A)), axis=1), 1.0)


def test_the_matrix_is_the_symmetric_positive_root_whatever_rotation_made_the_points():
    rng = np.random.default_rng(2)
    centre, A = random_ellipsoid(rng)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    points = centre + directions(300, rng) @ np.linalg.inv(turn @ A).T  # measured = inverse(turn A) u
    fit = fit_ellipsoid(points)
    np.testing.assert_allclose(fit.to_unit_sphere, fit.to_unit_sphere.T, atol=1e-15)
    np.testing.assert_allclose(fit.to_unit_sphere, A, rtol=1e-7, atol=1e-11)


def test_the_axes_point_along_the_semi_axes():
    rng = np.random.default_rng(3)
    centre, A = random_ellipsoid(rng)
    fit = fit_ellipsoid(readings(centre, A, 300, 0.1, rng))
    ends = fit.centre[:, None] + fit.axes * fit.semi_axes
    np.testing.assert_allclose(np.linalg.norm(fit.apply(ends.T), axis=1), 1.0, rtol=1e-9)


def test_it_equals_an_independent_least_squares_solution_but_for_the_bias_of_orthogonal_distances():
    rng = np.random.default_rng(4)
    centre, A = random_ellipsoid(rng)
    points = readings(centre, A, 150, 0.2, rng)
    fit = fit_ellipsoid(points)
    other = independent_fit(points, parameters(fit.centre, fit.to_unit_sphere))
    sigma = np.sqrt(np.diagonal(fit.covariance))
    # the bias is sigma^2 / r = 0.001 of a semi-axis, 0.03 of its standard deviation here
    np.testing.assert_array_less(np.abs(other.x[:9] - parameters(fit.centre, fit.to_unit_sphere)), 0.08 * sigma)
    J, n = other.jac, len(points)
    information = J.T @ J
    covariance = 2.0 * other.cost / (n - 9) * np.linalg.inv(information)[:9, :9]
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance)), sigma, rtol=0.02)  # second order in noise / radius


def test_the_noise_does_not_swell_the_ellipsoid():
    # Plain orthogonal distances are too long by sigma^2 / r = 0.5 here, 12 standard deviations of the mean axis.
    rng = np.random.default_rng(5)
    fit = fit_ellipsoid(readings(CENTRE, np.eye(3) / 50.0, 20000, 5.0, rng))
    assert abs(np.mean(fit.semi_axes) - 50.0) < 0.13


@pytest.mark.parametrize(
    ("n", "noise", "outliers", "quantum"),
    [(600, 2.5, 0.0, 0.0), (400, 0.5, 0.1, 0.0), (400, 0.3, 0.0, 1.0)],
    ids=["noisy", "outliers", "quantised"],
)
def test_the_covariance_is_honest(n, noise, outliers, quantum):
    rng = np.random.default_rng(6)
    runs, nees, inside = 40, [], []
    for _ in range(runs):
        centre, A = random_ellipsoid(rng)
        points = readings(centre, A, n, noise, rng)
        bad = rng.random(n) < outliers
        points[bad] += 60.0 * rng.normal(size=(int(bad.sum()), 3))
        if quantum:
            points = np.round(points / quantum) * quantum
        fit = fit_ellipsoid(points)
        error = parameters(fit.centre - centre, fit.to_unit_sphere - A)
        nees.append(error @ np.linalg.solve(fit.covariance, error))
        inside.append(np.abs(error) < np.sqrt(np.diagonal(fit.covariance)))
    # 99.9 % bounds of the sum of 40 chi-squares of 9 degrees
    low, high = chi2.ppf([0.0005, 0.9995], 9 * runs) / runs
    assert low < np.mean(nees) < high
    assert 0.60 < np.mean(inside) < 0.76  # 68.3 % of 360, correlated within a run


def test_the_sigmas_of_the_semi_axes_are_honest():
    rng = np.random.default_rng(7)
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    A = axes @ np.diag([1 / 30.0, 1 / 50.0, 1 / 80.0]) @ axes.T
    z = []
    for _ in range(40):
        fit = fit_ellipsoid(readings(CENTRE, A, 300, 1.0, rng))
        z.append((fit.semi_axes - [80.0, 50.0, 30.0]) / fit.semi_axes_sigma)
    assert 0.77 < np.sqrt(np.mean(np.square(z))) < 1.23  # 120 values: one, within 3.6 of its deviations


def test_the_sigmas_of_the_semi_axes_follow_from_the_covariance_of_the_matrix():
    rng = np.random.default_rng(18)
    centre, A = random_ellipsoid(rng)
    fit = fit_ellipsoid(readings(centre, A, 200, 1.0, rng))
    J = so3.numerical_jacobian(
        lambda entries: 1.0 / np.linalg.eigvalsh(matrix(entries)), fit.to_unit_sphere[TRIANGLE], step=1e-8
    )
    sigma = np.sqrt(np.diagonal(J @ fit.covariance[3:, 3:] @ J.T))
    np.testing.assert_allclose(fit.semi_axes_sigma, sigma, rtol=1e-4)


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_wild_outliers_leave_the_fit_where_it_was(share):
    rng = np.random.default_rng(8)
    for _ in range(5):
        centre, A = random_ellipsoid(rng)
        points = readings(centre, A, 800, 1.0, rng)
        bad = rng.random(800) < share
        points[bad] = centre + 300.0 * rng.normal(size=(int(bad.sum()), 3))
        fit = fit_ellipsoid(points)
        assert np.all(np.abs(fit.centre - centre) < 5.0 * np.sqrt(np.diagonal(fit.covariance)[:3]))
        assert np.mean(fit.is_used[bad]) < 0.1
        assert np.mean(fit.is_used[~bad]) > 0.99


def test_a_logger_that_lay_still_most_of_the_time_is_fitted():
    rng = np.random.default_rng(9)
    turned = readings(CENTRE, np.eye(3) / 50.0, 1000, 0.0, rng)
    resting = np.tile(turned[np.argmax(turned[:, 0])], (5000, 1))  # at the end of an axis, where saturation would be
    points = np.round(np.concatenate([resting, turned]) + 0.3 * rng.normal(size=(6000, 3)))
    fit = fit_ellipsoid(points)
    np.testing.assert_allclose(fit.semi_axes, 50.0, atol=0.2)
    np.testing.assert_allclose(fit.centre, CENTRE, atol=0.2)


def test_an_offset_of_a_million_costs_no_precision():
    rng = np.random.default_rng(10)
    points = readings(np.zeros(3), np.eye(3) / 50.0, 500, 1.0, rng)
    near, far = fit_ellipsoid(points), fit_ellipsoid(points + 1e6)
    np.testing.assert_allclose(far.centre - 1e6, near.centre, atol=1e-4)
    np.testing.assert_allclose(far.semi_axes, near.semi_axes, rtol=1e-6)


def test_coverage_is_the_share_of_directions_seen():
    rng = np.random.default_rng(11)
    points = readings(CENTRE, np.eye(3) / 50.0, 4000, 0.1, rng)
    assert fit_ellipsoid(points).coverage == 1.0
    assert abs(fit_ellipsoid(points[points[:, 2] > CENTRE[2]]).coverage - 0.5) < 0.05


def sphere(n=500):
    return readings(CENTRE, np.eye(3) / 50.0, n, 0.5, np.random.default_rng(12))


def circle(n=500):
    rng = np.random.default_rng(13)
    normal = directions(1, rng)[0]
    u = directions(n, rng)
    u -= np.outer(u @ normal, normal)
    return CENTRE + 50.0 * u / np.linalg.norm(u, axis=1, keepdims=True) + 0.5 * rng.normal(size=(n, 3))


def with_nan():
    points = sphere().copy()
    points[7, 1] = np.nan
    return points


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (circle(), "one plane"),
        (sphere() * [1.0, 1.0, 0.0], "one plane"),
        (np.outer(np.linspace(-1, 1, 300), [1.0, 2.0, 3.0]), "one plane or on a line"),
        (np.ones((500, 3)), "constant"),
        (sphere()[:3], "3 points are too few"),
        (np.empty((0, 3)), "0 points are too few"),
        (with_nan(), "1 of 500 points are not finite"),
        (np.minimum(sphere(), 60.0), "z axis is saturated"),
        (np.clip(np.round(sphere()), -40.0, 40.0), "axis is saturated"),
        (np.random.default_rng(14).normal(size=(500, 3)), "cover too little"),
        (sphere()[np.abs(sphere()[:, 2] - 30.0) < 4.0], "cover too little"),
        (np.zeros((50, 2)), "three columns"),
    ],
    ids=[
        "circle",
        "flat",
        "line",
        "constant",
        "three",
        "none",
        "nan",
        "clipped",
        "clipped counts",
        "noise",
        "band",
        "2d",
    ],
)
def test_degenerate_points_are_refused_in_one_sentence(points, says):
    with pytest.raises(FitError, match=says) as error:
        fit_ellipsoid(points)
    assert "\n" not in str(error.value)


def test_a_handful_of_different_readings_is_not_enough_however_often_they_repeat():
    with pytest.raises(FitError, match="only 6 readings differ"):
        fit_ellipsoid(np.tile(50.0 * np.vstack([np.eye(3), -np.eye(3)]), (40, 1)))


@settings(max_examples=60, deadline=None)
@given(
    arrays(
        np.float64,
        st.tuples(st.integers(0, 40), st.just(3)),
        elements=st.one_of(st.floats(-1e9, 1e9), st.integers(-2, 2).map(float)),
    )
)
def test_any_points_are_fitted_or_refused_without_a_warning(points):
    try:
        fit = fit_ellipsoid(points)
    except FitError:
        return
    assert np.all(np.isfinite(fit.centre))
    assert np.all(np.linalg.eigvalsh(fit.to_unit_sphere) > 0.0)
    assert np.all(np.linalg.eigvalsh(fit.covariance) >= -1e-9 * np.max(np.diagonal(fit.covariance)))


def test_coarse_readings_are_not_taken_for_saturated_ones():
    fit = fit_ellipsoid(np.round(sphere() / 8.0) * 8.0)
    np.testing.assert_allclose(fit.semi_axes, 50.0, atol=1.5)


def test_the_points_are_not_changed():
    points = sphere()
    before = points.copy()
    fit_ellipsoid(points)
    np.testing.assert_array_equal(points, before)


def test_foot_points_lie_on_the_surface_straight_below_their_points():
    rng = np.random.default_rng(15)
    _, A = random_ellipsoid(rng)
    y = 60.0 * rng.normal(size=(500, 3))
    x = _foot_points(y, A)
    np.testing.assert_allclose(np.linalg.norm(x @ A, axis=1), 1.0, rtol=1e-7)
    normal = x @ (A @ A)
    across = np.linalg.norm(np.cross(y - x, normal), axis=1)
    assert np.all(across < 1e-6 * np.linalg.norm(y, axis=1) * np.linalg.norm(normal, axis=1))


def test_the_algebraic_start_needs_no_refinement_on_exact_points():
    rng = np.random.default_rng(16)
    centre, A = random_ellipsoid(rng)
    found = quadric.robust_start(readings(centre, A, 200, 0.0, rng) / 50.0)
    assert found is not None
    np.testing.assert_allclose(found[0] * 50.0, centre, atol=1e-6)
    np.testing.assert_allclose(found[1] / 50.0, A, atol=1e-9)


@pytest.mark.parametrize(
    ("folder", "centre", "semi_axes"),
    [
        ("calib_mpu6050_fullsphere", (-0.006, -0.105, 0.020), (0.583, 0.545, 0.474)),
        ("calib_hipnuc_rotation", (-0.4, 1.1, 0.0), (59.3, 58.7, 56.4)),
    ],
)
def test_real_recordings_give_their_published_ellipsoids(data_directory, folder, centre, semi_axes):
    path = data_directory / folder / "mag.csv"
    if not path.exists():
        pytest.skip(f"no {folder}")
    table = np.genfromtxt(path, delimiter=",", names=True)
    fit = fit_ellipsoid(np.stack([table[name] for name in ("mx", "my", "mz")], axis=1))
    np.testing.assert_allclose(fit.semi_axes, semi_axes, rtol=0.01)
    np.testing.assert_allclose(fit.centre, centre, atol=0.01 * np.mean(semi_axes))


def test_a_logger_at_rest_with_coarse_counts_gives_no_huge_ellipsoid():
    rng = np.random.default_rng(20)
    points = np.round((np.array([1.2, -0.1, 9.8]) + 0.01 * rng.standard_normal((20000, 3))) / 0.01) * 0.01
    points[:, 0] = np.round(1.2 + 0.001 * rng.standard_normal(20000), 2)
    with pytest.raises(FitError):
        fit_ellipsoid(points)


def test_a_real_accelerometer_turned_slowly_gives_its_published_ellipsoid(data_directory):
    path = data_directory / "calib_mpu6050_fullsphere" / "imu.csv"
    if not path.exists():
        pytest.skip("no calib_mpu6050_fullsphere")
    table = np.genfromtxt(path, delimiter=",", names=True)
    fit = fit_ellipsoid(np.stack([table[name] for name in ("ax", "ay", "az")], axis=1) / 9.80665)
    np.testing.assert_allclose(fit.semi_axes, (1.023, 1.012, 1.003), rtol=0.01)
    # published for readings of gravity, which are minus the specific force in the file
    np.testing.assert_allclose(-fit.centre, (0.016, 0.016, -0.021), atol=0.01)
