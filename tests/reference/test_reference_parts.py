"""The parts of the reference road by themselves: what it is the oracle with must be sound."""

from __future__ import annotations

import numpy as np
import pytest
import scenes
from scipy import stats

from engine.reference import bsdf, render_reference
from engine.reference.camera import camera_rays
from engine.reference.geometry import Geometry
from engine.reference.lights import Area, Point, Sun, make_lamp, make_world
from engine.reference.vectors import around, dot, length, unit
from engine.scene import Aperture, Camera, Mesh, Scene, Visibility, World
from engine.settings import Settings

N = 100_000


def uniform_directions(rng, count=N):
    return unit(rng.normal(size=(count, 3)))


# BSDF


def lobes(kd, ks, exponent, wo, hemisphere="COSINE", selection="ALBEDO", normal=(0, 0, 1.0), flat=(0, 0, 1.0)):
    tile = [np.tile(np.asarray(v, float), (len(wo), 1)) for v in ((kd,) * 3, (ks,) * 3, normal, flat)]
    return bsdf.make_lobes(tile[0], tile[1], np.full(len(wo), float(exponent)), *tile[2:], wo, selection, hemisphere)


CASES = [
    # kd, ks, exponent, degrees of wo, tilt of the shading normal
    (0.5, 0.0, 0, 30, 0),
    (0.0, 0.8, 0, 60, 0),
    (0.3, 0.6, 5, 70, 0),
    (0.3, 0.6, 50, 10, 0),
    (0.3, 0.6, 300, 80, 0),
    (0.3, 0.6, 20, 40, 30),
    (0.3, 0.6, 20, 60, -50),  # wo is below the horizon of the shading normal: no Phong lobe
]


@pytest.mark.parametrize("case", CASES, ids=str)
@pytest.mark.parametrize(
    ("hemisphere", "selection"),
    [("COSINE", "ALBEDO"), ("UNIFORM", "ALBEDO"), ("REJECTION", "ALBEDO"), ("COSINE", "CLASSIC")],
)
def test_directions_have_the_density_that_evaluate_gives(case, hemisphere, selection):
    """Chi-squared over 16 x 8 cells of equal solid angle; the expected counts by quadrature of evaluate."""
    kd, ks, exponent, degrees, tilt = case
    rng = np.random.default_rng(5)
    angle, lean = np.radians(degrees), np.radians(tilt)
    wo = np.array([np.sin(angle), 0, np.cos(angle)])

    def at(count):
        there = np.tile(wo, (count, 1))
        return lobes(kd, ks, exponent, there, hemisphere, selection, (np.sin(lean), 0, np.cos(lean))), there

    fine = 32  # points per cell and axis
    z, phi = np.meshgrid(
        (np.arange(16 * fine) + 0.5) / (8 * fine) - 1, (np.arange(8 * fine) + 0.5) * 2 * np.pi / (8 * fine) - np.pi
    )
    grid = np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], -1).reshape(-1, 3)
    density = bsdf.evaluate(*at(len(grid)), grid)[2]

    def counts(d, weights=None):
        row = np.minimum(((d[:, 2] + 1) * 8).astype(int), 15)
        column = np.minimum(((np.arctan2(d[:, 1], d[:, 0]) / np.pi + 1) * 4).astype(int), 7)
        return np.bincount(row * 8 + column, weights, minlength=128)

    here, there = at(N)
    wi = bsdf.sample(here, there, rng)
    assert np.allclose(length(wi), 1)
    drawn = counts(wi[bsdf.evaluate(here, there, wi)[2] > 0])
    expected = counts(grid, density) * 4 * np.pi / len(grid) * N
    assert not drawn[expected == 0].any()
    big = expected > 5
    # Next to the statistics, 0.3 % for the quadrature of cells that a horizon cuts.
    chi2 = np.sum((drawn[big] - expected[big]) ** 2 / (expected[big] + (0.003 * expected[big]) ** 2))
    assert stats.chi2.sf(chi2, big.sum()) > 1e-4


