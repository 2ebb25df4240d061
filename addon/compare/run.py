"""One comparison, render by render: settings, two seeds of each engine, render slots, figures, and all of it put back.

Who renders is the caller: `Comparison.steps` stops before each render, which may block or run beside the window.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import bpy
import numpy as np

from .. import report, scene_report
from ..render_slots import render_result
from . import figures, flip, matching, pictures
from .figures import Figures, Timing
from .keeping import Keeper, listening
from .matching import CompareError

ENGINES = ("LOBE", "CYCLES")
NAMES = {"LOBE": "Lobe", "CYCLES": "Cycles"}
# (engine, which seed), the shown pictures last, since a slot holds one. A machine that gets slower hits both alike.
ORDER = (("LOBE", 1), ("CYCLES", 1), ("CYCLES", 0), ("LOBE", 0))
CYCLES_SEED = 1_000_000  # the engines must not share their random numbers


class Stopped(Exception):
    """The user has stopped a render."""


class Step(NamedTuple):
    """A render that is to be made now. layer: name of the only view layer to render, or empty."""

    number: int  # of all renders, from 1
    engine: str
    scene: str
    layer: str

    @property
    def text(self) -> str:
        """ "Cycles, 1 of 2" """
        engines = [engine for engine, _ in ORDER]
        of_engine = engines[: self.number].count(self.engine)
        return f"{NAMES[self.engine]}, {of_engine} of {engines.count(self.engine)}"


@dataclass(frozen=True)
class Outcome:
    """What the page and the panel show. Pictures are PNG files."""

    scene: str
    size: tuple[int, int]
    seconds: float  # of each engine's sampling, or 0: equal samples
    samples: dict[str, float]  # by engine; of Cycles at equal time as many as it has said, which is seldom: or 0
    times: dict[str, Timing]
    figures: Figures
    pictures: dict[str, bytes]  # "lobe", "cycles", "difference", "flip"
    difference_range: float
    changed: list[tuple[str, str, str]]
    unmatched: list[str]
    different: list[str]  # those of them with which the engines draw different things, and times don't compare
    threads: str


class _Watch:
    """Listens to one render: when it begins and ends, whether it is cancelled, how many samples it says to have."""

    def __init__(self) -> None:
        self.begun = self.ended = 0.0
        self.cancelled = False
        self.samples = 0
        self._listening = listening(
            render_init=self._begin,
            render_complete=self._end,
            render_cancel=self._cancel,
            render_stats=self._listen,
        )

    def __enter__(self) -> _Watch:
        self._listening.__enter__()
        return self

    def __exit__(self, *_) -> None:
        self._listening.__exit__(None, None, None)

    def _begin(self, *_) -> None:
        self.begun = time.perf_counter()

    def _end(self, *_) -> None:
        self.ended = time.perf_counter()

    def _cancel(self, *_) -> None:
        self.cancelled = True

    def _listen(self, text, *_) -> None:
        if found := re.search(r"[Ss]amples? (\d+)/\d+", str(text)):
            self.samples = int(found[1])


@dataclass(frozen=True)
class _Render:
    pixels: np.ndarray  # (h, w, 3) scene-linear
    seen: np.ndarray  # (h, w, 3) uint8
    samples: float
    timing: Timing


class Comparison:
    """Of a scene as it is now. seconds: for each engine, or 0: equal samples, those of Lobe's settings."""

    def __init__(self, scene, view_layer, seconds: float = 0.0) -> None:
        self.seconds = seconds
        self.outcome: Outcome | None = None  # this and the next at the end of `steps`
        self.strip: np.ndarray | None = None  # (h, w, 3) uint8: Lobe's picture, Cycles' and the difference
        self._name = scene.name
        self._uid = scene.session_uid
        several = sum(layer.use for layer in scene.view_layers) > 1
        self._layer = view_layer.name if several else ""

    @property
    def scene(self):
        """Found anew each time: a reference to it doesn't outlive an undo."""
        for scene in bpy.data.scenes:
            if scene.session_uid == self._uid:
                return scene
        raise CompareError(f"the scene {self._name!r} is gone")

    def steps(self) -> Iterator[Step]:
        """Stops at each render that is to be made. However it ends (also by `close`), settings are put back.

        Raises CompareError and Stopped.
        """
        renders: dict[tuple[str, int], _Render] = {}
        with Keeper() as keeper:
            before = scene_report.report_of(self.scene)
            keeper.at_end(lambda: scene_report.restore(self._uid, before))
            unmatched = matching.prepare(self.scene, keeper, self.seconds)
            if self._layer:
                unmatched.others.append(f"Of several view layers only {self._layer!r} is compared")
            settings = matching.changed(keeper.changes)
            slots = _Slots(keeper)
            seeds = _seeds(self.scene.lobe.seed)
            for number, (engine, which) in enumerate(ORDER, 1):
                self._choose(keeper, engine, seeds[engine][which])
                slots.choose(NAMES[engine])
                report.last_report.clear()
                with _Watch() as watch:
                    yield Step(number, engine, self._name, self._layer)
                if keeper.undone:  # which also ends a render that is under way
                    raise CompareError("a step was undone or redone meanwhile")
                if watch.cancelled:
                    raise Stopped
                slots.found(NAMES[engine])
                renders[engine, which] = self._take(engine, watch)
            different, nearly = matching.not_drawn(self.scene)
            unmatched.different.extend(different)
            unmatched.others.extend(nearly)
            self.outcome = self._measured(renders, settings, unmatched)

    def _choose(self, keeper: Keeper, engine: str, seed: int) -> None:
        scene = self.scene
        try:
            keeper.put(scene.render, "engine", engine)
        except TypeError as error:
            raise CompareError(f"this Blender has no engine {NAMES[engine]}") from error
        keeper.put(scene.lobe if engine == "LOBE" else scene.cycles, "seed", seed)

    def _take(self, engine: str, watch: _Watch) -> _Render:
        """What the render has left behind."""
        scene = self.scene
        total = watch.ended - watch.begun
        if engine == "LOBE" and not report.last_report:
            raise CompareError("Lobe ended without a picture: see what it reported")
        if engine == "LOBE" and report.last_report["stopped"]:
            raise Stopped
        try:
            pixels, metadata = pictures.rendered(scene)
        except RuntimeError as error:
            raise CompareError(f"{NAMES[engine]} ended without a picture ({error})") from error
        if engine == "LOBE":
            seconds = report.last_report["seconds"]
            timing = Timing(total - seconds["compile"], seconds["render"])
            samples = report.last_report["samples"]
        else:
            sampling = cycles_seconds(metadata, "render_time")
            if sampling is None:
                raise CompareError("Cycles ended without a picture: see the console")
            timing = Timing(total, sampling)
            samples = float(watch.samples if self.seconds else scene.cycles.samples)
        return _Render(pixels[..., :3], pictures.seen(scene), samples, timing)

    def _measured(self, renders, settings, unmatched: matching.Unmatched) -> Outcome:
        shown = {engine: renders[engine, 0] for engine in ENGINES}
        lobe, cycles = (np.stack([renders[engine, which].pixels for which in (0, 1)]) for engine in ENGINES)
        timings = {engine: (renders[engine, 0].timing, renders[engine, 1].timing) for engine in ENGINES}
        times = {engine: _quicker(*pair) for engine, pair in timings.items()}
        flipped = flip.flip_map(shown["CYCLES"].seen, shown["LOBE"].seen)
        found = figures.measure(
            lobe, cycles, (times["LOBE"], times["CYCLES"]), float(flipped.mean()),
            figures.wander([timings[engine] for engine in ENGINES]),
        )  # fmt: skip
        apart = pictures.relative_difference(lobe, cycles)
        end = pictures.map_range(apart)
        difference = pictures.colored(apart, -end, end, pictures.SIGNS)
        self.strip = pictures.strip(shown["LOBE"].seen, shown["CYCLES"].seen, difference)
        unmatched.others.extend(
            f"Both renders of {NAMES[engine]} are the same, so its noise isn't known: is its seed animated?"
            for engine, noise in zip(ENGINES, (found.noise_lobe, found.noise_cycles), strict=True)
            if np.isnan(noise)
        )
        if times["CYCLES"].sampling < figures.SHORTEST:
            unmatched.others.append("The renders are too short to be timed: take more samples")
        return Outcome(
            scene=self._name,
            size=(shown["LOBE"].seen.shape[1], shown["LOBE"].seen.shape[0]),
            seconds=self.seconds,
            samples={engine: render.samples for engine, render in shown.items()},
            times=times,
            figures=found,
            pictures={
                "lobe": pictures.png(shown["LOBE"].seen),
                "cycles": pictures.png(shown["CYCLES"].seen),
                "difference": pictures.png(difference),
                "flip": pictures.png(pictures.colored(flipped, 0.0, 1.0, pictures.MAGMA)),
            },
            difference_range=end,
            changed=settings,
            unmatched=unmatched.different + unmatched.others,
            different=unmatched.different,
            threads=str(self.scene.render.threads),
        )


