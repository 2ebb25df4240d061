"""How near Lobe is to its ceiling: the time of a render beside that of its rays alone.

Tracing is Embree's work, and sampling cannot be faster than it. So a render's rays are recorded, by standing in for
the functions of Embree that kernels call, and then replayed: the same rays in the same order, one by one, with the same
filter for lamps, and nothing between them but copying the next ray. That copying, from a recording larger than any
cache, no render does: the same loop around a function that does nothing is timed too, and taken off. Packets, which
kernels trace where they can, take less than their rays one by one, so a render can take less than its replay.
All are timed in turn, on the same number of threads, and each replayed ray is asked whether it hits what it hit in the
render. `tools/bench.py --ceiling` prints the table.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import llvmlite.binding as llvm
import numba
import numpy as np
from numba import carray
from tqdm import tqdm

from benchmarks import common
from tools import metrics

# A record: the words of Embree's RTCRay, then which call it went to, and whether it hit something.
RAY_WORDS, CALL, HIT, RECORD_WORDS = 12, 12, 13, 14
TFAR, ID = 8, 10
INTERSECT, INTERSECT_NOTING_LAMPS, OCCLUDED = 0, 1, 2
MOST_RAYS = 1 << 24  # 940 MB
WANTED = 1.25  # render / replay, at most
MOST_OTHERS = 1e-3  # share of rays that may end otherwise when they are replayed
SAMPLES = 16
CHUNK = 1 << 12  # rays that a thread takes at a time, about as many as a tile of a render has


@dataclass(frozen=True)
class Recording:
    """records (rays, RECORD_WORDS) uint32, in the order in which one thread traced them."""

    records: np.ndarray

    @property
    def shadow_share(self) -> float:
        return float(np.mean(self.records[:, CALL] == OCCLUDED))

    @property
    def hits(self) -> int:
        """Rays that met something in the render."""
        return int(np.count_nonzero(self.records[:, HIT]))


def measure(name: str, resolution: tuple[int, int], samples: int, threads: int, runs: int) -> dict:
    """A row of the table for a sample scene, or a file. `common.enable_lobe()` has been called."""
    from bl_ext.user_default.lobe.engine import render
    from bl_ext.user_default.lobe.engine.pack import pack

    scene, settings = export(name, resolution, samples, threads)
    recording = record(scene, settings)
    packed = pack(scene, settings, np.zeros(1, np.uint8))
    others = agreeing(differing(recording, packed), recording)
    steps: dict[str, Callable[[], float]] = {
        "render": lambda: render(scene, settings).seconds["render"],
        "replay": lambda: replay(recording, packed, threads, others),
        "copying": lambda: copying(recording, packed, threads),
    }
    times: dict[str, list[float]] = {what: [] for what in steps}
    for _, what in common.in_turn(tuple(steps), runs):
        times[what].append(steps[what]())
    rays_alone = without_copying(times["replay"], times["copying"])
    median, low, high = metrics.median_ratio(times["render"], rays_alone)
    return {
        "scene": Path(name).stem,
        "resolution": "{}x{}".format(*resolution),
        "samples": samples,
        "threads": threads,
        "pairs": runs,
        "M rays": f"{len(recording.records) / 1e6:.2f}",
        "shadow rays": f"{recording.shadow_share:.0%}",
        "rays that end otherwise": f"{others / len(recording.records):.1e}",
        "copying, taken off the replay": f"{1 - np.median(rays_alone / times['replay']):.1%}",
        "render / replay": f"{median:.2f} ({low:.2f} to {high:.2f})",
        "wanted: at most": f"{WANTED:.2f}",
    }


def export(name: str, resolution: tuple[int, int], samples: int, threads: int):
    """(engine.Scene, engine.Settings) of a sample scene with a box filter and no adaptive sampling."""
    return export_open(common.prepare(common.scene_path(name), resolution, threads), samples)


def export_open(blend, samples: int):
    """The same of the scene that is in Blender's window."""
    import bpy
    from bl_ext.user_default.lobe.addon.export import export_scene, export_settings

    blend.lobe.samples = samples
    settings = export_settings(blend)
    return export_scene(bpy.context.evaluated_depsgraph_get()), replace(settings, use_adaptive_sampling=False)