def test_evaluate_is_reciprocal():
    rng = np.random.default_rng(1)
    up = np.abs(uniform_directions(rng, 1000)), np.abs(uniform_directions(rng, 1000))
    there = bsdf.evaluate(lobes(0.3, 0.5, 12, up[0]), *up)
    back = bsdf.evaluate(lobes(0.3, 0.5, 12, up[1]), *up[::-1])
    np.testing.assert_allclose(there[1], back[1], rtol=1e-9)


@pytest.mark.parametrize("exponent", [1e3, 1e6, 1e9])
def test_sharp_lobes_keep_their_digits(exponent):
    """In float32 the sine of a drawn angle would be off by 18 % at n = 1e6."""
    rng = np.random.default_rng(2)
    wo = np.tile([0.6, 0, 0.8], (N, 1))
    here = lobes(0, 1, exponent, wo)
    wi = bsdf.sample(here, wo, rng)
    off = wi - np.array([-0.6, 0, 0.8])
    mean = dot(off, off).mean()  # 2 (1 - cos), E[cos] = (n + 1) / (n + 2)
    assert mean == pytest.approx(2 / (exponent + 2), rel=0.02)
    ratio = bsdf.evaluate(here, wo, wi)
    np.testing.assert_allclose(ratio[1][:, 0] / ratio[2], (exponent + 2) / (exponent + 1), rtol=1e-6)


def test_nothing_below_the_geometric_surface():
    rng = np.random.default_rng(3)
    wi = uniform_directions(rng, 1000)
    wo = np.tile([0.0, 0, 1], (1000, 1))
    here = lobes(0.5, 0.5, 3, wo, normal=(0.8, 0, 0.6))
    f_diffuse, f_phong, pdf = bsdf.evaluate(here, wo, wi)
    below = (wi[:, 2] <= 0) | (wi @ np.array([0.8, 0, 0.6]) <= 0)
    assert not (f_diffuse[below].any() or f_phong[below].any() or pdf[below].any())
    assert np.all(pdf[~below] > 0)


def test_rejection_takes_12_over_pi_draws():
    directions, draws = bsdf.rejection_hemisphere(N, np.random.default_rng(4))
    assert np.all(directions[:, 2] > 0)
    assert draws / N == pytest.approx(12 / np.pi, rel=0.01)
    assert stats.kstest(directions[:, 2], "uniform").pvalue > 1e-3


# Emitters: a uniform look around must find what sampling finds, and as often


def emitter(kind: str):
    if kind == "constant":
        return make_world(World(color=(1, 2, 3)), 1.0)
    if kind == "image":
        turn = unit(np.array([[1.0, 0.2, 0], [-0.2, 1.0, 0], [0, 0, 1]]))
        return make_world(World(image=scenes.sky_image(), rotation=turn), 1.0)
    return make_lamp(scenes.lamp(kind), 1.0)


SIZED = [kind for kind in scenes.LAMP_KINDS if kind not in ("point", "spot", "sun")] + ["constant", "image"]