def _seeds(seed: int) -> dict[str, tuple[int, int]]:
    """Of the picture that is shown, and of another one. Lobe's is the user's; Cycles takes none below 0."""
    cycles = seed % (1 << 30) + CYCLES_SEED
    return {"LOBE": (seed, seed + (1 if seed < (1 << 31) - 1 else -1)), "CYCLES": (cycles, cycles + 1)}


def _quicker(a: Timing, b: Timing) -> Timing:
    return min(a, b, key=lambda timing: timing.total)


def cycles_seconds(metadata: dict, name: str) -> float | None:
    """Of a phase of Cycles', which it writes into the picture for each view layer, as a clock: "01:02.34"."""
    values = [v for k, v in metadata.items() if k.startswith("cycles.") and k.endswith(f".{name}")]
    return sum(clock_seconds(str(value)) for value in values) if values else None


def clock_seconds(text: str) -> float:
    """Seconds of "01:02.34" or "1:01:02.34"."""
    seconds = 0.0
    for part in text.split(":"):
        seconds = seconds * 60 + float(part)
    return seconds


class _Slots:
    """Two slots of the Render Result, "Lobe" and "Cycles", beside those that the user has."""

    def __init__(self, keeper: Keeper) -> None:
        image = render_result()
        self._fresh = image is None  # the very first render makes it: then nobody has put anything into its slots
        if image is not None:
            before = image.render_slots.active_index
            keeper.at_end(lambda: self._activate(before))

    @staticmethod
    def _activate(index: int) -> None:
        image = render_result()
        if image is not None and index < len(image.render_slots):
            image.render_slots.active_index = index

    def choose(self, name: str) -> None:
        """Before a render: make the slot of that name the active one."""
        image = render_result()
        if image is None:
            return
        slots = image.render_slots
        index = _index(slots, name)
        if index < 0 and self._fresh and len(slots) > 1:
            index = 1  # the second of the fresh ones
            slots[index].name = name
        elif index < 0:
            slots.new(name=name)
            index = len(slots) - 1
        slots.active_index = index

    def found(self, name: str) -> None:
        """After a render: the first one of all has gone into the first slot."""
        image = render_result()
        if image is not None and self._fresh and _index(image.render_slots, name) < 0:
            image.render_slots[image.render_slots.active_index].name = name


def _index(slots, name: str) -> int:
    """The first slot of that name, or -1. Blender's own `find` finds none (measured in 5.0)."""
    return next((index for index, slot in enumerate(slots) if slot.name == name), -1)
