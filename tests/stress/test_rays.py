"""Rays that leave a surface: none meets it again, none slips out of a closed mesh, wherever in the world it lies.

pbrt's reintersection test and Embree's watertightness test, on the kernels' own functions.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scenes

from engine.accel import Accel
from engine.features import Features
from engine.kernels.embree import INST_PRIM_ID, PRIM_ID, U, V, intersect, new_ray
from engine.kernels.geom.frame import to_world
from engine.kernels.geom.surface import _interpolate, find_surface, hit_of, offset_origin
from engine.kernels.geom.vec import FAR, ZERO, direction_and_length, negate, normalize, scale
from engine.kernels.jit import kernel
from engine.kernels.light.emitters import triangle_vertices
from engine.kernels.sampler.warp import cosine_hemisphere
from engine.pack.geometry import pack_geometry
from engine.pack.middle import to_the_middle
from engine.scene import Mesh, Scene

ALL = np.uint32(15)
HUGE = np.float32(1e12)  # brings the shortest steps to where they can be squared
MISSED, AGAIN, ESCAPED = 0, 1, 2  # counters: first rays, second rays that met the same triangle, or nothing
RAYS = 100_000


@cache
def leave_kernel(instances: int, step: float, off_edges: bool):
    """Rays to a surface, and from there on in cosine-distributed directions to both of its sides.

    step       factor of the step off the surface: 1, or 0 for a renderer that doesn't step
    off_edges  False: points stay on the edges that they were met on, for surfaces that aren't instanced
    """
    features = Features(instances=instances)
    length = np.float32(step)

    @kernel
    def leave(geometry, ray, words, origins, directions, u, side, counts):
        for i in range(len(origins)):
            origin = origins[i, 0], origins[i, 1], origins[i, 2]
            wi = normalize((directions[i, 0], directions[i, 1], directions[i, 2]))
            if not intersect(geometry.accel[0], ray, words, origin, wi, ZERO, FAR, ALL):
                counts[MISSED] += 1
                continue
            prim, instance = words[PRIM_ID], words[INST_PRIM_ID]
            _, _, ng, _, _, p = find_surface(
                features, geometry, hit_of(features, geometry, ray, words), scale(negate(wi), side)
            )
            if not off_edges:
                a, b, c = triangle_vertices(geometry, np.int64(prim))
                p = _interpolate(a, b, c, ray[U], ray[V])
            axis, _ = direction_and_length(scale(ng, HUGE))
            out = to_world(cosine_hemisphere(u[i, 0], u[i, 1]), axis)
            met = intersect(geometry.accel[0], ray, words, offset_origin(p, scale(ng, length)), out, ZERO, FAR, ALL)
            if not met:
                counts[ESCAPED] += 1
            elif words[PRIM_ID] == prim and words[INST_PRIM_ID] == instance:
                counts[AGAIN] += 1

    return leave


def leave(
    scene: Scene, origins, directions, side: int = 1, step: float = 1.0, seed: int = 1, off_edges: bool = True
) -> np.ndarray:
    """(3,) counts; side: 1 reflects, -1 passes through."""
    packed = pack_geometry(scene)
    accel = Accel(packed.shapes)
    tables = packed.tables._replace(accel=np.array([accel.address], np.uint64))
    ray, counts = new_ray(), np.zeros(3, np.int64)
    u = np.random.default_rng(seed).random((len(origins), 2), np.float32)
    leave_kernel(packed.features["instances"], step, off_edges)(
        tables, ray, ray.view(np.uint32), origins.astype(np.float32), directions.astype(np.float32), u,
        np.float32(side), counts,
    )  # fmt: skip
    return counts


def from_the_middle(centre, count: int = RAYS) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(7)
    return np.broadcast_to(np.asarray(centre, float), (count, 3)), random.normal(size=(count, 3))


def closed(mesh: Mesh, centre) -> Scene:
    scene = Scene()
    scene.add_instance(mesh, np.column_stack([np.eye(3), centre]))
    return scene


CENTRES = {"0": (0, 0, 0), "1e3": (600, -700, 390), "1e4": (6e3, -7e3, 3.9e3), "1e5": (148376, 1234, -223423)}
MESHES = {"sphere": scenes.sphere_mesh(64, radius=2), "cube": scenes.cube_mesh(2)}
ALLOWED = {"0": 0, "1e3": 0, "1e4": 0, "1e5": int(2e-5 * RAYS)}  # Embree's own test allows 2e-5 out there


@pytest.mark.parametrize("centre", CENTRES)
def test_a_closed_mesh_holds_its_rays(centre):
    """From the middle of a mesh to its wall, and from there back inside: none is lost, none meets its own triangle.
    A sphere of radius 2 at (148376, 1234, -223423) is Embree's watertightness test."""
    rays = from_the_middle(CENTRES[centre])
    missed, again, escaped = leave(closed(MESHES["sphere"], CENTRES[centre]), *rays)
    assert missed + again + escaped <= ALLOWED[centre], (missed, again, escaped)


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("centre", CENTRES)
def test_as_the_engine_packs_it_none_is_lost(mesh, centre):
    """Where the scene is moved to the origin first: at 1e5 a point on one wall of the cube may be rounded past
    the next."""
    scene = closed(MESHES[mesh], CENTRES[centre])
    scene.camera = scenes.camera(CENTRES[centre])
    scene = to_the_middle(scene)
    assert scene.camera is not None
    assert leave(scene, *from_the_middle(scene.camera.transform[:, 3])).tolist() == [0, 0, 0]


