"""What the sample scenes have to bear, and which picture each must then show.

A change is an entry of `CHANGES`; `test_sample_scenes.py` applies every one to every sample scene.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from stress import moves, spots, surfaces
from stress.test_places import MATRICES, through

from engine.scene import Scene

SceneChange = Callable[[Scene], Scene]

ALONG = np.array([0.6, -0.7, 0.39])  # direction of all moves
# Far from the world's origin rays start up to this part of the distance off a surface (engine/kernels/geom/surface.py).
# Among things of a metre's size that many metres change the picture by as many parts: beyond FARTHEST, by more than
# can be told from a fault.
STEP, FARTHEST = 2.0**-19, 1e4
SAMPLES = (64, 512, 4096)
DEEP = {"max_bounces": 1000, "diffuse_bounces": 1000, "glossy_bounces": 1000}


def unstressed(scene: Scene) -> Scene:
    return scene


@dataclass(frozen=True)
class Change:
    """One row of the table for each scene.

    kind        of the issue's list; the quick selection has one of each
    stressed    makes the scene that is put to the test
    expected    makes the scene whose picture that must be; None: it only has to be finite
    factor      the stressed picture is so many times as bright
    slack       what the two may differ by, relative, beside noise
    settings    of the render, and those in which the expected picture's differ
    samples     more and more, until the half width will do
    bake_limit  of engine/pack/geometry.py, for the stressed scene
    """

    kind: str
    stressed: SceneChange
    expected: SceneChange | None = unstressed
    factor: float = 1.0
    slack: float = moves.ROUNDING
    settings: dict = field(default_factory=dict)
    expected_settings: dict = field(default_factory=dict)
    samples: tuple[int, ...] = SAMPLES
    bake_limit: int | None = None


def after(*changes: SceneChange) -> SceneChange:
    """One after the other."""

    def change(scene: Scene) -> Scene:
        for one in changes:
            scene = one(scene)
        return scene

    return change


def _moved() -> dict[str, Change]:
    out = {}
    for distance in (1e3, 1e4, 1e5, 1e6):
        by = distance * ALONG
        out[f"moved by {distance:g} m"] = Change("moved", lambda scene, by=by: moves.moved(scene, by))
        far = after(surfaces.own_meshes, lambda scene, by=by: surfaces.with_pebble(moves.moved(scene, by), np.zeros(3)))
        name = f"moved by {distance:g} m from a pebble that stays"
        if distance > FARTHEST:
            out[name] = Change("moved from a pebble", far, None)
            continue
        out[f"{name}: as rounded there"] = Change(
            "moved from a pebble",
            far,
            lambda scene, by=by: surfaces.rounded_at(surfaces.own_meshes(scene), by),
            slack=STEP * distance,
        )
    out["a pebble 1e6 m away"] = Change("a pebble", lambda scene: surfaces.with_pebble(scene, 1e6 * ALONG))
    return out


def _scaled() -> dict[str, Change]:
    return {
        f"scaled by {factor:g}": Change("scaled", lambda scene, factor=factor: moves.scaled(scene, factor))
        for factor in (1e-6, 1e-3, 1e3, 1e6)
    }


def _matrices() -> dict[str, Change]:
    out = {}
    turn = np.linalg.qr(np.random.default_rng(6).normal(size=(3, 3)))[0]
    matrices = {**MATRICES, "nearly singular": turn @ np.diag([1, 1, 1e-5]) @ turn.T}
    for name, matrix in matrices.items():
        for how, limit in (("instanced", 0), ("baked", None)):
            out[f"instances {name}, {how}"] = Change(
                f"matrices, {how}",
                lambda scene, matrix=matrix: through(surfaces.doubled(scene), matrix),
                lambda scene, matrix=matrix: surfaces.rounded_through(surfaces.doubled(scene), matrix),
                bake_limit=limit,
            )
    return out


def _lights() -> dict[str, Change]:
    beside = 1e-3  # what LIFT may change
    ball, square, lift = spots.ball_at, spots.square_at, spots.LIFT
    return {
        "a lamp touches the ground: as just above it": Change("lamp", ball(1), ball(1 + lift), slack=beside),
        "a lamp half in the ground: as just above that": Change("lamp", ball(0), ball(lift), slack=beside),
        "a lamp in the ground's plane, facing up: as just above it": Change(
            "lamp", square(0, 1), square(lift, 1), slack=beside
        ),
        "a lamp in the ground's plane, facing down: none": Change("lamp", square(0, -1)),
        "a lamp in a closed object: none": Change("lamp", spots.lamp_inside),
        "a lamp of 1e4 m around everything: a world of its radiance": Change(
            "lamp", spots.enclosed(1e4), lambda scene: spots.plain_world(scene, seen=False)
        ),
    }


def _light_sizes() -> dict[str, Change]:
    radius, size = spots.with_radius, spots.with_size
    out = {f"lamps of radius {r:g} m: as 0": Change("lamp size", radius(r), radius(0.0)) for r in (1e-30, 1e-6)}
    for r in (0.0, 1.0, 1e4):
        out[f"lamps of radius {r:g} m"] = Change("lamp size", radius(r), None, samples=(4,))
    out["area lights of size 0: none"] = Change("lamp size", size(0.0, False), spots.without_area_lights)
    out["area lights of 1e-06 m: as 0.001 m"] = Change("lamp size", size(1e-6), size(1e-3), slack=1e-4)
    for s in (1e2, 1e4):
        out[f"area lights of {s:g} m"] = Change("lamp size", size(s), None)
    return out


def _materials() -> dict[str, Change]:
    exponent = spots.with_exponent
    out = {f"exponent {e:g}": Change("exponent", exponent(e), None) for e in (0.0, 1.0, 1e3, 1e5)}
    out["exponent 1e-06: as 0"] = Change("exponent", exponent(1e-6), exponent(0.0))
    out["exponent 1e+08: as 1e+07"] = Change("exponent", exponent(1e8), exponent(1e7), slack=1e-3)
    out["albedo 0, 1,000 bounces: as 0 bounces"] = Change(
        "albedo", spots.black, spots.black, settings=DEEP, expected_settings={"max_bounces": 0}
    )
    out["albedo 1, 1,000 bounces"] = Change("albedo", spots.white(1, 0), None, settings=DEEP, samples=(4,))
    out["lobe of albedo 1, 1,000 bounces"] = Change("albedo", spots.white(0, 1), None, settings=DEEP, samples=(4,))
    out["albedo 1, flat, 1,000 bounces in a world of 1: 1"] = Change(
        "albedo",
        after(surfaces.flat, spots.white(1, 0), lambda scene: spots.plain_world(scene, 1.0)),
        after(surfaces.without_surfaces, lambda scene: spots.plain_world(scene, 1.0)),
        settings=DEEP,
        samples=(4,),
    )
    return out


def _triangles() -> dict[str, Change]:
    return {
        "slivers of aspect 1e8": Change("slivers", surfaces.slivers),
        "a million coincident triangles": Change("coincident", surfaces.coincident, samples=(1,)),
    }


def _normals() -> dict[str, Change]:
    times = surfaces.normals_times
    return {
        "normals times 1e+06": Change("normals", times(1e6)),
        "normals times 1e-06": Change("normals", times(1e-6)),
        "normals of length 0: flat": Change("normals", times(0.0), surfaces.flat),
        "faces and normals reversed": Change("normals", after(surfaces.with_normals, surfaces.inside_out)),
        "normals reversed alone: black": Change("normals", times(-1.0), spots.black, slack=0.02),
    }


def _worlds() -> dict[str, Change]:
    alone = after(spots.without_lamps, lambda scene: spots.with_world(scene, 1.0))
    out = {}
    for factor in (1e30, 1e-30):
        bright = after(spots.without_lamps, lambda scene, factor=factor: spots.with_world(scene, factor))
        out[f"world {factor:g}, alone"] = Change("world", bright, alone, factor)
    out["world 1e+30, with the lamps: alone"] = Change("world", lambda s: spots.with_world(s, 1e30), alone, 1e30)
    out["world 1e-30, with the lamps: black"] = Change(
        "world", lambda s: spots.with_world(s, 1e-30), lambda s: spots.with_world(s, 0.0)
    )
    return out


def _cameras() -> dict[str, Change]:
    return {
        "camera in a closed object: dark": Change(
            "camera", spots.camera_inside, after(surfaces.without_surfaces, lambda s: spots.plain_world(s, 0.0))
        ),
        "camera in a lamp: its radiance": Change(
            "camera", spots.camera_inside_lamp, after(surfaces.without_surfaces, spots.plain_world)
        ),
        "camera on the ground": Change("camera", spots.camera_on_ground, None),
    }


CHANGES: dict[str, Change] = {
    **_moved(),
    **_scaled(),
    **_matrices(),
    **_lights(),
    **_light_sizes(),
    **_materials(),
    **_triangles(),
    **_normals(),
    **_worlds(),
    **_cameras(),
}
