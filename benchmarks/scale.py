"""How Lobe's time and memory grow with a scene, and how its time falls with threads.

    python benchmarks/scale.py triangles   # 1e3 to 1e7: render time; time until the first sample beside Cycles'
    python benchmarks/scale.py memory      # the same scenes: the most memory, beside Cycles'
    python benchmarks/scale.py instances   # half a million: export; time until the first sample beside Cycles'
    python benchmarks/scale.py emitters    # 1e2 to 1e5 lamps, and emissive triangles: render time
    python benchmarks/scale.py listed      # lamps around the limits of the engine's list: listed, or Embree's
    python benchmarks/scale.py threads     # the sample scenes on one thread and on two
    python benchmarks/scale.py all

What is compared is rendered in turn, round by round, in one process; ratios are of one round, and a column gives their
median with the smallest and the largest. "render" is the phase in which samples are taken. The time until the first
sample is that of a picture of 4 x 4 pixels and one sample, from pressing F12 to the end, less "evaluation": the same
with an engine that does nothing, which neither can avoid. Of so many triangles that the engine has Embree's compact
leaves, which are slower to trace, the render is also made with full ones, as smaller scenes have them: the step between
the two is told from what the number itself costs. Memory is the most that a process holds which makes the scene and
renders it once, from the end of the making on. Tables go to benchmarks/results/scale_*.csv and .md.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import common
import numpy as np
import scale_scenes as scenes
from common import br
from tqdm import tqdm

from tools import metrics
from tools.render import resolution, whole_number

TRIANGLES = (10**3, 10**4, 10**5, 10**6, 10**7)
INSTANCES = 500_000
EMITTERS = (10**2, 10**3, 10**4, 10**5)  # at most scale_scenes.SMALL_TRIANGLES
ENGINES = ("IDLE", "LOBE", "CYCLES")
BYTES_A_TRIANGLE = 400  # of memory, roughly: all scenes of `triangles`, and the engine that needs more
FULL = "the same, full leaves"
CROWD = 64  # threads that ask for tiles
EMPTY_TILES = 4096
Rounds = dict[Any, list[dict]]


# --- measuring ------------------------------------------------------------------------------------------------


def in_turn(steps: dict[Hashable, Callable[[], dict]], runs: int, name: str) -> Rounds:
    """What each step gives in each of so many rounds. They go forth and back, after one round that warms up."""
    found: Rounds = {key: [] for key in steps}
    with tqdm(total=(runs + 1) * len(steps), desc=name, file=sys.stderr) as bar:
        for run, key in common.in_turn(tuple(steps), runs + 1):
            bar.set_postfix_str(" ".join(map(str, key)) if isinstance(key, tuple) else str(key))
            result = steps[key]()
            if run:
                found[key].append(result)
            bar.update()
    return found


def render(scene, engine: str, size: tuple[int, int], samples: int, threads: int) -> dict:
    """The report of a render."""
    br.set_resolution(scene, *size)
    br.set_threads(scene, threads)
    scene.lobe.samples = samples
    br.set_engine(scene, engine)
    return br.render(scene)


def add_idle_engine() -> None:
    """The engine IDLE: takes part in everything that Blender does for a render, and traces nothing."""
    import bpy

    class IdleEngine(bpy.types.RenderEngine):
        bl_idname, bl_label = "IDLE", "Idle"

        def render(self, depsgraph):
            self.end_result(self.begin_result(0, 0, self.resolution_x, self.resolution_y))

    bpy.utils.register_class(IdleEngine)


def seconds(reports: list[dict], phase: str) -> np.ndarray:
    return np.array([report["seconds"][phase] for report in reports])


def first_sample(scene, options: argparse.Namespace) -> dict[str, Callable[[], dict]]:
    """For each engine the render that is nearly all preparation."""
    return {engine: partial(render, scene, engine, (4, 4), 1, options.threads) for engine in ENGINES}


# --- figures --------------------------------------------------------------------------------------------------


def ratio_text(numerators: Sequence[float] | np.ndarray, denominators: Sequence[float] | np.ndarray) -> str:
    """Of measurements in turn the median ratio, the smallest and the largest: "1.23 (1.20 to 1.25)"."""
    return "{:.2f} ({:.2f} to {:.2f})".format(*metrics.median_ratio(numerators, denominators))


def short(number: int) -> str:
    """As in "5e5"."""
    return f"{number:.0e}".replace("e+0", "e")


def growth(counts: Sequence[int], values: Sequence[float]) -> list[float]:
    """From each row to the next, the power of the count with which the value grows: 1 is linear. nan for the first."""
    steps = np.diff(np.log(values)) / np.diff(np.log(counts))
    return [math.nan, *map(float, steps)]


def affordable(counts: Sequence[int], memory: float) -> list[int]:
    """The first of `counts` that fit a memory of so many bytes."""
    return [count for count in counts if count * BYTES_A_TRIANGLE <= memory]


def preparation(found: dict[str, list[dict]]) -> dict[str, str]:
    """Columns about the time until the first sample, of the rounds of each engine."""
    idle, lobe, cycles = (seconds(found[engine], "total") for engine in ENGINES)
    return {
        "evaluation, s": f"{np.median(idle):.3f}",
        "Lobe: export, s": f"{np.median(seconds(found['LOBE'], 'export')):.3f}",
        "Lobe: build, s": f"{np.median(seconds(found['LOBE'], 'build')):.3f}",
        "Lobe, s": f"{np.median(own(lobe, idle)):.3f}",
        "Cycles, s": f"{np.median(own(cycles, idle)):.3f}",
        "Lobe / Cycles": ratio_text(own(lobe, idle), own(cycles, idle)),
    }


def own(engine: np.ndarray, idle: np.ndarray) -> np.ndarray:
    """Seconds of an engine without those that Blender takes."""
    return np.maximum(engine - idle, 1e-6)


# --- questions ------------------------------------------------------------------------------------------------


def triangles(options: argparse.Namespace) -> str:
    counts = options.triangles
    steps: dict[Hashable, Callable[[], dict]] = {}
    for count in counts:
        scene = scenes.terrain(count)
        steps |= {(short(count), engine): step for engine, step in first_sample(scene, options).items()}
        steps[short(count), "render"] = partial(
            render, scene, "LOBE", options.resolution, options.samples, options.threads
        )
        if has_compact_leaves(count):
            steps[short(count), FULL] = partial(render_with_full_leaves, scene, options)
    found = in_turn(steps, options.runs, "triangles")
    rows = triangle_rows(counts, found, options)
    return common.update_table(
        "scale_triangles", ("triangles", "threads"), rows, folder=options.results, note=triangle_note(counts, found)
    )


def has_compact_leaves(count: int) -> bool:
    """Whether the engine takes those leaves of Embree's for a terrain that need less memory and are slower."""
    from bl_ext.user_default.lobe.engine import accel

    return scenes.terrain_triangles(count) > accel._MOST_IN_FULL


