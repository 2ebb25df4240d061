"""The compiled road's schedule: pack and build, get the kernel, then passes over the picture on all threads.

The order of passes and tiles depends on nothing but the settings, and each pixel is summed by one thread at a time
in the order of its samples, so the same scene and seed give the same bits on any number of threads.
"""

from __future__ import annotations

import contextlib
import gc
import itertools
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from . import elsewhere
from .adaptive import AdaptiveSampling
from .compilation import PREPARING, Compilation, loading
from .features import EMITTER_TREE, ONE_EMITTER, RECTANGLE, Features
from .film import Film
from .kernels.batch import BATCH
from .kernels.embree import build_monitor, lamp_filter, new_ray
from .kernels.first_hit import make_first_hit_kernel
from .kernels.jit import CACHE_FOLDER, lost_cache
from .kernels.parts import PartSums
from .kernels.records import COUNTERS, DIRECTIONS, DRAWS, REJECTED, Limits, Tables
from .kernels.tile import make_tile_kernel, new_memory
from .lighttree import build_nodes, load_builder
from .memory import foresee, need_of_film
from .pack import Packed, pack
from .pack.again import pack_next
from .passes import LIGHT
from .prepared import Prepared
from .result import RENDERING, Doing, Progress, Result
from .scene import Camera, Scene
from .settings import Settings

FIRST_PASSES = (1, 1, 2, 4, 8, 16)  # samples of the first passes, so that a picture stands early
PASS_SAMPLES = 32  # samples of every pass after them
TILE_SAMPLES = 1 << 14  # a tile takes some milliseconds: the threads end a pass together
TILES = 64  # at least, also in small pictures, as long as they fill a batch of paths
TILES_PER_THREAD = 8  # at least, so that the threads end a pass together
POLL_SECONDS = 0.03
PROGRESS_SECONDS = 0.2
BUILDING = Doing("building")
TREE_BUILDER = {"function": "builder of light trees"}  # in place of a `_name`
BUILDER_ONCE = "compiling what sorts lights", "(once)"  # two counters in a row: each says what it counts
COMMON = {"kernels": "of common scenes"}  # to mark that they are all there
NOT_ADAPTIVE = np.zeros((1, 1, 3)), np.ones((1, 1), np.bool_)  # stands for AdaptiveSampling.half and .active
NO_PARTS = PartSums(np.zeros((1, 1, 1)), np.full(len(LIGHT), -1, np.int64))

tile_kernel = cache(make_tile_kernel)
first_hit_kernel = cache(make_first_hit_kernel)


class Stopped(Exception):
    """The caller's `stop` said so."""


class _Watch:
    """Asks the caller whether to stop and tells how far the render is, always on the caller's thread."""

    def __init__(self, settings: Settings, progress, stop):
        self.total, self._progress, self._stop = settings.samples, progress, stop
        self._time_limit = settings.time_limit
        self.start = self._told = time.perf_counter()
        self.film: Film | None = None  # once there is something to see
        self.render_start = 0.0

    def show(self, film: Film) -> None:
        """From now on the film's picture and the remaining time are told."""
        self.film, self.render_start = film, time.perf_counter()
        self.tell(Doing(RENDERING), force=True)  # who cancels from now on gets a picture, and may wait for it

    @property
    def deadline(self) -> float:
        return self.render_start + self._time_limit if self._time_limit else np.inf

    def tell(self, doing: Doing, force: bool = False) -> None:
        now = time.perf_counter()
        if self._progress is None or not (force or self.is_due()):
            return
        self._told = now
        film, remaining = self.film, None
        done = float(film.samples.mean()) if film is not None else 0.0
        if done > 0:
            remaining = (now - self.render_start) * (self.total - done) / done
            remaining = max(min(remaining, self.deadline - now), 0.0)
        picture = film.pixels if film is not None and done > 0 else lambda: None
        self._progress(
            Progress(int(done), self.total, now - self.start, remaining, doing.message, picture, doing.steps)
        )

    def is_due(self) -> bool:
        """Whether nothing has been told for long enough."""
        return time.perf_counter() - self._told > PROGRESS_SECONDS

    def wait_for(self, futures: Sequence[Future], doing: Callable[[float], Doing]) -> None:
        """Until all are done; their exceptions are raised. Raises Stopped when the caller says so."""
        begun = time.perf_counter()
        pending = set(futures)
        while pending:
            done, pending = wait(pending, timeout=POLL_SECONDS)
            for future in done:
                future.result()
            if pending:
                self.ask()
            if self.is_due():
                self.tell(doing(time.perf_counter() - begun))

    def ask(self) -> None:
        """Raises Stopped when the caller says so."""
        if self._stop is not None and self._stop():
            raise Stopped


