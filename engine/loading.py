"""Has the compiled functions that a scene needs ready: loaded from the disk, or compiled before."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from . import elsewhere, tiles
from .compilation import Compilation, loading_callback
from .features import (
    CONSTANT_WORLD,
    DISK,
    EMITTER_TREE,
    EVERYTHING,
    IMAGE_WORLD,
    LISTED_LAMPS,
    ONE_EMITTER,
    RECTANGLE,
    Features,
)
from .film import Film
from .kernels.embree import build_monitor, lamp_filter
from .kernels.jit import CACHE_FOLDER, lost_cache
from .kernels.records import COUNTERS
from .lighttree import build_nodes, load_builder
from .pack import Packed, pack
from .pack.lamps import may_be_traced
from .result import Doing
from .scene import Camera, Scene
from .settings import Settings

TREE_BUILDER = {"function": "builder of light trees"}  # in place of a `_name`
BUILDER_ONCE = "compiling what sorts lights", "(once)"  # two counters in a row: each says what it counts
COMMON = {"kernels": "of common scenes"}  # to mark that they are all there


def small_functions(scene: Scene, halt: np.ndarray) -> Iterator[tuple[Callable[[float], Doing], Callable]]:
    """What loads or compiles the functions that packing the scene needs, each after what to say meanwhile. halt: see
    `get_kernel`."""
    for make in (build_monitor, lamp_filter) if may_be_traced(scene) else (build_monitor,):
        yield partial(loading_callback, elsewhere.is_marked(_callback(make), _cache())), partial(_get_callback, make)
    if len(scene.lights) > 1 or any(any(material.emission) for material in scene.materials):
        builder = Compilation([build_nodes], elsewhere.is_marked(TREE_BUILDER, _cache()), BUILDER_ONCE)
        yield builder, partial(_get_builder, halt)


def compiling(packed: Packed) -> Compilation:
    """What to say while `get_kernel` works."""
    kernels = [tiles.tile_kernel(packed.features)]
    if packed.surfaces:
        kernels.append(tiles.first_hit_kernel(tiles.seen_first(packed.features)))
    return Compilation(kernels, elsewhere.is_marked(_name(packed), _cache()))


def get_kernel(packed: Packed, settings: Settings, halt: np.ndarray) -> None:
    """Have the kernel ready. Once `halt[0]` is set, elsewhere.CompilationStopped is raised where another process
    compiles it; in this one a compilation runs to its end."""
    elsewhere.compiled(_name(packed), _cache(), lambda: bool(halt[0]))
    load_kernel(packed, settings)


def _callback(make: Callable) -> dict[str, Any]:
    return {"callback": make.__name__}


def _get_callback(make: Callable) -> None:
    """Have a function for C to call ready, and in the disk cache."""
    make()
    elsewhere.mark(_callback(make), _cache())


def _get_builder(halt: np.ndarray) -> None:
    elsewhere.compiled(TREE_BUILDER, _cache(), lambda: bool(halt[0]))
    precompile_one(TREE_BUILDER)


def load_kernel(packed: Packed, settings: Settings) -> None:
    """A tile without pixels makes Numba compile the kernel or read it from disk."""
    limits = tiles.limits_of(packed.features, settings)
    with _no_garbage_collection():
        tiles.tile_kernel(packed.features)(
            tiles.tables_of(packed), limits, tiles.new_batch(packed.features), (0, 0, 0, 0), 0, 0, np.uint32(0),
            np.zeros(2, np.int64), np.zeros((1, 1, 4)), np.zeros((1, 1), np.int32), np.zeros((1, 1, 3)),
            np.ones((1, 1), np.bool_), tiles.NO_PARTS, np.zeros(COUNTERS, np.int64), np.zeros(1, np.uint8),
        )  # fmt: skip
        if packed.surfaces:
            film = Film((0, 0, 1, 1), 1.0, settings.passes)
            look = tiles.first_hits(packed, film, np.uint32(0), np.ones((1, 1), np.bool_))
            look((0, 0, 0, 0), 0, 0, np.zeros(1, np.uint8))
    elsewhere.mark(_name(packed), _cache())


def _name(packed: Packed) -> dict[str, Any]:
    """What says which kernels the scene takes: `precompile_one` compiles them by it."""
    return {"features": packed.features._asdict(), "first_hits": packed.surfaces is not None}


def _cache() -> Path | None:
    return None if lost_cache() else CACHE_FOLDER


@contextlib.contextmanager
def _no_garbage_collection():
    """Numba makes millions of objects that live on: looking for garbage among them is a tenth of compiling."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def precompile_one(name: dict[str, Any]) -> None:
    """Have the kernels of this `_name` in the disk cache, or the function that builds light trees."""
    if name == TREE_BUILDER:
        load_builder()
        elsewhere.mark(name, _cache())
        return
    settings = Settings(passes=("DEPTH",) if name["first_hits"] else ())
    packed = pack(Scene(camera=Camera()), settings)
    packed.features = Features(**name["features"])
    load_kernel(packed, settings)


def precompile_common(progress: Callable[[int, int], None]) -> None:
    """Compile the kernels of common scenes into the disk cache, those that are needed soonest first, unless they are
    there. progress: told how many kinds of scenes are done, and of how many.

    Functions that kernels share are in the cache too: what these scenes have between them is most of what there is,
    so that any other scene takes a small part of the first one's time, see benchmarks/results/startup.md.
    """
    if _cache() is None or elsewhere.is_marked(COMMON, _cache()):
        return
    glossy = Features(phong=1, smooth=1)
    lamp_lit = glossy._replace(
        lamp_kinds=DISK, lamp_shapes=LISTED_LAMPS, emitter_choice=ONE_EMITTER, world=CONSTANT_WORLD
    )
    mesh_lit = Features(mesh_emitters=1, emitter_choice=EMITTER_TREE)
    common = (
        lamp_lit._replace(smooth=0),  # Blender's default scene
        lamp_lit,
        lamp_lit._replace(emitter_choice=EMITTER_TREE),
        lamp_lit._replace(lamp_kinds=RECTANGLE),
        lamp_lit._replace(lamp_kinds=RECTANGLE, emitter_choice=EMITTER_TREE),
        glossy._replace(suns=1, sun_disks=1, world=CONSTANT_WORLD),
        glossy._replace(world=CONSTANT_WORLD),
        glossy._replace(world=IMAGE_WORLD),
        mesh_lit._replace(rectangle_emitters=1, emitter_choice=ONE_EMITTER),  # the Cornell box
        mesh_lit._replace(phong=1, smooth=1, world=CONSTANT_WORLD),
        Features(**EVERYTHING, transparent_film=1),
    )
    _get_callback(build_monitor)
    _get_callback(lamp_filter)
    packed = pack(Scene(camera=Camera()), Settings())
    for done, features in enumerate(common):
        progress(done, len(common))
        packed.features = features
        load_kernel(packed, Settings())
    precompile_one(TREE_BUILDER)
    elsewhere.mark(COMMON, _cache())
