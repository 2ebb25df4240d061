"""The reference road: a plain path tracer in numpy, float64, written to be read.

It shares the scene description with the compiled road and nothing else, so that each can be held against the other.
Start with `integrator.py`; `bsdf.py`, `lights.py`, `camera.py` and `geometry.py` are what it calls. Random numbers
are independent and come from numpy's generator; no Numba, no tables, no cleverness.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from ..result import RENDERING, Progress, Result
from ..scene import Scene
from ..settings import Settings
from .camera import camera_rays, filter_offsets
from .integrator import Integrator

__all__ = ["left_out", "render_reference"]

BATCH = 8192  # paths at a time: enough for numpy, few enough to stop and to report several times a second


def render_reference(
    scene: Scene,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Result:
    """Render on the caller's thread. Deterministic for a seed."""
    scene.validate()
    settings.validate()
    assert scene.camera is not None  # validated
    stop = stop or (lambda: False)
    begin = time.perf_counter()
    x0, y0, x1, y1 = scene.render_region
    width, height = x1 - x0, y1 - y0
    pixels = width * height
    total = pixels * settings.samples
    light, alpha, count = np.zeros((pixels, 3)), np.zeros(pixels), np.zeros(pixels)

    def picture() -> np.ndarray | None:
        if not count.any():
            return None
        out, weight = np.empty((pixels, 4), np.float32), 1 / np.maximum(count, 1)
        np.multiply(light, (weight * scene.exposure)[:, None], out=out[:, :3], casting="same_kind")
        np.multiply(alpha, weight, out=out[:, 3], casting="same_kind")
        return out.reshape(height, width, 4)

    def report(done: int, message: str) -> None:
        if progress:
            spent = time.perf_counter() - begin
            left = spent * (total - done) / done if done else None
            progress(Progress(done // pixels, settings.samples, spent, left, message, picture))

    report(0, "building")
    integrator = Integrator(scene, settings)
    built = time.perf_counter()
    report(0, RENDERING)

    done, stopped = 0, False
    while done < total:
        if stop():
            stopped = True
            break
        # Samples are numbered pass by pass over the picture; a batch is a run of them.
        pixel = np.arange(done, min(done + BATCH, total)) % pixels
        rng = np.random.default_rng([settings.seed % (1 << 32), done // BATCH])
        corner = np.column_stack([pixel % width + x0, pixel // width + y0])
        position = corner + 0.5 + filter_offsets(settings, len(pixel), rng)
        rays = camera_rays(scene.camera, position, (scene.width, scene.height), rng)
        found = integrator.radiance(*rays, rng, stop)
        if found is None:
            stopped = True
            break
        np.add.at(light, pixel, found[0])
        np.add.at(alpha, pixel, found[1])
        np.add.at(count, pixel, 1)
        done += len(pixel)
        report(done, RENDERING)
        if 0 < settings.time_limit < time.perf_counter() - begin and done >= pixels:
            break

    black = np.zeros((height, width, 4), np.float32)
    pixels_now = picture()
    return Result(
        pixels=black if pixels_now is None else pixels_now,
        samples=done / pixels,
        seconds={"build": built - begin, "compile": 0.0, "render": time.perf_counter() - built},
        rays=integrator.geometry.rays,
        rejected=integrator.rejected,
        skipped=list(scene.skipped),
        warnings=list(scene.warnings) + left_out(settings),
        stopped=stopped,
    )


def left_out(settings: Settings) -> list[str]:
    """What the settings ask for that this road doesn't do, as sentences."""
    sentences = []
    if settings.use_adaptive_sampling:
        sentences.append("adaptive sampling is not part of the reference road: every pixel gets the same samples")
    if settings.passes:
        sentences.append("passes beside Combined are not part of the reference road: they stay empty")
    return sentences
