"""Where a render's time goes: Embree, and each part of the kernel.

    python benchmarks/hotspots.py           # of the sample scenes
    python benchmarks/hotspots.py --scale   # of those of scale.py, with few and with many lamps, triangles, ...

Linux's `perf` takes some thousand samples a second of where the processor is while each sample scene renders on one
thread; binutils' `addr2line` says which functions of the kernel, inlined into each other as they all are, an address
belongs to. Each sample counts for the part that asked: a table's lookup for the light tree if that looked it up. Writes
hotspots.csv and .md, or hotspots_scale.csv and .md, into benchmarks/results/; benchmarks/goals.py quotes both. Shares
of a few per cent depend on how LLVM mixes what it inlines.
"""

from __future__ import annotations

import argparse
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
from pathlib import Path

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
    "paths, their states": ("staged", "batch", "path", "tile", "records"),
}
EMBREE, OTHER = "Embree", "everything else"


def part_of(chain: list[str]) -> str:
    """Of an address. chain: files in engine/kernels, from the function it is in to the one it was inlined into last."""
    for file in chain:
        for part, starts in PARTS.items():
            if file.startswith(starts):
                return part
    return OTHER


def measure(scene: str | Number, options: argparse.Namespace) -> dict[str, str]:
    """A row of the table, of a sample scene or any .blend, or of one of scale_scenes."""
    with tempfile.TemporaryDirectory() as folder:
        # Lines are known of kernels that were compiled with them, in this very process: from the cache they come bare.
        environment = {**os.environ, "LOBE_CACHE_DIR": folder, "NUMBA_DEBUGINFO": "1"}
        task = json.dumps([scene, options.resolution, options.seconds, folder])
        command = [sys.executable, __file__, "--render", task]
        subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=True)
        counted = _parts(Path(folder))
        a_render = float((Path(folder) / "seconds.txt").read_text())
    return row(scene, counted, a_render, options)


def row(scene: str | Number, counted: Counter[str], a_render: float, options: argparse.Namespace) -> dict[str, str]:
    """counted: samples of each part; a_render: seconds, which are told of scenes that stand beside larger ones."""
    total = counted.total()
    shares = {part: f"{counted[part] / total:.0%}" for part in (EMBREE, *PARTS, OTHER)}
    size = "{}x{}".format(*options.resolution)
    if isinstance(scene, str):
        return {"scene": scene, "resolution": size, "samples": str(total), **shares}
    kind, count = scene
    number = f"{count:.0e}".replace("e+0", "e")
    return {"scene": kind, "number": number, "resolution": size, "s a render": f"{a_render:.4f}",
            "samples": str(total), **shares}  # fmt: skip


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
    """What `measure` runs. Leaves perf.data, kernel.o and where that was in memory in the folder, and how many seconds
    a render took."""
    common.enable_lobe()
    from bl_ext.user_default.lobe.engine import Prepared, render
    from bl_ext.user_default.lobe.engine.pack import pack
    from bl_ext.user_default.lobe.engine.tiles import tile_kernel

    scene, settings = exported(scene_of, size)
    prepared = Prepared()  # so that it is packed once
    render(scene, settings, prepared=prepared)  # compiles
    packed = pack(scene, settings)
    (compiled,) = tile_kernel(packed.features).overloads.values()
    function = compiled.fndesc.llvm_func_name
    (folder / "kernel.o").write_bytes(compiled.library._get_compiled_object())
    (folder / "place.json").write_text(json.dumps([function, compiled.library.get_pointer_to_function(function)]))
    command = ["perf", "record", "-q", "-F", str(FREQUENCY), "-e", "cpu-clock", "-p", str(os.getpid())]
    perf = subprocess.Popen([*command, "-o", str(folder / "perf.data")])
    time.sleep(WARMING_UP)
    begun, taken = time.perf_counter(), []
    while time.perf_counter() - begun < duration:
        taken.append(render(scene, settings, prepared=prepared).seconds["render"])
    (folder / "seconds.txt").write_text(str(statistics.median(taken)))
    perf.send_signal(signal.SIGINT)
    perf.wait()


def _parts(folder: Path) -> Counter[str]:
    """Samples of each part."""
    function, address = json.loads((folder / "place.json").read_text())
    kernel = folder / "kernel.o"
    symbols = _lines("nm", str(kernel))
    start = next(int(line.split()[0], 16) for line in symbols if line.endswith(f" {function}"))
    end = kernel.stat().st_size
    counted: Counter[str] = Counter()
    inside: Counter[int] = Counter()
    for line in _lines("perf", "script", "-i", str(folder / "perf.data"), "-F", "ip,dso"):
        found = re.match(r"\s*([0-9a-f]+) .*?\((.*)\)$", line)
        if found is None:
            continue
        offset = int(found[1], 16) - address + start
        if "embree" in found[2]:
            counted[EMBREE] += 1
        elif 0 <= offset < end and not found[2].endswith(".so"):
            inside[offset] += 1
        else:
            counted[OTHER] += 1
    for offset, chain in _chains(kernel, sorted(inside)).items():
        counted[part_of(chain)] += inside[offset]
    return counted


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
