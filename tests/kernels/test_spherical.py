"""Triangles, rectangles and spheres in solid angle: uniform, inside the shape, and one density for both sides."""

from __future__ import annotations

import numpy as np
import pytest
from light_checks import (
    assert_float32,
    assert_frequencies,
    from_python,
    mean_direction_of_polygon,
    triangle_solid_angles,
    vec,
)

from engine.kernels.jit import kernel
from engine.kernels.light.spherical import (
    atan2_upper,
    rectangle_pdf,
    sample_rectangle,
    sample_sphere,
    sample_triangle,
    sphere_pdf,
    triangle_pdf,
)

CELLS = 16

call_sample_triangle, call_triangle_pdf = from_python(sample_triangle), from_python(triangle_pdf)
call_sample_rectangle, call_rectangle_pdf = from_python(sample_rectangle), from_python(rectangle_pdf)
call_sphere_pdf = from_python(sphere_pdf)
call_atan2_upper = from_python(atan2_upper)


@kernel
def draw_triangle(p, v0, v1, v2, u, out):
    for i in range(len(u)):
        wi, t, pdf = sample_triangle(p, v0, v1, v2, u[i, 0], u[i, 1])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = wi[0], wi[1], wi[2], t, pdf


@kernel
def draw_rectangle(p, corner, edge_u, edge_v, u, out):
    for i in range(len(u)):
        wi, t, pdf = sample_rectangle(p, corner, edge_u, edge_v, u[i, 0], u[i, 1])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = wi[0], wi[1], wi[2], t, pdf


@kernel
def draw_sphere(p, n, center, radius, u, out):
    for i in range(len(u)):
        wi, t, pdf = sample_sphere(p, n, center, radius, u[i, 0], u[i, 1])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = wi[0], wi[1], wi[2], t, pdf


def random_numbers(count: int, seed: int = 1) -> np.ndarray:
    return np.minimum(np.random.default_rng(seed).random((count, 2)), 1 - 2**-24).astype(np.float32)


def stratified(side: int) -> np.ndarray:
    grid = (np.arange(side) + 0.5) / side
    return np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)


def as_arrays(out: np.ndarray):
    """(directions, distances, densities) float64"""
    return out[:, :3].astype(np.float64), out[:, 3].astype(np.float64), out[:, 4].astype(np.float64)


# Seen from the origin.
TRIANGLES = {
    "medium": [(-1, -1, 1), (1, -1, 1), (0, 1, 1.5)],
    "mirrored": [(1, -1, 1), (-1, -1, 1), (0, 1, 1.5)],
    "far": [(-0.1, -0.1, 3), (0.1, -0.1, 3), (0, 0.1, 3)],
    "far and huge": [(-1e3, -1e3, 3e4), (1e3, -1e3, 3e4), (0, 1e3, 3e4)],
    "tiny": [(-1e-4, -1e-4, 2e-4), (1e-4, -1e-4, 2e-4), (0, 1e-4, 2e-4)],
    "nearly the hemisphere": [(-2, -1, 0.01), (2, -1, 0.01), (0, 3, 0.01)],
    "very nearly the hemisphere": [(-2, -1, 1e-4), (2, -1, 1e-4), (0, 3, 1e-4)],
    "plane passes close by": [(1, -1, 1e-3), (3, -1, 1e-3), (2, 1, 1e-3)],
    "sliver": [(-1, 0, 1), (1, 0, 1), (0, 1e-3, 1)],
    "sliver seen along": [(0, 0, 0.5), (0, 0.01, 5), (0.01, 0, 5)],
    "vertex close by": [(0, 0, 1e-3), (1, 0, 1), (0, 1, 1)],
}


def barycentric_cells(points: np.ndarray, vertices: np.ndarray, cells: int) -> np.ndarray:
    """Index of the cell of each point in a grid of cells^2 triangles, as `triangle_cells` orders them."""
    a, b, c = vertices
    edges = np.stack([b - a, c - a], axis=1)
    w = np.linalg.lstsq(edges, (points - a).T, rcond=None)[0] * cells
    w = np.clip(w, 0, cells)
    i, j = (np.minimum(x.astype(int), cells - 1) for x in w)
    upper = (w[0] - i) + (w[1] - j) > 1
    return (i * cells + j) * 2 + upper


