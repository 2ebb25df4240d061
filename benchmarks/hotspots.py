"""Where a render's time goes: Embree, and each part of the kernel.

    python benchmarks/hotspots.py           # of the sample scenes
    python benchmarks/hotspots.py --scale   # of those of scale.py, with few and with many lamps, triangles, ...

Linux's `perf` takes some thousand samples a second of where the processor is while each sample scene renders on one
thread; binutils' `addr2line` says which functions of the kernel, inlined into each other as they all are, an address
belongs to. Each sample counts for the part that asked: a table's lookup for the light tree if that looked it up. Those
outside of machine code that Lobe has made count for whose library they are in. Samples count while a render's samples
are taken, not in the checks, the packing and the end of a render. Writes hotspots.csv and .md, or hotspots_scale.csv
and .md, into benchmarks/results/; benchmarks/goals.py quotes both. Shares of a few per cent depend on how LLVM mixes
what it inlines.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import common
import scale_scenes
from common import br
from tqdm import tqdm

from tools.render import resolution, seconds, whole_number

SAMPLES = 64
FREQUENCY = 4000  # samples a second
WARMING_UP = 0.5  # seconds until `perf` listens
FEW_AND_MANY = {"lamps": (10**2, 10**5), "emissive triangles": (10**2, 10**5), "triangles": (10**3, 10**7)}
Number = tuple[str, int]  # which of `scale_scenes.MAKERS`, and how many

# Parts by the start of a file's path in engine/kernels, the first that fits. What is in no part is a helper: its
# callers are asked.
PARTS = {
    "light tree": ("light/tree",),
    "environment": ("light/environment",),
    "other light sampling": ("light/", "direct", "mis"),
    "BSDFs": ("bsdf/",),
    "surface that was met": ("met", "vertex", "geom/surface"),
    "random numbers": ("sampler/sobol", "sampler/random"),
    "camera, film": ("camera/", "film/"),
    "rays to and from Embree": ("rays", "embree"),
    "paths, their states": ("staged", "batch", "records"),
}
EMBREE, NOTING, OTHER = "Embree", "lamps that Embree asks about", "everything else"
# Of what is in none of Lobe's machine code, by the name of its library, the first that fits.
LIBRARIES = {
    EMBREE: ("embree",),
    "Python": ("python", "numpy", "numba", "llvmlite"),
    "C library": ("libc.so", "libc-", "libm.so", "libm-", "libpthread", "ld-linux"),
    "operating system": ("[kernel", "[vdso", "[guest"),
}
NAMED, ELSE = 3, "most of everything else"  # by symbol and library, in the table's last column


def part_of(chain: list[str]) -> str:
    """Of an address. chain: files in engine/kernels, from the function it is in to the one it was inlined into last."""
    for file in chain:
        for part, starts in PARTS.items():
            if file.startswith(starts):
                return part
    return OTHER


def part_of_library(library: str) -> str:
    """library: the path or name that `perf` gives."""
    name = Path(library).name if library.startswith("/") else library
    return next((part for part, names in LIBRARIES.items() if any(one in name for one in names)), OTHER)


class Sample(NamedTuple):
    """time: seconds, as `time.perf_counter` has them on Linux"""

    time: float
    address: int
    symbol: str
    library: str


class Code(NamedTuple):
    """Machine code that was compiled in the process: what `file` holds lies at `address`, `size` bytes of it.
    part: what all its samples count for; empty: they count by their lines."""

    file: str
    address: int
    size: int
    part: str


Stretch = tuple[float, float]  # of time, from and to


def measure(scene: str | Number, options: argparse.Namespace) -> dict[str, str]:
    """A row of the table, of a sample scene or any .blend, or of one of scale_scenes."""
    with tempfile.TemporaryDirectory() as folder:
        # Lines are known of kernels that were compiled with them, in this very process: from the cache they come bare.
        environment = {**os.environ, "LOBE_CACHE_DIR": folder, "NUMBA_DEBUGINFO": "1"}
        task = json.dumps([scene, options.resolution, options.seconds, folder])
        command = [sys.executable, __file__, "--render", task]
        subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=True)
        samples, codes, phases = _recorded(Path(folder))
        counted, others = parts(samples, codes, phases)
        a_render = float((Path(folder) / "seconds.txt").read_text())
    return row(scene, counted, others, a_render, options)


def row(
    scene: str | Number, counted: Counter[str], others: Counter[str], a_render: float, options: argparse.Namespace
) -> dict[str, str]:
    """counted: samples of each part; others: of everything else, by name; a_render: seconds, which are told of scenes
    that stand beside larger ones."""
    total = counted.total()
    names = dict.fromkeys((EMBREE, NOTING, *PARTS, *LIBRARIES, OTHER))
    shares = {part: f"{counted[part] / total:.0%}" for part in names}
    most = [f"{name} ({number / total:.1%})" for name, number in others.most_common(NAMED)]
    size = "{}x{}".format(*options.resolution)
    if isinstance(scene, str):
        return {"scene": scene, "resolution": size, "samples": str(total), **shares, ELSE: ", ".join(most)}
    kind, count = scene
    number = f"{count:.0e}".replace("e+0", "e")
    return {"scene": kind, "number": number, "resolution": size, "s a render": f"{a_render:.4f}",
            "samples": str(total), **shares, ELSE: ", ".join(most)}  # fmt: skip


def exported(scene: str | Number, size: tuple[int, int]):
    """(engine.Scene, engine.Settings) for one thread."""
    from benchmarks import ceiling

    if isinstance(scene, str):
        return ceiling.export(scene, size, SAMPLES, 1)
    import bpy

    kind, count = scene
    scale_scenes.empty_file()
    made = scale_scenes.MAKERS[kind](count)
    bpy.context.window.scene = made
    br.set_resolution(made, *size)
    br.set_threads(made, 1)
    return ceiling.export_open(made, SAMPLES)


def render_and_record(scene_of: str | Number, size: tuple[int, int], duration: float, folder: Path) -> None:
    """What `measure` runs. Leaves perf.data, machine code and where that was in memory in the folder, from when to when
    samples were taken, and how many seconds a render took."""
    common.enable_lobe()
    from bl_ext.user_default.lobe.engine import Prepared, render, schedule
    from bl_ext.user_default.lobe.engine.kernels.embree import lamp_filter
    from bl_ext.user_default.lobe.engine.pack import pack
    from bl_ext.user_default.lobe.engine.tiles import tile_kernel

    scene, settings = exported(scene_of, size)
    prepared = Prepared()  # so that it is packed once
    render(scene, settings, prepared=prepared)  # compiles
    packed = pack(scene, settings)
    (compiled,) = tile_kernel(packed.features).overloads.values()
    name, noting = compiled.fndesc.llvm_func_name, lamp_filter()
    address = compiled.library.get_pointer_to_function(name)
    codes = [
        _left_behind(folder / "kernel.o", compiled.library, name, address, ""),
        _left_behind(folder / "noting.o", noting._library, noting._wrapper_name, noting.address, NOTING),
    ]
    (folder / "codes.json").write_text(json.dumps(codes))
    command = ["perf", "record", "-q", "-F", str(FREQUENCY), "-e", "cpu-clock", "-k", "CLOCK_MONOTONIC"]
    perf = subprocess.Popen([*command, "-p", str(os.getpid()), "-o", str(folder / "perf.data")])
    time.sleep(WARMING_UP)
    begun, taken = time.perf_counter(), []
    with noted_phases(schedule._Render, "_passes") as phases:
        while time.perf_counter() - begun < duration:
            taken.append(render(scene, settings, prepared=prepared).seconds["render"])
    (folder / "seconds.txt").write_text(str(statistics.median(taken)))
    (folder / "phases.json").write_text(json.dumps(phases))
    perf.send_signal(signal.SIGINT)
    perf.wait()


@contextlib.contextmanager
def noted_phases(owner: type, method: str) -> Iterator[list[Stretch]]:
    """Within, each call of the method adds to the list from when to when it went."""
    original, phases = getattr(owner, method), []

    def noted(*arguments):
        begun = time.perf_counter()
        try:
            return original(*arguments)
        finally:
            phases.append((begun, time.perf_counter()))

    with mock.patch.object(owner, method, noted):
        yield phases


def _left_behind(file: Path, library, function: str, address: int, part: str) -> Code:
    """Of one of Numba's libraries, which has a function of this name at this address."""
    file.write_bytes(library._get_compiled_object())
    return code_of(file, function, address, part)