@pytest.mark.parametrize("kind", SIZED)
@pytest.mark.parametrize("place", [(0.1, 0.3, 0.0), (0.3, 0.25, 1.9)], ids=["far", "near or inside"])
def test_emitters_sample_what_is_met(kind, place):
    rng = np.random.default_rng(6)
    point, normal = np.tile(place, (N, 1)), np.tile([0.0, 0.6, 0.8], (N, 1))
    it = emitter(kind)
    wi, _, radiance, pdf = it.sample(point, normal, rng)
    lost = (radiance.sum(axis=1) == 0) & (pdf == 0)
    assert lost.mean() < 1e-3 or kind in ("area", "ellipse", "spread"), "drawn directions miss the emitter"

    def moments(radiance, pdf, wi):
        """Irradiance with and without a tint by direction; two numbers that a wrong density moves."""
        cosine = np.maximum(dot(normal, wi), 0)
        value = np.where(pdf > 0, radiance[:, 0] * cosine / np.where(pdf > 0, pdf, 1), 0)
        both = np.column_stack([value, value * wi[:, 0]])
        return both.mean(axis=0), both.std(axis=0) / np.sqrt(len(value))

    sampled = moments(radiance, pdf, wi)
    # Look around within a cone towards the emitter if it is small, so that enough rays meet it.
    around_it = np.array([0.0, 0.6, 0.8])
    if isinstance(it, Sun):
        around_it, spread = it.towards, 0.1
    elif isinstance(it, Point | Area) and length(it.position - place) > 1:
        around_it, spread = unit(it.position - np.array(place)), 0.5
    else:
        spread = 2.0
    w = rng.random(N) * spread
    phi = 2 * np.pi * rng.random(N)
    local = np.column_stack([np.sqrt(w * (2 - w)) * np.cos(phi), np.sqrt(w * (2 - w)) * np.sin(phi), 1 - w])
    wi = around(around_it, local)
    _, radiance, density = it.meet(point, normal, wi)
    looked = moments(radiance, np.full(N, 1 / (2 * np.pi * spread)), wi)
    assert np.all(np.abs(sampled[0] - looked[0]) < 4.5 * np.hypot(sampled[1], looked[1]) + 1e-9)
    seen = radiance.sum(axis=1) > 0
    below = dot(normal, wi) <= 0
    assert np.all(density[seen & ~below] > 0), "light that sampling can never find"


# Geometry


def rays_from_surface(scene: Scene, rng, count=20_000):
    geometry = Geometry(scene)
    triangle = rng.integers(len(geometry), size=count)
    uv = rng.random((count, 2))
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1, 1 - uv, uv)
    wi = uniform_directions(rng, count)
    surface = geometry.surface(triangle, uv, wi)
    start = surface.point + surface.flat * surface.offset[:, None]
    return geometry, surface, start, wi


@pytest.mark.parametrize("centre", [(0, 0, 0), (100, -50, 3), (148376, 1234, -223423)])
@pytest.mark.parametrize("mesh", [scenes.sphere_mesh(24, 2.0), scenes.cube_mesh(2.0)], ids=["sphere", "cube"])
def test_rays_that_leave_a_convex_body_never_meet_it_again(mesh, centre):
    scene = Scene(camera=scenes.camera())
    scene.add_instance(mesh, np.column_stack([np.eye(3), centre]))
    rng = np.random.default_rng(8)
    geometry, surface, start, wi = rays_from_surface(scene, rng)
    outwards = dot(surface.point - np.array(centre), surface.flat) > 0
    hit, _ = geometry.intersect(Visibility.CAMERA, start, wi, np.full(len(wi), np.inf))
    far_off = np.abs(centre).max() > 1e5  # there float32 steps are 0.016 m: the mesh itself is not convex any more
    assert np.count_nonzero(hit[outwards] >= 0) <= (0.02 * outwards.sum() if far_off else 0)


@pytest.mark.parametrize("centre", [(0, 0, 0), (148376, 1234, -223423)])
def test_closed_meshes_are_watertight(centre):
    """Embree's own test: from inside a sphere, at most 2e-5 of the rays escape."""
    scene = Scene(camera=scenes.camera())
    scene.add_instance(scenes.sphere_mesh(64, 2.0), np.column_stack([np.eye(3), centre]))
    rng = np.random.default_rng(9)
    wi = uniform_directions(rng)
    origin = np.tile(np.array(centre, float), (N, 1))
    hit, _ = Geometry(scene).intersect(Visibility.CAMERA, origin, wi, np.full(N, np.inf))
    assert np.count_nonzero(hit < 0) <= 2e-5 * N