def record(scene, settings) -> Recording:
    """All rays of a render, by one thread."""
    from bl_ext.user_default.lobe.engine import render

    records, count = np.empty((MOST_RAYS, RECORD_WORDS), np.uint32), np.zeros(1, np.int64)
    with _instead_of_embree(records, count):
        result = render(scene, replace(settings, threads=1))
    if count[0] != result.rays or result.rays > MOST_RAYS:
        raise RuntimeError(f"{count[0]} rays were recorded of {result.rays}: take fewer samples, or a smaller picture")
    return Recording(records[: count[0]].copy())


@contextlib.contextmanager
def _instead_of_embree(records: np.ndarray, count: np.ndarray) -> Iterator[None]:
    """Kernels that are loaded in here call functions that write down each ray and hand it on to Embree.

    Compiled code looks its outer functions up by name when it is loaded, so that is what has to happen again.
    """
    from bl_ext.user_default.lobe.engine import tiles
    from bl_ext.user_default.lobe.engine.kernels.embree import INTERSECT_PACKET, OCCLUDED_PACKET, library

    names = "rtcIntersect1", "rtcOccluded1", INTERSECT_PACKET, OCCLUDED_PACKET
    real = {name: ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0 for name in names}
    stand_in = {
        name: (_recorder if name.endswith("1") else _packet_recorder)(name, real[name], records, count)
        for name in names
    }
    try:
        for name in names:
            llvm.add_symbol(name, stand_in[name].address)
        tiles.tile_kernel.cache_clear()
        yield
    finally:
        for name in names:
            llvm.add_symbol(name, real[name])
        tiles.tile_kernel.cache_clear()


def _is_null(typing_context, pointer):
    """Of a pointer, in compiled code."""

    def codegen(context, builder, signature, args):
        return builder.icmp_unsigned("==", args[0], args[0].type(None))

    return numba.types.boolean(numba.types.voidptr), codegen


def _recorder(name: str, real_address: int, records: np.ndarray, count: np.ndarray):
    """A C function to call in place of the one of Embree's."""
    from bl_ext.user_default.lobe.engine.kernels.embree import GEOM_ID, INVALID, _pointer

    llvm.add_symbol(f"recorded_{name}", real_address)
    real = numba.types.ExternalFunction(
        f"recorded_{name}", numba.void(numba.types.voidptr, numba.types.voidptr, numba.types.voidptr)
    )
    to_records, to_count, room = records.ctypes.data, count.ctypes.data, len(records)
    shadow, is_null = name == "rtcOccluded1", numba.extending.intrinsic(_is_null)
    hit_words, geometry_id, invalid = GEOM_ID + 1, GEOM_ID, INVALID

    @numba.cfunc("void(voidptr, voidptr, voidptr)")
    def note(scene, ray, arguments):
        counter = carray(_pointer(np.uintp(to_count)), 1, np.int64)
        place = counter[0]
        counter[0] += 1
        if place < room:
            words = carray(ray, RAY_WORDS, np.uint32)
            kept = carray(_pointer(np.uintp(to_records + place * RECORD_WORDS * 4)), RECORD_WORDS, np.uint32)
            for i in range(RAY_WORDS):
                kept[i] = words[i]
            kept[ID] = 0
            if shadow:
                kept[CALL] = OCCLUDED
            else:
                kept[CALL] = INTERSECT if is_null(arguments) else INTERSECT_NOTING_LAMPS  # type: ignore[call-arg]
        real(scene, ray, arguments)
        if place < room:
            kept = carray(_pointer(np.uintp(to_records + place * RECORD_WORDS * 4)), RECORD_WORDS, np.uint32)
            if shadow:
                kept[HIT] = carray(ray, RAY_WORDS, np.uint32)[TFAR] >> 31
            else:
                kept[HIT] = carray(ray, hit_words, np.uint32)[geometry_id] != invalid

    return note