def code_of(file: Path, function: str, address: int, part: str) -> Code:
    """Of an object file: all functions lie in one section, which is loaded as a whole."""
    lines = [line.split() for line in _lines("nm", "-S", "--defined-only", str(file))]
    places = {words[3]: (int(words[0], 16), int(words[1], 16)) for words in lines if words[2] in "tTwW"}
    size = max(start + length for start, length in places.values())
    return Code(str(file), address - places[function][0], size, part)


def _recorded(folder: Path) -> tuple[Iterator[Sample], list[Code], list[Stretch]]:
    """What `render_and_record` has left behind."""
    lines = _lines("perf", "script", "-i", str(folder / "perf.data"), "-F", "time,ip,sym,dso", "--ns")
    codes, phases = (json.loads((folder / name).read_text()) for name in ("codes.json", "phases.json"))
    return parsed(lines), [Code(*code) for code in codes], phases


def parsed(lines: Iterable[str]) -> Iterator[Sample]:
    """Of what `perf script` prints. Paths may have brackets and blanks."""
    for line in lines:
        found = re.match(r"\s*([0-9.]+):\s+([0-9a-f]+) (.*?) \((.*)\)$", line)
        if found is not None:
            yield Sample(float(found[1]), int(found[2], 16), found[3], found[4])