def render_with_full_leaves(scene, options: argparse.Namespace) -> dict:
    from bl_ext.user_default.lobe.engine import accel

    with mock.patch.object(accel, "_MOST_IN_FULL", math.inf):
        return render(scene, "LOBE", options.resolution, options.samples, options.threads)


def triangle_rows(counts: Sequence[int], found: Rounds, options: argparse.Namespace) -> list[dict]:
    """found: the rounds of ("1e3", "LOBE") and so on, of ("1e3", "render"), and of ("1e7", FULL) where the engine takes
    compact leaves."""
    base = seconds(found[short(counts[0]), "render"], "render")
    of_engines = [{engine: found[short(count), engine] for engine in ENGINES} for count in counts]
    first = [np.median(own(seconds(e["LOBE"], "total"), seconds(e["IDLE"], "total"))) for e in of_engines]
    return [
        {
            "triangles": short(count),
            "exactly": scenes.terrain_triangles(count),
            "rounds": options.runs,
            "threads": options.threads,
            f"render / that of {short(counts[0])}": ratio_text(seconds(found[short(count), "render"], "render"), base),
            FULL: ratio_text(seconds(full, "render"), base) if (full := found.get((short(count), FULL))) else "",
            **preparation(engines),
            "Lobe grows with the power": "" if math.isnan(power) else f"{power:.2f}",
            "wanted": "Lobe / Cycles at most 1",
        }
        for count, engines, power in zip(counts, of_engines, growth(counts, first), strict=True)
    ]