def render_compiled(
    scene: Scene,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
    stop: Callable[[], bool] | None = None,
    prepared: Prepared | None = None,
) -> Result:
    """See `engine.render`. Scene and settings are valid."""
    return _Render(scene, settings, _Watch(settings, progress, stop), prepared or Prepared()).run()


class _Render:
    """One render, phase by phase, on a pool of threads. All of them, Embree's too, end early once `halt[0]` is set."""

    def __init__(self, scene: Scene, settings: Settings, watch: _Watch, prepared: Prepared):
        self.scene, self.settings, self.watch, self.prepared = scene, settings, watch, prepared
        foresee(need_of_film(scene, settings.passes))
        self.result = Result(
            pixels=np.zeros(0, np.float32), samples=0, skipped=list(scene.skipped), warnings=list(scene.warnings)
        )
        self.threads = settings.thread_count
        self.pool = ThreadPoolExecutor(self.threads, thread_name_prefix="lobe")
        self.halt = np.zeros(1, np.uint8)
        self.counted = np.zeros(COUNTERS, np.int64)

    def run(self) -> Result:
        result = self.result
        try:
            with self._timed("compile"):
                self._load_small_ones()
            with self._timed("build"):
                packed = self._build()
            with self._timed("compile"):
                doing = self._do(lambda _: PREPARING, compiling, packed)  # may wait for another's compilation
                self._do(doing, get_kernel, packed, self.settings, self.halt)
            with self._timed("render"):
                self._passes(packed)
        except Stopped:
            result.stopped = True
        finally:
            self.halt[0] = 1
            self.pool.shutdown(wait=False, cancel_futures=True)
        self._develop()
        if result.rejected:
            result.warnings.append(f"{result.rejected} samples were not finite numbers and were left out")
        if problem := lost_cache():
            result.warnings.append(problem)
        return result

    def _develop(self) -> None:
        """The pictures for the result. Where the render was stopped before there was a film, each is a view of one
        pixel without a sample: the thread that goes on with the build may have taken the memory."""
        x0, y0, x1, y1 = self.scene.render_region
        film = self.watch.film or Film((x0, y0, x0 + 1, y0 + 1), self.scene.exposure, self.settings.passes)
        result, size = self.result, (y1 - y0, x1 - x0)
        result.pixels, result.passes = film.pixels(), film.pass_pictures()
        if self.watch.film is None:
            result.pixels = np.broadcast_to(result.pixels, (*size, result.pixels.shape[-1]))
            result.passes = {
                name: np.broadcast_to(picture, (*size, picture.shape[-1])) for name, picture in result.passes.items()
            }
        result.samples = float(film.samples.mean()) if film.samples.size else 0.0

    @contextlib.contextmanager
    def _timed(self, phase: str) -> Iterator[None]:
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.result.seconds[phase] = self.result.seconds.get(phase, 0.0) + time.perf_counter() - begun

    def _do(self, doing: Callable[[float], Doing], function: Callable, *arguments):
        """Call a function on a thread of the pool, while this one looks after the caller."""
        future = self.pool.submit(function, *arguments)
        self.watch.wait_for([future], doing)
        return future.result()

    def _load_small_ones(self) -> None:
        """Compiled functions that packing needs."""
        self.watch.tell(BUILDING, force=True)
        for doing, function in small_functions(self.scene, self.halt):
            self._do(doing, function)

    def _build(self) -> Packed:
        packed = self._do(lambda _: BUILDING, pack_next, self.prepared, self.scene, self.settings, self.halt)
        self.result.skipped += packed.features.skipped()
        return packed

    def _passes(self, packed: Packed) -> None:
        """All samples of all pixels, pass by pass."""
        settings, watch = self.settings, self.watch
        film = Film(self.scene.render_region, self.scene.exposure, settings.passes)  # foreseen, while there was none
        watch.show(film)
        adaptive = AdaptiveSampling(film, settings.adaptive_threshold) if settings.use_adaptive_sampling else None
        for first, count in schedule(settings.samples):
            self._one_pass(packed, film, adaptive, first, count)
            watch.tell(Doing(RENDERING), force=first == 0)
            watch.ask()  # a pass may be over before anybody asked
            if (adaptive is not None and adaptive.update()) or time.perf_counter() > watch.deadline:
                return

    def _one_pass(self, packed: Packed, film: Film, adaptive: AdaptiveSampling | None, first: int, count: int) -> None:
        """Samples first .. first + count of the picture, on all threads."""
        tiles = Shared(tiles_of(film.region, count))
        futures = [
            self.pool.submit(self._work, packed, film, adaptive, tiles, first, count) for _ in range(self.threads)
        ]
        try:
            self.watch.wait_for(futures, lambda _: Doing(RENDERING))
        finally:
            # All threads have to be out of the kernel before anything that they read can go.
            self.halt[0] = any(not future.done() for future in futures)
            wait(futures)
            self._count([future.result() for future in futures if future.exception() is None])

    def _work(
        self, packed: Packed, film: Film, adaptive, tiles: Iterator, first: int, count: int
    ) -> tuple[int, np.ndarray]:
        """One thread's part of a pass. Returns the rays traced and the kernel's counters."""
        # The first pass is finished in any case: a picture with holes is none.
        deadline = self.watch.deadline if first > 0 else np.inf
        return render_tiles(packed, self.settings, film, adaptive, tiles, first, count, self.halt, deadline)

    def _count(self, work: list[tuple[int, np.ndarray]]) -> None:
        for rays, counters in work:
            self.result.rays += rays
            self.counted += counters
        self.result.rejected = int(self.counted[REJECTED])
        self.result.draws_per_direction = float(self.counted[DRAWS] / max(self.counted[DIRECTIONS], 1))