def triangle_cells(vertices: np.ndarray, cells: int):
    """Corners of the cells; those beyond the diagonal have no area."""
    a, b, c = vertices
    i, j, upper = np.unravel_index(np.arange(cells * cells * 2), (cells, cells, 2))
    inside = i + j + upper < cells

    def at(x, y):
        return a + (x[:, None] * (b - a) + y[:, None] * (c - a)) / cells

    first = at(i + upper, j + upper)
    return inside, first, at(i + 1, j), at(i, j + 1)


COUNT = 200_000


@pytest.mark.parametrize("name", TRIANGLES)
def test_triangle_samples_are_uniform_in_solid_angle(name):
    vertices = np.array(TRIANGLES[name], np.float32).astype(np.float64)
    out = np.zeros((COUNT, 5), np.float32)
    draw_triangle(vec((0, 0, 0)), *(vec(v) for v in vertices), random_numbers(COUNT), out)
    assert_fills_triangle(vertices, *as_arrays(out))


def drawn_by_area(origin, u, v, triangle: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(directions, distances, densities) of points spread evenly in the plane, with the density of an even solid
    angle: what a sampler would be that forgets the cosine and the distance."""
    s, r = random_numbers(COUNT).astype(float).T
    if triangle:
        s, r = np.where(s + r > 1, (1 - s, 1 - r), (s, r))
    points = origin + s[:, None] * u + r[:, None] * v
    t = np.linalg.norm(points, axis=1)
    zero, corner = np.zeros(3), origin + u + v
    omega = triangle_solid_angles(zero, origin, origin + u, origin + v)
    if not triangle:
        omega += triangle_solid_angles(zero, corner, origin + u, origin + v)
    return points / t[:, None], t, np.full(COUNT, 1 / omega)


@pytest.mark.parametrize("name", ["medium", "tiny", "vertex close by"])
def test_a_triangle_that_is_filled_evenly_in_its_plane_is_caught(name):
    a, b, c = vertices = np.array(TRIANGLES[name], np.float64)
    with pytest.raises(AssertionError, match="chi-squared"):
        assert_fills_triangle(vertices, *drawn_by_area(a, b - a, c - a, triangle=True))


def assert_fills_triangle(vertices: np.ndarray, wi: np.ndarray, t: np.ndarray, pdf: np.ndarray) -> None:
    count = len(wi)
    inside, a, b, c = triangle_cells(vertices, CELLS)
    zero = np.zeros(3)
    omega = np.where(inside, triangle_solid_angles(zero, a, b, c), 0)
    total = float(triangle_solid_angles(zero, *vertices))
    assert np.isclose(omega.sum(), total, rtol=1e-9)
    assert np.mean(1 / pdf) == pytest.approx(total, rel=1e-2)
    assert np.allclose(np.linalg.norm(wi, axis=1), 1, atol=1e-6)

    # Area sampling is uniform in solid angle only once weighted, so expect each cell's own share.
    cell = barycentric_cells(wi * t[:, None], vertices, CELLS)
    areas = np.where(inside, 1 / inside.sum(), 0)
    uniform = np.ptp(pdf) <= 1e-5 * pdf.max()
    expected = omega / total if uniform else areas
    lost = ~inside[cell]
    assert lost.mean() < 1e-3  # rounding across the long edge
    assert_frequencies(np.bincount(cell[~lost], minlength=len(expected)), expected * count, len(TRIANGLES))


@pytest.mark.parametrize("name", TRIANGLES)
def test_triangle_density_integrates_to_one_and_agrees(name):
    corners = [vec(v) for v in TRIANGLES[name]]
    out = np.zeros((64 * 64, 5), np.float32)
    draw_triangle(vec((0, 0, 0)), *corners, stratified(64), out)
    assert_density_of_triangle(corners, *as_arrays(out))


@pytest.mark.parametrize("name", ["medium", "far", "nearly the hemisphere"])
def test_a_density_of_another_triangle_is_caught(name):
    """Off by 1 %; or with one corner moved by a part in some thousands."""
    corners = [vec(v) for v in TRIANGLES[name]]
    out = np.zeros((64 * 64, 5), np.float32)
    draw_triangle(vec((0, 0, 0)), *corners, stratified(64), out)
    wi, t, pdf = as_arrays(out)
    moved = [*corners[:2], vec(np.array(corners[2]) * (1, 1.01, 1))]
    for wrong, density in ((corners, pdf * 1.01), (moved, pdf)):
        with pytest.raises(AssertionError):
            assert_density_of_triangle(wrong, wi, t, density)


def assert_density_of_triangle(corners, wi: np.ndarray, t: np.ndarray, pdf: np.ndarray) -> None:
    """That of samples from the origin at a grid of random numbers."""
    v0, v1, v2 = np.array(corners, np.float32)
    p = vec((0, 0, 0))
    ng = vec(np.cross(v1 - v0, v2 - v0))
    again = [call_triangle_pdf(p, *corners, ng, vec(wi[i]), np.float32(t[i])) for i in range(0, len(wi), 37)]
    assert np.allclose(again, pdf[::37], rtol=1e-5)
    total = float(triangle_solid_angles(np.zeros(3), v0, v1, v2))
    mean = np.mean(wi / pdf[:, None], axis=0)
    assert np.allclose(mean, mean_direction_of_polygon(np.zeros(3), np.array(corners)), atol=2e-3 * total)


def test_points_lie_on_the_triangle_far_from_the_origin():
    offset = np.array([1000.0, -500.0, 200.0])
    vertices = np.array(TRIANGLES["medium"]) + offset
    out = np.zeros((1000, 5), np.float32)
    draw_triangle(vec(offset), *(vec(v) for v in vertices), random_numbers(1000), out)
    wi, t, _ = as_arrays(out)
    a, b, c = vertices - offset
    points = wi * t[:, None]
    n = np.cross(b - a, c - a)
    assert np.abs((points - a) @ n / np.linalg.norm(n)).max() < 1e-5
    w = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), (points - a).T, rcond=None)[0]
    assert w.min() > -1e-5
    assert w.sum(axis=0).max() < 1 + 1e-5


@pytest.mark.parametrize(
    "vertices",
    [
        [(0, 0, 0), (1, 0, 0), (0, 1, 0)],  # p is a vertex
        [(-1, -1, 0), (1, -1, 0), (0, 1, 0)],  # p within
        [(1, 0, 0), (2, 0, 0), (1, 1, 0)],  # p in the plane
        [(1, 1, 1), (1, 1, 1), (1, 1, 1)],  # no area
        [(0, 0, 1), (0, 1, 1), (0, 2, 1)],
    ],
)
def test_degenerate_triangles_have_no_density(vertices):
    corners = [vec(v) for v in vertices]
    _, _, pdf = call_sample_triangle(vec((0, 0, 0)), *corners, np.float32(0.3), np.float32(0.4))
    v0, v1, v2 = np.array(vertices, np.float32)
    ng = vec(np.cross(v1 - v0, v2 - v0))
    assert pdf == 0
    assert call_triangle_pdf(vec((0, 0, 0)), *corners, ng, vec((0, 0, 1)), np.float32(1)) == 0


# Corner, edge, edge; seen from the origin.
RECTANGLES = {
    "medium": [(-0.3, -1, 1), (2, 0, 0), (0, 1.5, 0)],
    "behind": [(-0.3, -1, -1), (2, 0, 0), (0, 1.5, 0)],
    "tilted": [(1, 1, 1), (1, -1, 0), (0.5, 0.5, 1)],
    "far": [(2, 1, 9), (0.5, 0, 0), (0, 0.2, 0)],
    "nearly the hemisphere": [(-1, -1, 0.01), (2, 0, 0), (0, 2, 0)],
    "very nearly the hemisphere": [(-1, -1, 1e-4), (2, 0, 0), (0, 2, 0)],
    "plane passes close by": [(1, -1, 1e-3), (1, 0, 0), (0, 2, 0)],
    "plane passes close by, other axis": [(-1, 1, 1e-3), (2, 0, 0), (0, 1, 0)],
    "strip": [(-1, 0.2, 1), (2, 0, 0), (0, 1e-3, 0)],
    "strip, other axis": [(0.2, -1, 1), (1e-3, 0, 0), (0, 2, 0)],
    "tiny": [(-1e-4, -1e-4, 2e-4), (2e-4, 0, 0), (0, 2e-4, 0)],
    "sheared": [(-0.3, -1, 1), (2, 0, 0), (0.5, 1.5, 0)],
}


def rectangle_cells(rectangle: np.ndarray, cells: int) -> np.ndarray:
    corner, u, v = rectangle
    i, j = np.unravel_index(np.arange(cells * cells), (cells, cells))

    def at(x, y):
        return corner + (x[:, None] * u + y[:, None] * v) / cells

    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    zero = np.zeros(3)
    return triangle_solid_angles(zero, a, b, c) + triangle_solid_angles(zero, a, c, d)


@pytest.mark.parametrize("name", RECTANGLES)
def test_rectangle_samples_are_uniform_in_solid_angle(name):
    rectangle = np.array(RECTANGLES[name], np.float32).astype(np.float64)
    corners = [vec(v) for v in rectangle]
    p = vec((0, 0, 0))
    out = np.zeros((COUNT, 5), np.float32)
    draw_rectangle(p, *corners, random_numbers(COUNT, 3), out)
    wi, t, pdf = as_arrays(out)
    assert_fills_rectangle(rectangle, wi, t, pdf)
    again = [call_rectangle_pdf(p, *corners, vec(wi[i]), np.float32(t[i])) for i in range(0, len(wi), 997)]
    assert np.allclose(again, pdf[::997], rtol=1e-5)


@pytest.mark.parametrize("name", ["medium", "tilted", "tiny"])
def test_a_rectangle_that_is_filled_evenly_in_its_plane_is_caught(name):
    rectangle = np.array(RECTANGLES[name], np.float64)
    with pytest.raises(AssertionError, match="chi-squared"):
        assert_fills_rectangle(rectangle, *drawn_by_area(*rectangle, triangle=False))


def assert_fills_rectangle(rectangle: np.ndarray, wi: np.ndarray, t: np.ndarray, pdf: np.ndarray) -> None:
    count, (corner, u, v) = len(wi), rectangle
    omega = rectangle_cells(rectangle, CELLS)
    assert np.mean(1 / pdf) == pytest.approx(omega.sum(), rel=1e-2)
    w = np.linalg.lstsq(np.stack([u, v], axis=1), (wi * t[:, None] - corner).T, rcond=None)[0]
    assert w.min() > -1e-3 and w.max() < 1 + 1e-3
    i, j = np.clip((w * CELLS).astype(int), 0, CELLS - 1)
    uniform = np.ptp(pdf) <= 1e-5 * pdf.max()
    expected = omega / omega.sum() if uniform else np.full(CELLS**2, CELLS**-2.0)
    assert_frequencies(np.bincount(i * CELLS + j, minlength=CELLS**2), expected * count, len(RECTANGLES))


@pytest.mark.parametrize("name", [n for n in RECTANGLES if n != "sheared"])
def test_rectangle_density_weighs_directions_as_lambert(name):
    rectangle = np.array(RECTANGLES[name], np.float32).astype(np.float64)
    out = np.zeros((64 * 64, 5), np.float32)
    draw_rectangle(vec((0, 0, 0)), *(vec(v) for v in rectangle), stratified(64), out)
    wi, _, pdf = as_arrays(out)
    corner, u, v = rectangle
    exact = mean_direction_of_polygon(np.zeros(3), np.array([corner, corner + u, corner + u + v, corner + v]))
    assert np.allclose(np.mean(wi / pdf[:, None], axis=0), exact, atol=1e-3 * np.mean(1 / pdf))


def test_rectangles_without_area_or_height_have_no_density():
    p = vec((0, 0, 0))
    for rectangle in ([(1, 1, 0), (1, 0, 0), (0, 1, 0)], [(1, 1, 1), (0, 0, 0), (0, 1, 0)]):
        corners = [vec(v) for v in rectangle]
        assert call_sample_rectangle(p, *corners, np.float32(0.3), np.float32(0.4))[2] == 0
        assert call_rectangle_pdf(p, *corners, vec((0, 0, 1)), np.float32(1)) == 0


SPHERES = {  # center, radius
    "medium": ((1, 2, 3), 2.0),
    "touching": ((0, 0, 1), 1 - 1e-4),
    "far": ((3000, -1000, 2000), 1.0),
    "tiny": ((0.3, 0.1, -1), 1e-4),
    "inside": ((0.2, 0.1, 0.3), 1.0),
}


@pytest.mark.parametrize("name", SPHERES)
def test_sphere_is_sampled_as_its_density_says(name):
    assert_fills_sphere(name, *SPHERES[name])


@pytest.mark.parametrize("name", ["medium", "far", "inside"])
def test_draws_of_another_sphere_are_caught(name):
    """Of half a per cent more radius, or one beside it."""
    center, radius = SPHERES[name]
    for wrong in ((center, radius * 1.005), (np.array(center) + (0, radius * 0.02, 0), radius)):
        with pytest.raises(AssertionError):
            assert_fills_sphere(name, *wrong)


def assert_fills_sphere(name: str, told_center, told_radius: float) -> None:
    """The sphere of this name is drawn, another one is told."""
    n = vec((0.6, 0, 0.8))
    count = COUNT
    out = np.zeros((count, 5), np.float32)
    drawn_center, drawn_radius = SPHERES[name]
    draw_sphere(vec((0, 0, 0)), n, vec(drawn_center), np.float32(drawn_radius), random_numbers(count, 5), out)
    wi, t, pdf = as_arrays(out)
    center, radius = told_center, told_radius
    center64 = np.array(center, np.float32).astype(np.float64)
    d = np.linalg.norm(center64)
    assert np.allclose(np.linalg.norm(wi, axis=1), 1, atol=1e-6)
    off = np.linalg.norm(wi * t[:, None] - center64, axis=1) - radius
    assert np.abs(off).max() < 3e-7 * d + 1e-3 * radius
    again = [call_sphere_pdf(vec((0, 0, 0)), n, vec(center), np.float32(radius), vec(w)) for w in wi[::997]]
    assert np.allclose(again, pdf[::997], rtol=1e-4, atol=1e-5)
    axis = center64 / d if d > radius else np.array(n, np.float64)
    x = np.cross([0, 1, 0], axis)
    x /= np.linalg.norm(x)
    phi = np.arctan2(wi @ np.cross(axis, x), wi @ x) / (2 * np.pi) + 0.5
    if d > radius:
        cap = 1 - np.sqrt(1 - (radius / d) ** 2)
        assert np.allclose(pdf, 1 / (2 * np.pi * cap), rtol=1e-3)
        # 1 - cos through the chord, which does not cancel
        share = 0.5 * np.sum((wi - axis) ** 2, axis=1) / cap
        expected = np.full((8, 8), 1 / 64)
    else:
        share = np.sum(wi * axis, axis=1) ** 2
        assert np.all(wi @ axis > -1e-6)
        expected = np.full((8, 8), 1 / 64)
    i, j = (np.clip((a * 8).astype(int), 0, 7) for a in (share, phi))
    if name != "tiny":  # there the rounding of directions moves points by 1e-3 of the cone: other tests see its mean
        assert_frequencies(np.bincount(i * 8 + j, minlength=64), expected * count, len(SPHERES))


def test_results_are_float32():
    p, half = vec((0, 0, 0)), np.float32(0.5)
    for corners, sample, pdf in (
        (TRIANGLES["medium"], sample_triangle, call_triangle_pdf),
        (RECTANGLES["medium"], sample_rectangle, call_rectangle_pdf),
    ):
        vectors = [vec(v) for v in corners]
        assert_float32(from_python(sample), p, *vectors, half, half)
        if pdf is call_triangle_pdf:
            vectors.append(vec((0, 0, 1)))
        assert_float32(pdf, p, *vectors, vec((0, 0, 1)), half)
    assert_float32(from_python(sample_sphere), p, vec((0, 0, 1)), vec((1, 1, 1)), half, half, half)
    assert_float32(from_python(sphere_pdf), p, vec((0, 0, 1)), vec((1, 1, 1)), half, vec((0, 0, 1)))
    assert_float32(from_python(atan2_upper), half, half)


def test_arc_tangent():
    y = np.abs(np.random.default_rng(1).normal(size=2000)).astype(np.float32)
    x = np.random.default_rng(2).normal(size=2000).astype(np.float32)
    got = [call_atan2_upper(a, b) for a, b in zip(y, x, strict=True)]
    assert np.allclose(got, np.arctan2(y.astype(float), x), rtol=4e-7)
    zero, one = np.float32(0), np.float32(1)
    assert call_atan2_upper(zero, one) == 0
    assert call_atan2_upper(zero, -one) == np.float32(np.pi)
    assert call_atan2_upper(one, zero) == np.float32(np.pi / 2)
    assert call_atan2_upper(zero, zero) == 0
