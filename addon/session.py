"""One render of one view layer: export, trace on a worker thread, show the picture as it grows, report.

Blender's side of the render stays on the thread that Blender called us on; the worker never touches bpy.
"""

from __future__ import annotations

import contextlib
import dataclasses
import threading
import time

import bpy
import numpy as np

from .. import engine as lobe
from . import scene_report
from .denoise import DenoiseError, DenoiseStopped, denoise, is_missing
from .export import ExportStopped, KeptLayers, Notes, export_scene, export_settings, property_group
from .faults import message_of
from .memory import current_and_peak_mb
from .passes import fill_passes, wanted_passes
from .report import add_layer, nothing_to_see

TICK = 0.05  # seconds between two looks at the worker: the delay of cancel and of progress
PATIENCE = 0.3  # seconds that a cancelled render is waited for before it is left to end by itself
KEEPING = 30.0  # the same once it traces: then it only makes its picture and the passes, which are kept
PREVIEW_SAMPLES = 32  # of the small pictures of materials

# Seconds between two lines about the progress. Without a window each is a line on the console.
SAY_INTERVAL = 1.0 if bpy.app.background else TICK

# Whether to show the picture while it grows. Without a window nobody sees it, and it costs time.
show_progress = not bpy.app.background


def refresh_interval(elapsed: float) -> float:
    """Seconds between two shown pictures: fast at first, then about a twentieth of the time rendered so far."""
    return min(max(0.2, elapsed / 20.0), 5.0)