def render_tiles(
    packed: Packed, settings: Settings, film: Film, adaptive: AdaptiveSampling | None, tiles: Iterator, first: int,
    count: int, halt: np.ndarray, deadline: float = np.inf,
) -> tuple[int, np.ndarray]:  # fmt: skip
    """Samples first .. first + count of tiles, on this thread, until none is left, `halt[0]` is set or the deadline is
    over. Returns the rays traced and the kernel's counters."""
    render_tile, tables = tile_kernel(packed.features), _tables(packed)
    limits, seed = _limits(packed.features, settings), np.uint32(settings.seed & 0xFFFFFFFF)
    origin = np.array(film.region[:2], np.int64)
    half, active = (adaptive.half, adaptive.active) if adaptive else NOT_ADAPTIVE
    memory = new_memory(packed.features, packed.lights.shape_count)
    parts = PartSums(film.passes.parts, film.passes.part_columns) if film.passes else NO_PARTS
    look = _first_hits(packed, film, seed, active) if packed.surfaces and film.passes else None
    counters, rays = np.zeros(COUNTERS, np.int64), 0
    for tile in tiles:
        if halt[0] or time.perf_counter() > deadline:
            break
        rays += render_tile(
            tables, limits, memory, tile, first, count, seed, origin, film.sums, film.samples, half, active, parts,
            counters, halt,
        )  # fmt: skip
        if look is not None:
            rays += look(tile, first, count, halt)
    return rays, counters


def _first_hits(packed: Packed, film: Film, seed: np.uint32, active: np.ndarray) -> Callable:
    """`look(tile, first, count, halt)` sums up what these samples see first. Returns the rays traced."""
    assert film.passes is not None
    kernel, tables, memory = first_hit_kernel(_seen_first(packed.features)), _tables(packed), new_ray()
    origin, data, columns = np.array(film.region[:2], np.int64), film.passes.data, film.passes.columns

    def look(tile, first: int, count: int, halt: np.ndarray) -> int:
        return kernel(
            tables, packed.surfaces, memory, tile, first, count, seed, origin, data, columns, active, halt
        )  # fmt: skip

    return look


def _seen_first(features: Features) -> Features:
    """Those of a scene's features that decide what the camera sees first: scenes with the same share a kernel."""
    names = (
        "smooth",
        "instances",
        "transparency",
        "holdout",
        "mesh_emitters",
        "world",
        "orthographic",
        "lens",
        "transparent_film",
    )
    return Features(**{name: getattr(features, name) for name in names})