def triangle_note(counts: Sequence[int], found: Rounds) -> str:
    """How render time grows, in a sentence; and what is left out."""
    base = seconds(found[short(counts[0]), "render"], "render")
    ratios = [metrics.median_ratio(seconds(found[short(c), "render"], "render"), base)[0] for c in counts]
    text = ""
    if len(counts) > 1:
        start, slope, worst = metrics.logarithm(counts, ratios)
        text = (
            f"Render time is {start:.2f} + {slope:.3f} log10(triangles / {short(counts[0])}) times that of "
            f"{short(counts[0])}, by least squares; no figure is farther from that than {worst:.0%}.\n\n"
        )
    missing = [short(count) for count in TRIANGLES if count not in counts]
    return text + (f"Left out, for want of memory or by `--largest`: {', '.join(missing)}.\n\n" if missing else "")


def memory(options: argparse.Namespace) -> str:
    of_kind = [("triangles", count) for count in options.triangles]
    of_kind += [("instances", count) for count in (INSTANCES,) if count <= options.largest]
    steps: dict[Hashable, Callable[[], dict]] = {
        (kind, short(count), engine): partial(child, kind, count, engine, options.threads)
        for kind, count in of_kind
        for engine in ENGINES
    }
    found = in_turn(steps, options.runs, "memory")
    rows = []
    for kind, count in of_kind:
        idle, lobe, cycles = (np.array([r["peak"] for r in found[kind, short(count), engine]]) for engine in ENGINES)
        rows.append({
            "scene": kind,
            "number": short(count),
            "rounds": options.runs,
            "threads": options.threads,
            "nothing, MB": f"{np.median(idle):.0f}",
            "Lobe, MB": f"{np.median(lobe):.0f}",
            "Cycles, MB": f"{np.median(cycles):.0f}",
            "Lobe / Cycles": ratio_text(lobe, cycles),
            "Lobe - Cycles, MB": f"{np.median(lobe - cycles):.0f}",
            "wanted": "Lobe / Cycles at most 1",
        })  # fmt: skip
    return common.update_table("scale_memory", ("scene", "number", "threads"), rows, folder=options.results)


def instances(options: argparse.Namespace) -> str:
    count = min(INSTANCES, options.largest)
    found = in_turn(dict(first_sample(scenes.instances(count), options)), options.runs, "instances")
    row = {
        "instances": short(count),
        "rounds": options.runs,
        "threads": options.threads,
        **preparation(found),
        "wanted": "export below 2 s",
    }
    return common.update_table("scale_instances", ("instances", "threads"), [row], folder=options.results)


def emitters(options: argparse.Namespace) -> str:
    kinds = ("lamps", "emissive triangles")
    counts = [count for count in EMITTERS if count <= options.largest]
    steps: dict[Hashable, Callable[[], dict]] = {
        (kind, short(count)): partial(
            render, scenes.MAKERS[kind](count), "LOBE", options.resolution, options.samples, options.threads
        )
        for kind in kinds
        for count in counts
    }
    found = in_turn(steps, options.runs, "emitters")
    rows = []
    for kind, count in ((kind, count) for kind in kinds for count in counts):
        own_rounds, base = found[kind, short(count)], found[kind, short(counts[0])]
        rows.append({
            "emitters": kind,
            "number": short(count),
            "rounds": options.runs,
            "threads": options.threads,
            f"render / that of {short(counts[0])}": ratio_text(seconds(own_rounds, "render"), seconds(base, "render")),
            "Lobe: export, s": f"{np.median(seconds(own_rounds, 'export')):.3f}",
            "Lobe: build, s": f"{np.median(seconds(own_rounds, 'build')):.3f}",
            "wanted": "at most 1.5" if count == EMITTERS[-1] else "",
        })  # fmt: skip
    return common.update_table("scale_emitters", ("emitters", "number", "threads"), rows, folder=options.results)