def _packet_recorder(name: str, real_address: int, records: np.ndarray, count: np.ndarray):
    """As `_recorder`, for packets: their rays become single ones, in the order in which they lie there. They are
    replayed so too: rays that come one by one are the ceiling, and packets a way past it."""
    from bl_ext.user_default.lobe.engine.kernels.embree import (
        GEOM_ID,
        INVALID,
        OCCLUDED_PACKET,
        PACKET_WIDTH,
        _pointer,
    )

    pointer_type = numba.types.voidptr
    llvm.add_symbol(f"recorded_{name}", real_address)
    real = numba.types.ExternalFunction(f"recorded_{name}", numba.void(*[pointer_type] * 4))
    to_records, to_count, room = records.ctypes.data, count.ctypes.data, len(records)
    shadow = name == OCCLUDED_PACKET
    call = OCCLUDED if shadow else INTERSECT_NOTING_LAMPS
    hit_words, geometry_id, invalid = (GEOM_ID + 1) * PACKET_WIDTH, GEOM_ID, INVALID

    @numba.cfunc("void(voidptr, voidptr, voidptr, voidptr)")
    def note(valid, scene, packet, arguments):
        counter, marks = carray(_pointer(np.uintp(to_count)), 1, np.int64), carray(valid, PACKET_WIDTH, np.int32)
        words = carray(packet, RAY_WORDS * PACKET_WIDTH, np.uint32)
        first = counter[0]
        for lane in range(PACKET_WIDTH):
            if marks[lane]:
                place = counter[0]
                counter[0] += 1
                if place < room:
                    kept = carray(_pointer(np.uintp(to_records + place * RECORD_WORDS * 4)), RECORD_WORDS, np.uint32)
                    for i in range(RAY_WORDS):
                        kept[i] = words[i * PACKET_WIDTH + lane]
                    kept[ID], kept[CALL] = 0, call
        real(valid, scene, packet, arguments)
        place = first
        for lane in range(PACKET_WIDTH):
            if marks[lane]:
                if place < room:
                    kept = carray(_pointer(np.uintp(to_records + place * RECORD_WORDS * 4)), RECORD_WORDS, np.uint32)
                    if shadow:
                        kept[HIT] = words[TFAR * PACKET_WIDTH + lane] >> 31
                    else:
                        hits = carray(packet, hit_words, np.uint32)
                        kept[HIT] = hits[geometry_id * PACKET_WIDTH + lane] != invalid
                place += 1

    return note


def replay(recording: Recording, packed, threads: int, others: int) -> float:
    """Seconds for the recorded rays, copied and traced by Embree, on so many threads. others: how many of them may end
    otherwise; if more do, what was timed wasn't the render's rays."""
    seconds, hits = timed(_replay_kernel(False), recording, packed, threads)
    if abs(hits - recording.hits) > others:
        raise RuntimeError(f"{hits} rays met something when they were replayed, and {recording.hits} in the render")
    return seconds


def without_copying(replays: Sequence[float], copies: Sequence[float]) -> np.ndarray:
    """Seconds of the replays without the least that copying takes: what it takes longer by is the machine's."""
    rays_alone = np.subtract(replays, min(copies))
    if rays_alone.min() <= 0:
        raise common.br.ToolError("so few rays take no longer than copying them: take more, or a larger picture")
    return rays_alone


def copying(recording: Recording, packed, threads: int) -> float:
    """Seconds of the same loop where Embree does nothing."""
    return timed(_replay_kernel(False, traces=False), recording, packed, threads)[0]


def timed(trace: Callable, recording: Recording, packed, threads: int) -> tuple[float, int]:
    """(seconds, what the calls of `trace` count) for all chunks of the recording, on so many threads."""
    from bl_ext.user_default.lobe.engine.kernels.embree import new_ray

    records = recording.records
    chunks = itertools.count(0, CHUNK)  # a step of it is one call of C: threads may share it

    def work(ray: np.ndarray) -> int:
        words, hits = ray.view(np.uint32), 0
        while (first := next(chunks)) < len(records):
            hits += trace(packed.accel.address, records[first : first + CHUNK], ray, words)
        return hits

    rays = [new_ray(packed.lights.shape_count) for _ in range(threads)]
    trace(packed.accel.address, records[:0], rays[0], rays[0].view(np.uint32))  # compiles
    with ThreadPoolExecutor(threads) as pool:
        begun = time.perf_counter()
        hits = sum(pool.map(work, rays))
        return time.perf_counter() - begun, hits