def test_normals_of_stretched_and_mirrored_instances():
    """On an ellipsoid the normal is the gradient of its equation; mirrored, it still points outwards."""
    for scale in [(1, 2, 3), (-1, 2, 3), (-1, -2, -3)]:
        scene = Scene(camera=scenes.camera())
        scene.add_instance(scenes.sphere_mesh(48, smooth=True), np.column_stack([np.diag(scale), (5, 6, 7)]))
        geometry, surface, _, _ = rays_from_surface(scene, np.random.default_rng(1), 1000)
        at = geometry.surface(surface.triangle, np.full((1000, 2), 1 / 3), surface.flat)
        outwards = unit((at.point - np.array([5, 6, 7])) / np.square(scale))
        side = np.sign(dot(at.flat, outwards))
        assert np.all(dot(at.normal * side[:, None], outwards) > 0.999)
        assert np.all(dot(geometry.flat, unit(geometry.corners.mean(axis=1) - np.array([5, 6, 7]))) > 0)


def test_material_slots_are_clamped_to_the_object():
    mesh = scenes.cube_mesh()
    mesh = Mesh("cube", mesh.vertices, mesh.triangles, material_slots=np.arange(12, dtype=np.int32))
    scene = Scene(camera=scenes.camera())
    scene.materials = scene.materials * 3
    scene.add_instance(mesh, materials=(2, 0))
    scene.add_instance(mesh, materials=(1,))
    np.testing.assert_array_equal(Geometry(scene).material, [2] + [0] * 11 + [1] * 12)


# Camera


@pytest.mark.parametrize(("blades", "area"), [(0, np.pi), (6, 6 * np.sin(np.pi / 3) / 2), (3, 3 * np.sqrt(3) / 4)])
def test_lens_rays_meet_in_the_focus(blades, area):
    rng = np.random.default_rng(2)
    camera = Camera(
        transform=scenes.place((1, 2, 3), (0, 1, 0)),
        aperture=Aperture(radius=0.2, focus_distance=4.0, blades=blades, ratio=2.0),
    )
    origin, direction, near, far = camera_rays(camera, np.full((5000, 2), (3.0, 6.0)), (8, 8), rng)
    focus = origin + direction * (4.0 / direction[:, 1])[:, None]
    np.testing.assert_allclose(focus, np.broadcast_to(focus[0], focus.shape), atol=1e-9)
    np.testing.assert_allclose(focus[0], (1 - 0.5, 2 + 4, 3 + 1.0), atol=1e-9)
    np.testing.assert_allclose(direction[:, 1] * near, 0.1)
    np.testing.assert_allclose(direction[:, 1] * far, 1000)
    lens = (origin - (1, 2, 3))[:, [0, 2]] / 0.2
    lens[:, 0] *= 2
    assert np.all(length(lens) <= 1 + 1e-9)
    if blades == 3:  # the middle of a side lies at the angle 0
        assert lens[:, 0].max() == pytest.approx(0.5, abs=0.01)
        assert lens[:, 0].min() < -0.9
    inner = np.mean(length(lens) < 0.4)  # a uniform density over the polygon's area
    assert inner == pytest.approx(np.pi * 0.16 / area, abs=0.03)


# The road itself


def test_stopping_keeps_what_was_done():
    asked = []

    def stop():
        asked.append(1)
        return len(asked) > 40

    result = render_reference(scenes.cornell(32), Settings(samples=10_000), stop=stop)
    assert result.stopped
    assert 0 < result.samples < 10_000
    assert result.pixels.max() > 0


def test_stopping_at_once_gives_black():
    result = render_reference(scenes.cornell(8), Settings(), stop=lambda: True)
    assert result.stopped
    assert not result.pixels.any()


def test_progress_shows_the_picture():
    seen = []
    render_reference(scenes.cornell(16), Settings(samples=64), progress=lambda p: seen.append((p.fraction, p.pixels())))
    assert seen[0][1] is None
    assert seen[-1][0] == 1
    assert seen[-1][1].shape == (16, 16, 4)
    assert [fraction for fraction, _ in seen] == sorted(fraction for fraction, _ in seen)


def test_time_limit():
    result = render_reference(scenes.cornell(8), Settings(samples=1 << 20, time_limit=0.2))
    assert not result.stopped
    assert 1 <= result.samples < 1 << 20