def listed(options: argparse.Namespace) -> str:
    """The same lamps asked one after the other, and met in Embree's scene: above 1 the list is the slower."""
    cases = [
        (kind, count, limit) for kind, limit in limits_of_lists().items() for count in around(limit)
        if count <= options.largest
    ]  # fmt: skip
    steps: dict[Hashable, Callable[[], dict]] = {
        (kind, count, way): partial(render_with_lists, scene, most, options)
        for kind, count, _ in cases
        for scene in [scenes.MAKERS[kind](count)]
        for way, most in (("listed", count), ("traced", 0))
    }
    found = in_turn(steps, options.runs, "listed")
    rows = [
        {
            "lamps": kind,
            "number": count,
            "rounds": options.runs,
            "threads": options.threads,
            "render, listed / in Embree's scene": ratio_text(
                *(seconds(found[kind, count, way], "render") for way in ("listed", "traced"))
            ),
            "the engine": "lists them" if count <= limit else "has them in Embree's scene",
            "wanted": "at most 1" if count <= limit else "at least 1",
        }
        for kind, count, limit in cases
    ]
    return common.update_table("scale_listed", ("lamps", "number", "threads"), rows, folder=options.results)


def limits_of_lists() -> dict[str, int]:
    """Up to how many lamps of a kind the engine asks one after the other."""
    from bl_ext.user_default.lobe.engine.pack import lamps

    return {"lamps": lamps.MOST_LISTED_ROUND, "area lamps": lamps.MOST_LISTED_FLAT}


