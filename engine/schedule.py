"""The compiled road's schedule: pack and build, get the kernel, then passes over the picture on all threads.

The order of passes and tiles depends on nothing but the settings, and each pixel is summed by one thread at a time
in the order of its samples, so the same scene and seed give the same bits on any number of threads.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numpy as np

from .adaptive import AdaptiveSampling
from .compilation import PREPARING
from .film import Film
from .kernels.jit import lost_cache
from .kernels.records import COUNTERS, DIRECTIONS, DRAWS, REJECTED
from .loading import compiling, get_kernel, small_functions
from .memory import foresee, need_of_film
from .pack import Packed
from .pack.again import pack_next
from .prepared import Prepared
from .result import RENDERING, Doing, Progress, Result
from .scene import Scene
from .settings import Settings
from .tiles import Shared, render_tiles, tiles_of

PASS_SAMPLES = 32  # a pixel, in a pass, at most
# In the first pass, or one sample a pixel: some tenths of a second on two threads. Passes cost time: rays of one pixel
# lie close together, and threads wait for the last tile.
FIRST_PASS_PATHS = 1 << 19
POLL_SECONDS = 0.03
PROGRESS_SECONDS = 0.2
BUILDING = Doing("building")


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
            result.warnings.append(f"{result.rejected} samples were not finite numbers and count as black")
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
        for first, count in schedule(settings.samples, film.samples.size):
            self._one_pass(packed, film, adaptive, first, count)
            if first + count < settings.samples:
                watch.tell(Doing(RENDERING))
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


def schedule(total: int, pixels: int) -> Iterator[tuple[int, int]]:
    """(first sample, number of samples) of each pass over so many pixels: short ones first, so that a picture stands
    early."""
    shortest, first = 1 << max((FIRST_PASS_PATHS // pixels).bit_length() - 1, 0), 0
    while first < total:
        count = min(max(first, shortest), PASS_SAMPLES, total - first)
        yield first, count
        first += count
