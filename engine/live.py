"""A scene that is packed once and kept up to date, and the passes over its picture, from coarse to fine.

All samples of a pixel are summed in order, so that a picture that was left alone is that of `render`, but for
roundings: see `tiles_of`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace

import numpy as np

from .compilation import PREPARING
from .features import Features
from .film import Film
from .kernels.camera.layout import PIXEL_X, PIXEL_Y
from .loading import compiling, get_kernel, small_functions
from .pack import Packed, pack
from .pack.again import pack_again, same_meshes
from .result import Doing, Picture
from .scene import Instances, Scene, World
from .schedule import BUILDING, PASS_SAMPLES
from .settings import Settings
from .tiles import TILE_SAMPLES, TILES_PER_THREAD, Shared, render_tiles, tiles_of

FIRST_SECONDS = 0.045  # of the first pass: two of them follow on each other in less than a tenth of a second
COARSEST = 16  # pixels of the picture that are one of the first pass, along each side
UNKNOWN = 8  # the same before anything was measured
PASS_SECONDS = 0.5  # of the passes that follow, if more than one sample fits: how often the picture grows finer
ANNOUNCE_SECONDS = 0.3  # what takes longer has a message


class Live:
    """The state that is kept. Not for several threads at once.

    halt_pass, halt_build  (1,) uint8; once another thread sets them, the pass and the building end early
    say                    told what takes long
    """

    def __init__(self, halt_pass: np.ndarray, halt_build: np.ndarray, say: Callable[[str], None]):
        self._halt_pass, self._halt_build, self._say = halt_pass, halt_build, say
        self._threads, self._pool = 0, ThreadPoolExecutor(1)
        self._packed: Packed | None = None
        self._loaded: set[Features] = set()  # whose kernels are there
        self._shown: tuple[Scene, Settings] | None = None
        self._film: Film | None = None  # of the picture in full resolution
        self._done = 0  # its samples
        self._sample_seconds = 0.0  # 0: not known yet

    def close(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._packed = self._shown = self._film = None

    def pictures(self, scene: Scene, settings: Settings) -> Iterator[Picture]:
        """Ever better ones, until the settings' samples are reached or a pass is halted.

        Goes on where it was if nothing but the number of samples is new. Raises SceneError or SettingsError for what
        cannot be rendered.
        """
        if not self._goes_on(scene, settings):
            self._film = None
            self._prepare(scene, settings)
            for coarse in self._steps(scene):
                film = Film(_divided(scene.render_region, coarse), scene.exposure)
                if not self._pass(film, coarse, 0, 1):
                    return
                yield self._picture(film, coarse, 0)
            self._film, self._done = Film(scene.render_region, scene.exposure), 0
        yield from self._refine(settings.samples)

    def _goes_on(self, scene: Scene, settings: Settings) -> bool:
        before, self._shown = self._shown, (scene, settings)
        if before is None or self._film is None:
            return False
        return before[0] is scene and replace(before[1], samples=settings.samples) == settings

    def _refine(self, total: int) -> Iterator[Picture]:
        """Passes over the picture in full resolution."""
        film = self._film
        assert film is not None
        while self._done < total:
            fit = int(PASS_SECONDS / max(self._sample_seconds * film.samples.size, 1e-9))
            count = min(max(self._done, 1), max(fit, 1), PASS_SAMPLES, total - self._done)
            if not self._pass(film, 1, self._done, count):
                self._film = None  # nobody knows which pixels have which samples
                return
            self._done += count
            yield self._picture(film, 1, self._done)
        if self._done > total:  # fewer are wanted than there are: they have been seen
            yield self._picture(film, 1, self._done)

    def _steps(self, scene: Scene) -> Iterator[int]:
        """Sizes of the pixels of the passes that come before full resolution."""
        x0, y0, x1, y1 = scene.render_region
        coarse = coarseness((x1 - x0) * (y1 - y0), self._sample_seconds)
        while coarse > 1:
            yield coarse
            coarse //= 2

    def _picture(self, film: Film, coarse: int, samples: int) -> Picture:
        scene, settings = self._shown or (Scene(), Settings())
        x0, y0, x1, y1 = (coarse * edge for edge in film.region)
        return Picture(film.pixels(), (x0, y0, x1, y1), (scene.width, scene.height), samples, settings.samples)

    # --- passes ---

    def _pass(self, film: Film, coarse: int, first: int, count: int) -> bool:
        """Samples first .. first + count; False if it was halted."""
        packed = self._packed
        assert packed is not None and self._shown is not None
        if coarse > 1:
            packed = replace(packed, camera=coarser(packed.camera, coarse))
        begun = time.perf_counter()
        samples = count * film.samples.size
        small = TILE_SAMPLES * TILES_PER_THREAD * self._threads // max(samples, 1)
        tiles = Shared(tiles_of(film.region, count * max(small, 1)))
        work = (packed, self._shown[1], film, None, tiles, first, count, self._halt_pass)
        futures = [self._pool.submit(render_tiles, *work) for _ in range(self._threads)]
        wait(futures)  # all threads are out of the kernel before anything that they read can go
        for future in futures:
            future.result()
        if self._halt_pass[0]:
            return False
        seconds = (time.perf_counter() - begun) / max(samples, 1)
        self._sample_seconds = (self._sample_seconds + seconds) / 2 if self._sample_seconds else seconds
        return True

    # --- the scene ---

    def _prepare(self, scene: Scene, settings: Settings) -> None:
        """Have everything ready that the passes need."""
        settings.validate()
        if self._packed is None:
            scene.validate()
        else:
            _news(self._packed.parts.scene, scene).validate()
        threads = settings.thread_count
        if threads != self._threads:
            self._pool.shutdown(wait=True)
            self._threads, self._pool = threads, ThreadPoolExecutor(threads, thread_name_prefix="Lobe viewport")
        if self._packed is None:
            for doing, load in small_functions(scene, self._halt_build):
                self._do(doing, load)
        packed = self._packed = self._do(lambda _: BUILDING, self._pack, scene, settings)
        if packed.features not in self._loaded:
            doing = self._do(lambda _: PREPARING, compiling, packed)
            self._do(doing, get_kernel, packed, settings, self._halt_build)
            self._loaded.add(packed.features)

    def _pack(self, scene: Scene, settings: Settings) -> Packed:
        if self._packed is not None:
            return pack_again(self._packed, scene, settings, self._halt_build)
        return pack(scene, settings, self._halt_build)

    def _do(self, doing: Callable[[float], Doing], function: Callable, *arguments):
        """Call a function, and say what is done when it takes long."""
        begun, said = time.perf_counter(), ""
        future = self._pool.submit(function, *arguments)
        while wait([future], timeout=ANNOUNCE_SECONDS).not_done:
            text = doing(time.perf_counter() - begun).message
            if text != said:
                self._say(text)
                said = text
        return future.result()


def coarseness(pixels: int, sample_seconds: float) -> int:
    """How many pixels of the picture, along each side, are one of the first pass, so that it is quick."""
    if not sample_seconds:
        return UNKNOWN
    quick = (coarse for coarse in range(1, COARSEST) if pixels * sample_seconds <= FIRST_SECONDS * coarse**2)
    return next(quick, COARSEST)


def coarser(camera: np.ndarray, factor: int) -> np.ndarray:
    """The packed camera of a picture with the same lower left corner whose pixels are `factor` times as large."""
    out = camera.copy()
    out[PIXEL_X : PIXEL_X + 3] *= factor
    out[PIXEL_Y : PIXEL_Y + 3] *= factor
    return out


def _divided(region: tuple[int, int, int, int], coarse: int) -> tuple[int, int, int, int]:
    """The coarse pixels that cover a region of fine ones."""
    x0, y0, x1, y1 = region
    return x0 // coarse, y0 // coarse, -(-x1 // coarse), -(-y1 // coarse)


def _news(checked: Scene, scene: Scene) -> Scene:
    """`scene` without what is the same as in one that has been checked."""
    out = replace(scene)
    if same_meshes(checked, scene) and len(checked.materials) == len(scene.materials):
        out.meshes, out.instances = [], Instances()
        if checked.materials is scene.materials:
            out.materials = []
    if checked.lights is scene.lights:
        out.lights = []
    if checked.world is scene.world:
        out.world = World()
    return out