def around(limit: int) -> list[int]:
    """Numbers of lamps on both sides of it, and it itself."""
    return [limit * part // 4 for part in (1, 2, 4, 8, 16)]


def render_with_lists(scene, most: int, options: argparse.Namespace) -> dict:
    """The report of a render by an engine whose lists hold so many lamps at most."""
    from bl_ext.user_default.lobe.engine.pack import lamps

    with mock.patch.multiple(lamps, MOST_LISTED_ROUND=most, MOST_LISTED_FLAT=most):
        return render(scene, "LOBE", options.resolution, options.samples, options.threads)


def threads(options: argparse.Namespace) -> str:
    """Beside two threads of one process stand two processes, which share nothing but the machine: what they don't
    reach, as where two processors are one core's, threads can't. Only one thread at a time has Python's lock, so what a
    tile needs of it limits how many threads find work: a render of one thread takes so many times as long."""
    rows = []
    for name in common.SCENES:
        scene = common.prepare(common.scene_path(name), options.resolution, 2)
        steps: dict[Hashable, Callable[[], dict]] = {
            f"{n} threads": partial(render, scene, "LOBE", options.resolution, options.samples, n) for n in (1, 2)
        }
        with contextlib.ExitStack() as stack:
            pair = [stack.enter_context(Apart(name, options)) for _ in range(2)]
            steps["a process"] = partial(longest, pair[:1])
            steps["two processes"] = partial(longest, pair)
            found = in_turn(steps, options.runs, name)
        one, two, alone, beside = (seconds(reports, "render") for reports in found.values())
        tiles, by_one, by_many = handing_out(name, options)
        rows.append({
            "scene": name,
            "resolution": "{}x{}".format(*options.resolution),
            "samples": options.samples,
            "pairs": options.runs,
            "render, one thread / two": ratio_text(one, two),
            "two processes' work in the time of one's": ratio_text(2 * alone, beside),
            "tiles": tiles,
            "under Python's lock, µs a tile": f"{by_one * 1e6:.0f}",
            f"the same, {CROWD} threads": f"{by_many * 1e6:.0f}",
            "of one thread's render": f"{tiles * by_one / np.median(one):.2%}",
            "enough for, threads": f"{np.median(one) / (tiles * max(by_one, by_many)):.0f}",
            "wanted": "at least 1.9",
        })  # fmt: skip
    return common.update_table("scale_threads", ("scene", "resolution", "samples"), rows, folder=options.results)


def handing_out(name: str, options: argparse.Namespace) -> tuple[int, float, float]:
    """(tiles of a render of a sample scene, seconds for each tile without pixels that one thread takes, and of those
    that many take at the same time)"""
    from benchmarks import ceiling

    scene, settings = ceiling.export(name, options.resolution, options.samples, 1)
    from bl_ext.user_default.lobe.engine import schedule, tiles
    from bl_ext.user_default.lobe.engine.film import Film
    from bl_ext.user_default.lobe.engine.pack import pack

    packed, film = pack(scene, settings), Film(scene.render_region, scene.exposure)
    passes = schedule.schedule(settings.samples, film.samples.size)
    count = sum(len(list(tiles.tiles_of(film.region, samples))) for _, samples in passes)

    def empty(thread_count: int) -> float:
        shared = tiles.Shared(iter([(0, 0, 0, 0)] * EMPTY_TILES))
        work = (packed, settings, film, None, shared, 0, 1, np.zeros(1, np.uint8))
        with ThreadPoolExecutor(thread_count) as pool:
            begun = time.perf_counter()
            for future in [pool.submit(tiles.render_tiles, *work) for _ in range(thread_count)]:
                future.result()
            return (time.perf_counter() - begun) / EMPTY_TILES

    empty(1)  # loads the kernel
    by_one, by_many = (float(np.median([empty(number) for _ in range(options.runs)])) for number in (1, CROWD))
    return count, by_one, by_many


class Apart:
    """A process of its own that renders a sample scene on one thread whenever it is told to."""

    def __init__(self, name: str, options: argparse.Namespace):
        size = "{}x{}".format(*options.resolution)
        words = [sys.executable, __file__, "threads", "--apart", name, "--resolution", size]
        command = [*words, "--samples", str(options.samples)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def __enter__(self) -> Apart:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def begin(self) -> None:
        assert self._process.stdin is not None
        print(file=self._process.stdin, flush=True)

    def end(self) -> float:
        """Seconds that the render took."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise br.ToolError("a render in a process of its own failed")
        return float(line)


def longest(processes: Sequence[Apart]) -> dict:
    """A report of renders at the same time."""
    for process in processes:
        process.begin()
    return {"seconds": {"render": max(process.end() for process in processes)}}


def as_apart(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    scene = common.prepare(common.scene_path(options.apart), options.resolution, 1)
    for _ in sys.stdin:
        report = render(scene, "LOBE", options.resolution, options.samples, 1)
        say(str(report["seconds"]["render"]))


# --- memory, in a process of its own --------------------------------------------------------------------------


def child(kind: str, count: int, engine: str, thread_count: int) -> dict:
    """{"peak": MB} of a process that makes a scene and renders it with an engine."""
    words = [sys.executable, __file__, "memory", "--child", kind, str(count), engine, "--threads", str(thread_count)]
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        raise br.ToolError(f"a render of {count} {kind} with {engine} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def as_child(kind: str, count: str, engine: str, thread_count: int) -> dict:
    scenes.empty_file()
    scene = scenes.MAKERS[kind](int(count))
    forget_peak()
    render(scene, engine, (64, 64), 1, thread_count)
    return {"peak": peak_mb()}


def forget_peak() -> None:
    """What making the scene took does not count. Elsewhere than on Linux it does, for all engines alike."""
    if sys.platform == "linux":
        Path("/proc/self/clear_refs").write_text("5")


def peak_mb() -> float:
    """Resident memory of this process at its highest. On Linux not `ru_maxrss`: that starts with what the process held
    that this one was forked from, and nothing lowers it."""
    if sys.platform != "linux":
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20)
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


# --- command line ---------------------------------------------------------------------------------------------

QUESTIONS = {
    "triangles": triangles, "memory": memory, "instances": instances, "emitters": emitters, "listed": listed,
    "threads": threads,
}  # fmt: skip


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("question", nargs="?", choices=[*QUESTIONS, "all"], default="all")
    parser.add_argument("--runs", type=whole_number(1, 1000), default=5, metavar="N", help="rounds; default: 5")
    parser.add_argument("--threads", type=whole_number(1, 1024), default=2, metavar="N",
                        help="not of the question `threads`; default: 2")  # fmt: skip
    parser.add_argument("--resolution", type=resolution, default=(256, 256), metavar="WxH", help="default: 256x256")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), default=64, metavar="N", help="default: 64")
    parser.add_argument("--largest", type=whole_number(100, 10**9), default=10**9, metavar="N",
                        help="no scene with a larger number of triangles, instances or emitters")  # fmt: skip
    common.add_results(parser)
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("--apart", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    fits = affordable(TRIANGLES, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    options.triangles = [count for count in fits if count <= options.largest] or [TRIANGLES[0]]
    return options


def main() -> int:
    return common.run(work, parse())


def work(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    add_idle_engine()
    if options.child:
        say(json.dumps(as_child(*options.child, options.threads)))
        return
    if options.apart:
        as_apart(options, say)
        return
    for name in QUESTIONS if options.question == "all" else (options.question,):
        scenes.empty_file()
        say(QUESTIONS[name](options))


if __name__ == "__main__":
    sys.exit(main())