@pytest.mark.parametrize("centre", CENTRES)
def test_rays_that_pass_a_surface_leave_it_behind(centre):
    """On the outside of the convex mesh nothing is left to meet."""
    _, again, escaped = leave(closed(MESHES["cube"], CENTRES[centre]), *from_the_middle(CENTRES[centre]), side=-1)
    assert again == 0 and escaped == RAYS


def test_no_step_and_a_long_step_are_caught():
    """A renderer that starts rays on the surface, and one that steps as far as 256 ulps of the point."""
    rays = from_the_middle(CENTRES["1e4"])
    assert leave(closed(MESHES["cube"], CENTRES["1e4"]), *rays, step=0.0)[AGAIN] > RAYS / 10
    rays = from_the_middle(CENTRES["1e5"])
    assert leave(closed(MESHES["sphere"], CENTRES["1e5"]), *rays, step=32.0)[ESCAPED] > RAYS / 10


# --- rays that aim ---------------------------------------------------------------------------------------------------

AIMS = {"random": 500_000, "edges": 70_000, "vertices": 70_000, "diagonals": 70_000}  # and how many rays of each
PACKINGS = ("as it is", "by the engine", "two bodies")  # of which the engine makes two at 1e4 from the origin
TURN = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
TURNED = replace(MESHES["cube"], vertices=(MESHES["cube"].vertices @ TURN).astype(np.float32))
BODIES = {**MESHES, "turned cube": TURNED}
EMBREES_OWN = 2e-5
# A body that stands at 1e5 as it is has triangles so coarse that a point beside an edge may lie past the next wall,
# where walls meet at right angles.
PAST_THE_NEXT_WALL, AIMED_AT_1E5 = 2e-4, 1e-2
# Of rays that aim at a vertex exactly Embree lets so many slip through between its five or six triangles on a sphere.
THROUGH_A_VERTEX = 1e-2


