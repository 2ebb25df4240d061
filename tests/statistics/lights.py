"""Cases of lights, one at a time: lamps of either road, suns, emissive surfaces, images.

Whether and where a ray meets a shape is plain float64 geometry, or that of the reference road.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from engine import Scene, Settings
from engine.features import IMAGE_WORLD, LISTED_LAMPS, ONE_EMITTER, Features
from engine.kernels.jit import kernel
from engine.kernels.light.emitters import lamp_seen, sample_light, sun_seen_pdf, surface_seen_pdf, world_seen
from engine.kernels.light.groups import group_shares
from engine.kernels.registry import Sampler
from engine.kernels.tables import DIFFUSE_RAY
from engine.pack import pack
from engine.reference.lights import make_lamp, make_world
from engine.scene import Camera, Material, Mesh, PointLight, World
from tests.statistics import chi2
from tests.statistics.drawn import TILTED, UP, Drawn

ALL_LAMPS = Features(lamp_kinds=63, lamp_shapes=LISTED_LAMPS, emitter_choice=ONE_EMITTER)
EMITTERS = Features(mesh_emitters=1, rectangle_emitters=1, emitter_choice=ONE_EMITTER)
SUNS = Features(suns=1, sun_disks=1)
IMAGES = Features(world=IMAGE_WORLD)


@functools.cache
def light_kernels(f: Features) -> tuple[Callable, Callable]:
    """(draw, tell): u (n, 3) -> rows (wi, t, radiance, pdf); directions and distances -> rows (radiance, pdf)."""

    @kernel
    def draw(geometry, lights, environment, tree, p, n, u, out):
        for i in range(len(u)):
            s = sample_light(f, geometry, lights, environment, tree, p, n, np.int32(-1), u[i, 0], u[i, 1], u[i, 2])
            out[i, 0], out[i, 1], out[i, 2] = s.wi
            out[i, 3], out[i, 7] = s.t, s.pdf
            out[i, 4], out[i, 5], out[i, 6] = s.radiance

    @kernel
    def tell(geometry, lights, environment, tree, p, n, wi, t, out):
        shares = group_shares(f, lights, tree, p, n)
        for i in range(len(wi)):
            d = (wi[i, 0], wi[i, 1], wi[i, 2])
            if f.lamp_kinds:
                (out[i, 0], out[i, 1], out[i, 2]), out[i, 3] = lamp_seen(f, lights, 0, p, n, d, t[i])
            elif f.mesh_emitters:
                out[i, 3] = surface_seen_pdf(f, geometry, lights, 0, p, d, t[i])
                out[i, 0] = out[i, 1] = out[i, 2] = out[i, 3]
            elif f.suns:
                (out[i, 0], out[i, 1], out[i, 2]), out[i, 3] = sun_seen_pdf(f, lights, shares, 0, n, d, DIFFUSE_RAY)
            else:
                seen, pdf = world_seen(f, lights, shares, environment, d, DIFFUSE_RAY)
                (out[i, 0], out[i, 1], out[i, 2]), out[i, 3] = seen, pdf

    return draw, tell


class Light(Drawn):
    """A single light of a scene, seen from p by a surface with the normal n. `hit`: directions (n, 3) -> distances
    (n,), 0 where rays miss it."""

    def __init__(self, name: str, f: Features, scene: Scene, p, n, hit: Callable[[np.ndarray], np.ndarray]) -> None:
        scene.camera, scene.width, scene.height = Camera(), 8, 8
        scene.validate()
        self.name, self.scene, self.hit, self.kernels = name, scene, hit, light_kernels(f)
        self.p, self.n = np.asarray(p, np.float32).astype(float), np.asarray(n, float)
        packed = self.packed = pack(scene, Settings())
        tables = packed.geometry, packed.lights, packed.environment, packed.tree
        self.arguments = (*tables, chi2.vec(self.p), chi2.vec(n))

    def sample(self, u: np.ndarray) -> np.ndarray:
        """(n, 8): wi, t, radiance, pdf"""
        out = np.zeros((len(u), 8), np.float32)
        self.kernels[0](*self.arguments, u, out)
        return out.astype(float)

    def seen(self, wi: np.ndarray) -> np.ndarray:
        """(n, 4): radiance (of lamps, suns and worlds), pdf; zeros where rays miss."""
        t, out = self.hit(wi), np.zeros((len(wi), 4), np.float32)
        self.kernels[1](*self.arguments, np.asarray(wi, np.float32), np.asarray(t, np.float32), out)
        return np.where(t[:, None] > 0, out, 0).astype(float)

    def draw(self, count: int, seed: int):
        out = self.sample(chi2.uniforms(count, 3, seed))
        return out[:, :3], (out[:, 7] > 0) & (out[:, 4:7] > 0).any(axis=1)

    def density(self, points: np.ndarray) -> np.ndarray:
        """Where nothing shines, the density does not count: what is drawn there has failed."""
        seen = self.seen(points)
        return np.where((seen[:, :3] > 0).any(axis=1), seen[:, 3], 0)


# Scaled, sheared and mirrored, a little aside.
SHEARED = np.array([(1.3, 0.4, 0.1, 0.1), (0.2, -0.7, 0.3, -0.2), (0.1, 0.2, 0.9, 0.05)])


def cone(lamp) -> float:
    """Half the angle that a lamp shines into, about its -z."""
    return getattr(lamp, "half_angle", getattr(lamp, "spread", np.pi) / 2)


def positions(size: float, reach: float = np.pi / 2) -> dict[str, tuple]:
    """Where a light of this half size about the origin, that shines along -z, is looked at from: (p, n). `reach`: half
    the angle that it shines into."""
    grazing, height = (2.5 * size, 0.4 * size, -0.05 * size), 0.1 * size
    if reach < 1.5:  # right inside its cone, and not so close that it shows but a small part of itself
        off, height = 0.93 * reach, 0.6 * size
        grazing = tuple(2.5 * size * np.array([np.sin(off), 0.16 * np.sin(off), -np.cos(off)]))
    return {
        "near": ((0.2 * size, -0.3 * size, -1.5 * size), (0.0, 0.6, 0.8)),
        "far": ((40 * size, -30 * size, -200 * size), UP),
        "grazing": (grazing, (-0.8, 0.0, 0.6)),
        "close": ((0.1 * size, 0.1 * size, -1.02 * size), UP),
        "inside": ((0.3 * size, -0.2 * size, -height), (0.6, 0.0, 0.8)),
        "behind": ((0.1 * size, 0.2 * size, 1.7 * size), -UP),
    }


def lamps(entry: Sampler) -> Iterator[chi2.Case]:
    lamp = entry.example
    emitter = make_lamp(lamp, 1.0)
    size = lamp.radius if isinstance(lamp, PointLight) else lamp.size_x / 2
    for where, (p, n) in positions(size, cone(lamp)).items():
        yield lamp_case(f"{entry.name} lamp, {where}", lamp, emitter, p, n)
        yield ReferenceLight(f"{entry.name} lamp, {where}, reference", emitter, p, n)
    bent = replace(lamp, transform=SHEARED)
    yield lamp_case(f"{entry.name} lamp, sheared", bent, make_lamp(bent, 1.0), (0.4 * size, 0.1, -1.4 * size), UP)


class ReferenceLight(Drawn):
    """A lamp of the reference road, by itself."""

    def __init__(self, name: str, emitter, p, n) -> None:
        self.name, self.emitter = name, emitter
        self.p, self.n = np.asarray(p, np.float32).astype(float), np.asarray(n, float)

    def _at(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        return np.tile(self.p, (count, 1)), np.tile(self.n, (count, 1))

    def draw(self, count: int, seed: int):
        wi, _, radiance, pdf = self.emitter.sample(*self._at(count), np.random.default_rng(seed))
        return wi, (pdf > 0) & (radiance > 0).any(axis=1)

    def density(self, points: np.ndarray) -> np.ndarray:
        _, radiance, density = self.emitter.meet(*self._at(len(points)), points)
        return np.where((radiance > 0).any(axis=1), density, 0)


def lamp_case(name: str, lamp, emitter, p, n) -> Light:
    place, normal = np.asarray(p, np.float32).astype(float), np.asarray(n, float)

    def hit(wi):
        points = np.broadcast_to(place, wi.shape)
        distance, _, density = emitter.meet(points, np.broadcast_to(normal, wi.shape), wi)
        # From within a sphere, directions below the horizon are met and have no density.
        return np.where((density > 0) & (distance > 0), distance, 0)

    return Light(name, ALL_LAMPS, Scene(lights=[lamp]), p, n, hit)


def everywhere(wi: np.ndarray) -> np.ndarray:
    return np.full(len(wi), np.inf)


def suns(entry: Sampler) -> Iterator[chi2.Case]:
    for n in (UP, (0.8, 0.0, 0.6)):
        yield Light(f"{entry.name} over {n[0]}", SUNS, Scene(lights=[entry.example]), (0, 0, 0), n, everywhere)
    yield ReferenceLight(f"{entry.name}, reference", make_lamp(entry.example, 1.0), (0, 0, 0), UP)


def worlds(entry: Sampler) -> Iterator[chi2.Case]:
    for turn in (np.eye(3), chi2.frame(TILTED)):
        world = replace(entry.example, rotation=turn)
        yield world_case(f"{entry.name} world {turn[0, 0]:.1f}", world)
        yield ReferenceLight(f"{entry.name} world {turn[0, 0]:.1f}, reference", make_world(world, 1.0), (0, 0, 0), UP)


def world_case(name: str, world: World) -> Light:
    return Light(name, IMAGES, Scene(world=world), (0, 0, 0), UP, everywhere)


def emitters(entry: Sampler) -> Iterator[chi2.Case]:
    """Emissive surfaces, about the origin and nearly in z = 0."""
    for where, (p, n) in positions(1.0).items():
        yield emitter_case(f"{entry.name} emitter, {where}", entry.example, p, n)


def emitter_case(name: str, vertices: np.ndarray, p, n) -> Light:
    corners = np.asarray(vertices, np.float32)
    faces = [[0, 1, 2]] if len(corners) == 3 else [[0, 1, 2], [0, 2, 3]]
    scene = Scene(materials=[Material("light", emission=(1.0, 1.0, 1.0))])
    scene.add_instance(Mesh("light", corners, np.array(faces, np.uint32)))
    place = np.asarray(p, np.float32).astype(float)
    a, b, c = corners[0].astype(float), corners[1].astype(float), corners[-1].astype(float)
    inverse = np.linalg.inv(np.stack([b - a, c - a, np.cross(b - a, c - a)], axis=1))

    def hit(wi):
        start, along = inverse @ (place - a), wi @ inverse.T
        t = -start[2] / np.where(along[:, 2] == 0, 1e-300, along[:, 2])
        x, y = start[0] + t * along[:, 0], start[1] + t * along[:, 1]
        inside = (x >= 0) & (y >= 0) & ((x + y <= 1) if len(corners) == 3 else (x <= 1) & (y <= 1))
        return np.where(inside & (t > 0), t, 0)

    return Light(name, EMITTERS, scene, p, n, hit)