def differing(recording: Recording, packed) -> int:
    """How many rays, traced again, hit something where they hit nothing in the render, or the other way round. Packets
    and single rays may differ by their rounding at edges."""
    from bl_ext.user_default.lobe.engine.kernels.embree import new_ray

    ray = new_ray(packed.lights.shape_count)
    return int(_replay_kernel(True)(packed.accel.address, recording.records, ray, ray.view(np.uint32)))


def agreeing(others: int, recording: Recording) -> int:
    """How many rays end otherwise, where these are so few that it can be rounding."""
    if others > MOST_OTHERS * len(recording.records):
        raise common.br.ToolError(
            f"{others} of {len(recording.records)} rays end otherwise when they are traced again, more than rounding "
            f"at edges explains ({MOST_OTHERS:.1%}): what is replayed isn't the render"
        )
    return others


@cache
def _replay_kernel(compares: bool, traces: bool = True):
    """The bare loop, which counts hits; one that compares counts rays that end otherwise, and one that doesn't trace
    calls a function that does nothing. Not kept on disk: it belongs to no render."""
    from bl_ext.user_default.lobe.engine.kernels import embree

    pointer, intersect1, occluded1 = embree._pointer, embree._rtcIntersect1, embree._rtcOccluded1
    if not traces:
        intersect1 = occluded1 = _nothing()
    geometry_id, instance_id, invalid = embree.GEOM_ID, embree.INST_ID, embree.INVALID
    lamp_count, arguments = embree.LAMP_COUNT, 4 * embree._ARGUMENTS

    @numba.njit(nogil=True, error_model="numpy")
    def trace(scene, records, ray, words):
        address, count = np.uintp(ray.ctypes.data), 0
        for i in range(len(records)):
            for word in range(RAY_WORDS):
                words[word] = records[i, word]
            call = records[i, CALL]
            if call == OCCLUDED:
                occluded1(pointer(np.uintp(scene)), pointer(address), pointer(np.uintp(0)))
                hit = words[TFAR] >> 31 != 0
            else:
                words[geometry_id] = invalid
                words[instance_id] = invalid
                if call == INTERSECT:
                    intersect1(pointer(np.uintp(scene)), pointer(address), pointer(np.uintp(0)))
                else:
                    words[lamp_count] = np.uint32(0)
                    intersect1(pointer(np.uintp(scene)), pointer(address), pointer(address + np.uintp(arguments)))
                hit = words[geometry_id] != invalid
            count += hit != (records[i, HIT] != 0) if compares else hit
        return count

    return trace


@cache
def _nothing():
    """As Embree's functions to a kernel: LLVM can't know that the ray stays as it is, so it has to be there."""
    pointer = numba.types.voidptr

    @numba.cfunc("void(voidptr, voidptr, voidptr)")
    def nothing(scene, ray, arguments):
        pass

    llvm.add_symbol("lobe_nothing", nothing.address)
    _kept.append(nothing)
    return numba.types.ExternalFunction("lobe_nothing", numba.void(pointer, pointer, pointer))


_kept: list = []  # functions that compiled code calls by their addresses


def table(names: list[str], resolution: tuple[int, int], threads: int, runs: int, folder: Path) -> str:
    """Measure these scenes, and write ceiling.csv and .md into `folder`."""
    rows = []
    for name in tqdm(names, file=sys.stderr):
        rows.append(measure(name, resolution, SAMPLES, threads, runs))
        written = common.update_table("ceiling", KEYS, rows, folder=folder, note=NOTE)
    return written


KEYS = "scene", "resolution", "threads"
NOTE = f"""\
A render's time as a multiple of that of its own rays, traced again one by one by the bare functions of Embree: median
of pairs made in turn, smallest and largest. At most {WANTED:.2f} is wanted. Below 1 the render is faster than its rays
one by one, as kernels trace packets where they can. "Copying" is the share of the replay's time that it takes to hand
over the recorded rays, which no render has to read: the same loop around a function that does nothing. It is taken off
before the two are compared. "Rays that end otherwise" is the share of rays that hit something in the one and nothing in
the other: rounding at edges.

"""