class Session:
    """Made in `RenderEngine.update`, where bpy's data may be read; run in `RenderEngine.render`, where it may not."""

    def __init__(self, engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph):
        start = time.perf_counter()
        engine.update_stats("", "Exporting")
        self.engine = engine
        self.layer = depsgraph.view_layer_eval.name
        self.notes = Notes()
        self.scene_key = None if engine.is_preview else scene_report.key(depsgraph.scene)
        self.scene: lobe.Scene | None = None  # None when the user cancelled the export
        with contextlib.suppress(ExportStopped), self._noting_errors():
            self._export(depsgraph)
        self.export_seconds = time.perf_counter() - start

    def _export(self, depsgraph: bpy.types.Depsgraph) -> None:
        engine = self.engine
        passes = () if engine.is_preview else wanted_passes(depsgraph.view_layer)
        self.settings = dataclasses.replace(export_settings(depsgraph.scene_eval), passes=passes)
        if engine.is_preview:
            samples = min(self.settings.samples, PREVIEW_SAMPLES)
            self.settings = dataclasses.replace(self.settings, samples=samples)
        self.denoising = not engine.is_preview and property_group(depsgraph.scene_eval, "lobe").use_denoising
        layers = _kept_layers(engine, depsgraph)
        kept = layers.of(depsgraph)
        self.prepared = kept.prepared
        self.scene = export_scene(depsgraph, stop=self.cancelled, notes=self.notes, kept=kept)
        self.scene.warnings += nothing_to_see(self.scene, depsgraph)
        layers.keep(depsgraph, kept)

    def render(self, report: dict) -> None:
        """Trace and write the layer's picture; adds to the frame's `report`."""
        if self.scene is None:
            report["stopped"] = True
            return
        with self._noting_errors():
            self._render(report)

    def _render(self, report: dict) -> None:
        start = time.perf_counter()
        picture = _Picture(self.engine, self.scene, self.layer)
        worker = _Worker(self.scene, self.settings, self.prepared)
        finished = False
        try:
            self._watch(worker, picture)
            result = worker.outcome()
            if result is None:  # cancelled before it traced, and left to end by itself
                report["stopped"] = True
            else:
                noisy = result.pixels
                if self.denoising and not result.stopped and not is_missing():  # which the export has noted
                    self._denoise(result)
                picture.fill(result.passes, noisy if self.denoising else None)
                picture.show(result.pixels)
                total = self.export_seconds + time.perf_counter() - start
                add_layer(report, self.scene, result, self.export_seconds, total)
                report["scene_key"] = self.scene_key
                report["notes"] += self.notes.all
            finished = True
        finally:
            # Also on Ctrl-C, which arrives here as KeyboardInterrupt.
            worker.stop()
            picture.close(discard=not finished)
        if result is not None:
            _stamp(self.engine, report)

    def _denoise(self, result: lobe.Result) -> None:
        """The picture's colour, in its place, by the guides that are there; alpha stays. Where that can't be done the
        picture stays noisy."""
        self.engine.update_stats("", "Denoising")
        start = time.perf_counter()
        try:
            guides = (result.passes.get(name) for name in ("DENOISING_ALBEDO", "DENOISING_NORMAL"))
            color = denoise(result.pixels[..., :3], *guides, threads=self.settings.threads, stop=self.cancelled)
            result.pixels = np.concatenate([color, result.pixels[..., 3:]], axis=-1)
        except DenoiseError as error:
            result.warnings.append(f"the picture is not denoised: {error}")
        except MemoryError:
            result.warnings.append("the picture is not denoised: not enough memory")
        except DenoiseStopped:
            result.stopped = True
        result.seconds["denoise"] = time.perf_counter() - start

    def cancelled(self) -> bool:
        return self.engine.test_break()

    @contextlib.contextmanager
    def _noting_errors(self):
        """What ends the render goes into the scene report too, in the place of what was found there before."""
        try:
            yield
        except ExportStopped:
            raise
        except Exception as error:
            if self.scene_key is not None:
                failed = scene_report.note_from_sentence(scene_report.ERROR, message_of(error))
                scene_report.keep(self.scene_key, "render", [failed, *self.notes.all])
            raise

    def _watch(self, worker: _Worker, picture: _Picture) -> None:
        """Until the worker is done: pass its progress on to Blender, and Blender's cancel on to it."""
        start = shown = time.perf_counter()
        said: lobe.Progress | None = None
        said_at = start
        while not worker.wait(TICK):
            if self.cancelled():
                # A compilation in this process can't be interrupted: it ends in the background, unseen.
                worker.stop(PATIENCE)
                if worker.is_tracing():
                    worker.stop(KEEPING)
                break
            now, progress = time.perf_counter(), worker.progress
            if progress is not None and (now - said_at >= SAY_INTERVAL or _is_news(progress, said)):
                self._say(progress)
                said, said_at = progress, now
            pixels = worker.take_pixels()
            if pixels is not None:
                shown = now
                picture.show(pixels)
            elif show_progress and (shown == start or now - shown > refresh_interval(now - start)):
                worker.picture_wanted = True

    def _say(self, progress: lobe.Progress) -> None:
        current, peak = current_and_peak_mb()
        self.engine.update_memory_stats(memory_used=current, memory_peak=peak)
        self.engine.update_progress(min(max(progress.fraction, 0.0), 1.0))
        parts = [progress.message[:1].upper() + progress.message[1:]]
        if progress.samples:
            parts = [self.layer, f"Sample {progress.samples:.0f}/{progress.total:.0f}"]
        if progress.remaining is not None:
            parts.insert(0, f"Remaining: {_clock(progress.remaining)}")
        self.engine.update_stats("", " | ".join(parts))


def _is_news(progress: lobe.Progress, said: lobe.Progress | None) -> bool:
    """Whether another phase has begun. Where steps are counted every message is another: those wait for their turn."""
    return progress.steps is None and (said is None or progress.message != said.message)