def parts(
    samples: Iterable[Sample], codes: Sequence[Code], phases: Sequence[Stretch]
) -> tuple[Counter[str], Counter[str]]:
    """(samples of each part within the phases, of everything else by symbol and library)"""
    counted: Counter[str] = Counter()
    others: Counter[str] = Counter()
    inside: dict[Code, Counter[int]] = {code: Counter() for code in codes}
    for sample in samples:
        if not any(begun <= sample.time <= ended for begun, ended in phases):
            continue
        code = next((code for code in codes if 0 <= sample.address - code.address < code.size), None)
        if code is not None:
            inside[code][sample.address - code.address] += 1
            continue
        part = part_of_library(sample.library)
        counted[part] += 1
        if part == OTHER:
            others[f"{sample.symbol} of {Path(sample.library).name}"] += 1
    for code, offsets in inside.items():
        if code.part:
            counted[code.part] += offsets.total()
            continue
        for offset, chain in _chains(Path(code.file), sorted(offsets)).items():
            counted[part_of(chain)] += offsets[offset]
            if part_of(chain) == OTHER:
                others[f"{chain[0].partition(':')[0] if chain else 'no line'} of the kernel"] += offsets[offset]
    return counted, others


def _chains(kernel: Path, offsets: list[int]) -> dict[int, list[str]]:
    """For each offset the files of engine/kernels that it comes from, the innermost function's first."""
    asked = "\n".join(f"{offset:#x}" for offset in offsets)
    command = ["addr2line", "-a", "-i", "-e", str(kernel)]
    told = subprocess.run(command, input=asked, capture_output=True, text=True, check=True).stdout
    chains: dict[int, list[str]] = {}
    chain: list[str] = []
    for line in told.splitlines():
        if line.startswith("0x"):
            chain = chains.setdefault(int(line, 16), [])
        elif "/kernels/" in line:
            chain.append(line.partition("/kernels/")[2])
    return chains


def _lines(*command: str) -> list[str]:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def few_and_many(largest: int) -> list[Number]:
    """The scenes of --scale, none of more than `largest`."""
    return [(kind, min(count, largest)) for kind, counts in FEW_AND_MANY.items() for count in counts]


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=list(common.SCENES), metavar="SCENE", help="default: all samples")
    parser.add_argument("--scale", action="store_true", help="few and many lamps, emissive triangles, triangles")
    parser.add_argument("--largest", type=whole_number(10**4, 10**9), default=10**7, metavar="N",
                        help="with --scale no scene with a larger number; default: 10,000,000")  # fmt: skip
    parser.add_argument("--resolution", type=resolution, default=(192, 192), metavar="WxH")
    parser.add_argument("--seconds", type=seconds(0.1), default=10.0, help="of rendering for each scene")
    common.add_results(parser)
    parser.add_argument("--render", type=json.loads, help=argparse.SUPPRESS)
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()
    if options.render:
        scene, size, duration, folder = options.render
        render_and_record(scene, tuple(size), duration, Path(folder))
        return 0
    with br.quiet_stdout() as say:
        if missing := [program for program in ("perf", "addr2line", "nm") if not shutil.which(program)]:
            print(f"hotspots.py: not installed: {', '.join(missing)}", file=sys.stderr)
            return 2
        table, keys = ("hotspots_scale", ("scene", "number")) if options.scale else ("hotspots", ("scene",))
        rows = []
        for scene in tqdm(few_and_many(options.largest) if options.scale else options.scenes, file=sys.stderr):
            rows.append(measure(scene, options))
            common.update_table(table, (*keys, "resolution"), rows, folder=options.results)
        say(common.markdown(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