def aimed(scene: Scene, mesh: Mesh, aim: str, origins: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Directions (n, 3) from `origins` to the scene's first body, as it is packed: anywhere, to its edges, its
    vertices, the longest edges of its triangles (in which the halves of a quad meet)."""
    count = len(origins)
    if aim == "random":
        return random.normal(size=(count, 3))
    tables = pack_geometry(scene).tables
    chosen = random.integers(len(mesh.triangles), size=count)
    corners = tables.vertices.astype(float)[tables.triangles[chosen]]
    lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    side = lengths.argmax(axis=1) if aim == "diagonals" else random.integers(3, size=count)
    ends = corners[np.arange(count), side], corners[np.arange(count), (side + 1) % 3]
    along = np.zeros((count, 1)) if aim == "vertices" else random.random((count, 1))
    return ends[0] * (1 - along) + ends[1] * along - origins


def placed(mesh: Mesh, offset: str, packing: str) -> tuple[Scene, np.ndarray]:
    """The scene, and where in it the middle of the mesh lies."""
    centre = np.array(CENTRES[offset], float)
    scene = closed(mesh, centre)
    if packing == "as it is":
        return scene, centre
    if packing == "two bodies":
        scene.add_instance(mesh, np.column_stack([np.eye(3), centre - 2 * np.array(CENTRES["1e4"])]))
    scene.camera = scenes.camera(tuple(centre))
    scene = to_the_middle(scene)
    assert scene.camera is not None
    return scene, scene.camera.transform[:, 3]


def leave_aimed(mesh: str, offset: str, packing: str, aim: str, count: int, **broken) -> list[int]:
    """The counts of so many rays that aim."""
    scene, middle = placed(BODIES[mesh], offset, packing)
    random = np.random.default_rng(11)
    origins = (middle + 0.3 * random.normal(size=(count, 3))).astype(np.float32).astype(float)
    return leave(scene, origins, aimed(scene, BODIES[mesh], aim, origins, random), seed=12, **broken).tolist()


def may_miss(mesh: str, offset: str, packing: str, aim: str) -> float:
    """The share of first rays that may meet nothing."""
    if mesh == "sphere" and aim == "vertices":
        return THROUGH_A_VERTEX
    return may_escape(mesh, offset, packing, aim)


def may_escape(mesh: str, offset: str, packing: str, aim: str) -> float:
    """The share of second rays that may."""
    if offset != "1e5" or packing != "as it is":
        return 0.0
    if aim != "random":
        return AIMED_AT_1E5
    return EMBREES_OWN if mesh == "sphere" else PAST_THE_NEXT_WALL


@pytest.mark.parametrize("aim", ["edges", "vertices"])
@pytest.mark.parametrize("offset", ["0", "1e4"])
@pytest.mark.parametrize("mesh", ["cube", "turned cube"])
def test_none_slips_out_between_two_walls(mesh, offset, aim):
    assert leave_aimed(mesh, offset, "as it is", aim, 10_000) == [0, 0, 0]


@pytest.mark.parametrize("mesh", ["cube", "turned cube"])
def test_points_on_edges_are_caught(mesh):
    """In a renderer that starts rays from the very edges that it met."""
    assert leave_aimed(mesh, "1e4", "as it is", "edges", 10_000, off_edges=False)[ESCAPED] > 100


@pytest.mark.long
@pytest.mark.parametrize("packing", PACKINGS)
@pytest.mark.parametrize("offset", CENTRES)
@pytest.mark.parametrize("mesh", BODIES)
def test_millions_of_rays(mesh, offset, packing, record):
    """Each is four rows of benchmarks/results/rays.md."""
    lost = {}
    for aim, count in AIMS.items():
        counts = leave_aimed(mesh, offset, packing, aim, count)
        missing, escaping = may_miss(mesh, offset, packing, aim), may_escape(mesh, offset, packing, aim)
        row = {"mesh": mesh, "offset": offset, "packed": packing, "rays": aim, "number": count}
        row |= dict(zip(("missed", "met again", "escaped"), counts, strict=True))
        row |= {"may miss": f"{missing:g}", "may escape": f"{escaping:g}"}
        record("rays", ("mesh", "offset", "packed", "rays"), row)
        if counts[AGAIN] or counts[MISSED] > missing * count or counts[ESCAPED] > escaping * count:
            lost[aim] = counts
    assert not lost


@pytest.mark.long
def test_lost_rays_are_counted(monkeypatch):
    """With a step of 256 ulps of the point, which brings rays out where a body lies far off."""
    usual = leave
    monkeypatch.setitem(globals(), "leave", lambda *given, **named: usual(*given, **named, step=32.0))
    with pytest.raises(AssertionError):
        test_millions_of_rays("sphere", "1e5", "as it is", lambda *_: None)


def random_triangle(random: np.random.Generator, kind: str) -> np.ndarray:
    """(3, 3) float32. Kinds: coordinates of one size; all sizes, as in pbrt's test; far from the origin; slivers
    with one short side (needle) or with a corner next to the middle of a side (cap), so many times as long as wide."""
    corners = random.normal(size=(3, 3))
    if kind == "any size":
        corners = np.sign(corners) * 10 ** random.uniform(-8, 8, (3, 3))
    elif kind == "far off":
        corners += random.normal(size=3) * 10 ** random.uniform(0, 6)
    elif kind.startswith(("needle", "cap")):
        shape, aspect = kind.split()
        beside = corners[1] if shape == "needle" else corners[:2].mean(axis=0)
        corners[2] = beside + random.normal(size=3) / float(aspect)
        corners = corners[random.permutation(3)]
    return corners.astype(np.float32)


def leave_triangles(kind: str, triangles: int, step: float = 1.0) -> int:
    """How many of 500 rays for each triangle and side meet it again."""
    random, again = np.random.default_rng(3), 0
    for k in range(triangles):
        corners = random_triangle(random, kind)
        points = random.dirichlet((1, 1, 1), 500) @ corners.astype(float)
        origins = points + random.normal(size=points.shape) * np.abs(corners).max()
        scene = Scene()
        scene.add_instance(Mesh("triangle", corners, np.array([[0, 1, 2]], np.uint32)))
        for side in (1, -1):
            again += int(leave(scene, origins, points - origins, side, step, seed=k)[AGAIN])
    return again


SLIVERS = [f"{shape} {aspect}" for shape in ("needle", "cap") for aspect in ("1e2", "1e3", "1e4")]


@pytest.mark.parametrize("kind", ["unit", "any size", "far off", *SLIVERS, "needle 1e5", "needle 1e7"])
def test_triangles_are_not_met_again(kind):
    """Caps of 1e5 and beyond would need steps that show, see `_LONGEST_FOR_OWN`."""
    assert leave_triangles(kind, 60) == 0


@pytest.mark.parametrize("kind", ["unit", "cap 1e4"])
def test_a_short_step_is_caught(kind):
    assert leave_triangles(kind, 20, step=1 / 64) > 0


def instance_matrix(random: np.random.Generator, kind: str) -> np.ndarray:
    """(3, 3)"""
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    if kind == "flat":
        return turn @ np.diag([1, 1, 10 ** random.uniform(-6, 0)])
    if kind == "sheared":
        return turn @ (np.eye(3) + 10 ** random.uniform(0, 1.5) * np.outer([1, 0, 0], [0, 1, 0.5]))
    if kind == "any":
        return turn @ np.diag(10 ** random.uniform(-4, 1, 3)) @ np.linalg.qr(random.normal(size=(3, 3)))[0]
    return turn @ np.diag([1, 1, -1])


@pytest.mark.parametrize("kind", ["mirrored", "flat", "sheared", "any"])
def test_instances_are_not_met_again(monkeypatch, kind):
    """Up to 1000 m from the origin. What is squeezed by too much is baked and passes, too."""
    monkeypatch.setattr("engine.pack.geometry.BAKE_LIMIT", 0)
    random, instanced = np.random.default_rng(5), 0
    for k in range(20):
        matrix, centre = instance_matrix(random, kind), random.normal(size=3) * 10 ** random.uniform(0, 3)
        scene = Scene()
        for place in (centre, centre + 1000):
            scene.add_instance(MESHES["sphere"], np.column_stack([matrix, place]))
        instanced += pack_geometry(scene).features["instances"]
        directions = random.normal(size=(2000, 3)) @ matrix.T
        origins = np.broadcast_to(centre, directions.shape)
        assert leave(scene, origins, directions, seed=k)[AGAIN] == 0
    assert instanced > 2