def _kept_layers(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> KeptLayers:
    """From the frame before, where the scene has Persistent Data ticked: Blender then keeps the engine for the next
    frame, and drops it, with all that it holds, once that is unticked."""
    if engine.is_preview or not depsgraph.scene.render.use_persistent_data:
        engine.kept_layers = None
        return KeptLayers()
    if engine.kept_layers is None:
        engine.kept_layers = KeptLayers()
    return engine.kept_layers


class _Worker:
    """The engine's render on a thread of its own."""

    def __init__(self, scene: lobe.Scene, settings: lobe.Settings, prepared: lobe.Prepared):
        self.progress: lobe.Progress | None = None
        self.picture_wanted = False
        self._pixels: np.ndarray | None = None
        self._news = threading.Event()  # a picture that was wanted, or the end
        self._result: lobe.Result | None = None
        self._error: BaseException | None = None
        self._done = False
        self._stop = threading.Event()
        # A daemon: when Blender is closed it waits for no picture, only for a compilation in this process.
        self._thread = threading.Thread(
            target=self._run, args=(scene, settings, prepared), name="Lobe render", daemon=True
        )
        self._thread.start()

    def _run(self, scene: lobe.Scene, settings: lobe.Settings, prepared: lobe.Prepared) -> None:
        try:
            self._result = lobe.render(
                scene, settings, progress=self._on_progress, stop=self._stop.is_set, prepared=prepared
            )
        except BaseException as error:  # raised again by outcome(), on the thread that can tell the user
            self._error = error
        finally:
            self._done = True
            self._news.set()

    def _on_progress(self, progress: lobe.Progress) -> None:
        self.progress = progress
        if self.picture_wanted:
            self._pixels = progress.pixels()
            self.picture_wanted = self._pixels is None
            if self._pixels is not None:
                self._news.set()

    def take_pixels(self) -> np.ndarray | None:
        """The newest picture that was wanted, once."""
        pixels, self._pixels = self._pixels, None
        return pixels

    def wait(self, seconds: float) -> bool:
        """Until a picture that was wanted is there, or the end, but no longer than that; True once it has ended."""
        self._news.wait(seconds)
        self._news.clear()
        return self._done

    def is_tracing(self) -> bool:
        """Whether it has got as far as samples: then it ends with a picture, also when it is cancelled."""
        return self.progress is not None and self.progress.is_tracing

    def stop(self, patience: float = 0.0) -> None:
        """Tell it to end, and wait for that for some seconds."""
        self._stop.set()
        self._thread.join(patience)

    def outcome(self) -> lobe.Result | None:
        """The result; None when the render was cancelled before it had any. Raises what the worker raised."""
        if not self._done:
            return None
        if self._error is not None:
            raise self._error
        return self._result


class _Picture:
    """The layer's place in Blender's render result."""

    def __init__(self, engine: bpy.types.RenderEngine, scene: lobe.Scene, layer: str):
        x0, y0, x1, y1 = scene.render_region
        self.engine = engine
        self.result = engine.begin_result(0, 0, x1 - x0, y1 - y0, layer=layer)
        # Blender clamps the rectangle to what it renders itself.
        self.shape = (self.result.resolution_y, self.result.resolution_x)

    def fill(self, passes: dict[str, np.ndarray], noisy: np.ndarray | None) -> None:
        """By the engine's names; `noisy` is Combined as it was traced, of a picture to be denoised. They are there once
        the picture is shown."""
        for pixels in passes.values():
            self._check(pixels)
        fill_passes(self.result.layers[0], passes, noisy)

    def _check(self, pixels: np.ndarray) -> None:
        if pixels.shape[:2] != self.shape:
            raise RuntimeError(f"the picture is {pixels.shape[:2]} pixels high and wide, Blender expects {self.shape}")

    def show(self, pixels: np.ndarray) -> None:
        self._check(pixels)
        flat = np.ascontiguousarray(pixels, dtype=np.float32).reshape(-1)
        for render_pass in self.result.layers[0].passes:
            if render_pass.name == "Combined":  # one for each view
                render_pass.rect.foreach_set(flat)
        self.engine.update_result(self.result)

    def close(self, discard: bool) -> None:
        self.engine.end_result(self.result, cancel=discard)


def _stamp(engine: bpy.types.RenderEngine, report: dict) -> None:
    """Metadata for the files that Blender writes."""
    result = engine.get_result()
    seconds = report["seconds"]
    for key, value in (
        ("samples", f"{report['samples']:g}"),
        ("rays", str(report["rays"])),
        ("render_time", _clock(seconds["render"])),
        ("export_time", _clock(seconds["export"])),
        ("road", report["road"].lower()),
    ):
        result.stamp_data_add_field(f"lobe.{key}", value)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(max(seconds, 0.0), 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02}:{seconds:05.2f}" if hours else f"{minutes:02}:{seconds:05.2f}"