def small_functions(scene: Scene, halt: np.ndarray) -> Iterator[tuple[Callable[[float], Doing], Callable]]:
    """What loads or compiles the functions that packing the scene needs, each after what to say meanwhile. halt: see
    `get_kernel`."""
    for make in (build_monitor, lamp_filter) if scene.lights else (build_monitor,):
        yield partial(loading, elsewhere.is_marked(_callback(make), _cache())), partial(_get_callback, make)
    if len(scene.lights) > 1 or any(any(material.emission) for material in scene.materials):
        builder = Compilation([build_nodes], elsewhere.is_marked(TREE_BUILDER, _cache()), BUILDER_ONCE)
        yield builder, partial(_get_builder, halt)


def compiling(packed: Packed) -> Compilation:
    """What to say while `get_kernel` works."""
    kernels = [tile_kernel(packed.features)]
    if packed.surfaces:
        kernels.append(first_hit_kernel(_seen_first(packed.features)))
    return Compilation(kernels, elsewhere.is_marked(_name(packed), _cache()))


def schedule(total: int) -> Iterator[tuple[int, int]]:
    """(first sample, number of samples) of each pass."""
    first = 0
    for count in itertools.chain(FIRST_PASSES, itertools.repeat(PASS_SAMPLES)):
        if first >= total:
            return
        yield first, min(count, total - first)
        first += count


def tiles_of(
    region: tuple[int, int, int, int], samples: int, least: int = TILES
) -> Iterator[tuple[int, int, int, int]]:
    """Squares (x0, y0, x1, y1) that cover the region, smaller the more samples each pixel gets; `least` of them where
    there are pixels enough. How a picture is cut changes none of its bits."""
    x0, y0, x1, y1 = region
    size = min(max((x1 - x0) * (y1 - y0) * samples // least, BATCH), TILE_SAMPLES)
    side = max(4, 1 << ((size // samples).bit_length() // 2))
    for y in range(y0, y1, side):
        for x in range(x0, x1, side):
            yield x, y, min(x + side, x1), min(y + side, y1)


class Shared:
    """An iterator that threads take from in turn."""

    def __init__(self, items: Iterator):
        self._items, self._lock = items, threading.Lock()

    def __iter__(self):
        return self

    def __next__(self):
        with self._lock:
            return next(self._items)


def _tables(packed: Packed) -> Tables:
    return Tables(
        packed.geometry, packed.lights, packed.environment, packed.tree, packed.camera, packed.filter_table,
        packed.sampler,
    )  # fmt: skip


def _limits(features: Features, settings: Settings) -> Limits:
    # Without Phong every bounce is a diffuse one; the kernel then counts no kinds.
    bounces = settings.max_bounces if features.phong else min(settings.max_bounces, settings.diffuse_bounces)
    return Limits(
        np.int32(bounces),
        np.int32(settings.diffuse_bounces),
        np.int32(settings.glossy_bounces),
        np.float32(settings.clamp_direct),
        np.float32(settings.clamp_indirect),
    )


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
    limits = _limits(packed.features, settings)
    with _no_garbage_collection():
        tile_kernel(packed.features)(
            _tables(packed), limits, new_memory(packed.features), (0, 0, 0, 0), 0, 0, np.uint32(0),
            np.zeros(2, np.int64), np.zeros((1, 1, 4)), np.zeros((1, 1), np.int32), np.zeros((1, 1, 3)),
            np.ones((1, 1), np.bool_), NO_PARTS, np.zeros(COUNTERS, np.int64), np.zeros(1, np.uint8),
        )  # fmt: skip
        if packed.surfaces:
            film = Film((0, 0, 1, 1), 1.0, settings.passes)
            look = _first_hits(packed, film, np.uint32(0), np.ones((1, 1), np.bool_))
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
    from .features import CONSTANT_WORLD, DISK, EVERYTHING, IMAGE_WORLD

    if _cache() is None or elsewhere.is_marked(COMMON, _cache()):
        return
    glossy = Features(phong=1, smooth=1)
    lamp_lit = glossy._replace(lamp_kinds=DISK, lamp_shapes=1, emitter_choice=ONE_EMITTER, world=CONSTANT_WORLD)
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
