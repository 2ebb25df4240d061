"""What the benchmarks share: the sample scenes, starting Lobe inside Blender, several renders of an open file, tables.

Timings on a shared machine wander by tens of per cent from minute to minute. So two engines are always timed in turn,
pair by pair, and what is reported is the median of the pairs' ratios with the smallest and the largest, never one
engine's own time as a claim.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import math
import platform
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TypeVar

ROOT = Path(__file__).resolve().parent.parent
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from tools import blender_render as br  # noqa: E402
from tools.lobe_blender import enable_lobe  # noqa: E402

SAMPLES = ROOT / "sample_blends"
RESULTS = ROOT / "benchmarks" / "results"
SUMMARY = "geometric mean"  # what the names of rows that sum up others begin with
MADE_BY = "made_by"  # the table of what the rows of the others were measured on
UNRECORDED = "not recorded"
VECTORS = {"avx512f": "AVX-512", "avx2": "AVX2", "neon": "NEON"}  # LLVM's names, the widest first
SCENES = ("cornell_diffuse", "plates_phong", "lamps", "world", "instances", "many_lights")

T = TypeVar("T")

__all__ = ["RESULTS", "ROOT", "SAMPLES", "SCENES", "SUMMARY", "add_results", "br", "enable_lobe", "engine_label",
           "in_turn", "leave_out", "markdown", "prepare", "read_table", "render", "run", "scene_path",
           "update_table"]  # fmt: skip


def scene_path(name: str) -> Path:
    """A sample scene by name, or any .blend by path: a sample's leads to the same as its name."""
    stem = name if name in SCENES else Path(name).stem
    sample = SAMPLES / f"{stem}.blend"
    is_sample = name in SCENES or (stem in SCENES and Path(name).resolve() == sample.resolve())
    return sample if is_sample else Path(name)


def prepare(path: Path, resolution: tuple[int, int] | None, threads: int):
    """Open the file for a comparison: box filter, a fixed number of threads, none of what changes a picture beyond
    what both engines do alike. Gives back the scene."""
    scene = br.open_blend(path)
    if resolution is not None:
        br.set_resolution(scene, *resolution)
    br.set_threads(scene, threads)
    scene.lobe.pixel_filter = "BOX"
    leave_out(scene)
    return scene


# What Cycles goes without too, see addon/compare/peer.py, and what Blender would do to the picture afterwards, or to
# renders after the first. As addon/compare/matching.py has it.
LOBES_OFF = {"use_adaptive_sampling": False, "use_denoising": False, "time_limit": 0.0}
BLENDERS_OFF = ("use_compositing", "use_sequencer", "use_multiview", "use_persistent_data")


def leave_out(scene) -> None:
    """Switch off in a user's file what would make it another comparison; the file itself isn't saved."""
    import bpy

    for key, value in LOBES_OFF.items():
        setattr(scene.lobe, key, value)
    for key in BLENDERS_OFF:
        setattr(scene.render, key, False)
    scene.render.use_crop_to_border = scene.render.use_crop_to_border or scene.render.use_border
    for light in bpy.data.lights:
        if light.library is None and hasattr(light, "use_soft_falloff"):
            light.use_soft_falloff = False


def render(scene, engine: str, samples: int, seed: int) -> tuple[np.ndarray, dict]:
    """One picture (h, w, 3), scene-linear, and its report. engine: LOBE, CYCLES, or REFERENCE (Lobe's other road)."""
    scene.lobe.samples, scene.lobe.seed = samples, seed
    scene.lobe.road = "REFERENCE" if engine == "REFERENCE" else "COMPILED"
    br.set_engine(scene, "CYCLES" if engine == "CYCLES" else "LOBE")
    report = br.render(scene)
    return br.picture(scene, report)[..., :3], report


def in_turn(what: Sequence[T], rounds: int) -> Iterator[tuple[int, T]]:
    """(round, one of `what`), every second round in the opposite order: what comes first or last in one round, on a
    machine that grows slower or faster, is last or first in the next."""
    for index in range(rounds):
        for one in what if index % 2 == 0 else what[::-1]:
            yield index, one


def engine_label(engine: str) -> str:
    return {"LOBE": "Lobe", "CYCLES": "Cycles", "REFERENCE": "the reference road"}[engine]


def add_results(parser: argparse.ArgumentParser) -> None:
    """The option that keeps a trial run from writing into the tables that the pages quote."""
    parser.add_argument("--results", type=Path, default=RESULTS, metavar="FOLDER",
                        help="for tables; default: benchmarks/results")  # fmt: skip


def run(work: Callable[[argparse.Namespace, Callable[[str], None]], None], options: argparse.Namespace) -> int:
    """A script's work with Lobe enabled; returns its exit code. `work` gets a function that prints: what Blender prints
    is left out."""
    with br.quiet_stdout() as say:
        try:
            enable_lobe()
            work(options, say)
        except br.ToolError as error:
            print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
            return 2
    return 0


def update_table(
    name: str,
    keys: Iterable[str],
    rows: list[dict],
    *,
    folder: Path | None = None,
    note: str = "",
    summary: Callable[[list[dict]], list[dict]] | None = None,
) -> str:
    """Put `rows` into results/`name`.csv, in place of rows with equal `keys`, and write the same table as Markdown.

    folder: in place of results; note: Markdown before the table; summary: makes last rows of all the others, whose
    first key begins with SUMMARY. Gives back the Markdown of the new rows. Below the table stands which processor and
    engine its rows are of, see `keep_makers`.
    """
    folder = RESULTS if folder is None else folder
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.csv"
    keys, fields = list(keys), list(rows[0])
    rows = [{k: str(v) for k, v in row.items()} for row in rows]
    kept = read_table(name, folder)
    old = [row for row in kept if set(row) == set(fields)]
    if len(old) < len(kept):
        print(f"{name}: its columns have changed, {len(kept) - len(old)} old rows are dropped", file=sys.stderr)
    if summary is not None:
        old = [row for row in old if not row[keys[0]].startswith(SUMMARY)]
    fresh = {tuple(row[k] for k in keys) for row in rows}
    together = [row for row in old if tuple(row[k] for k in keys) not in fresh] + rows
    together.sort(key=lambda row: tuple(by_value(row[k]) for k in keys))
    count = len(together)
    if summary is not None:
        together += summary(together)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fields, lineterminator="\n")
        writer.writeheader()
        writer.writerows(together)
    fresh_rows, kept_rows = (["; ".join(row[k] for k in keys) for row in some] for some in (rows, old))
    keep_makers(name, fresh_rows, kept_rows, folder)
    path.with_suffix(".md").write_text(note + markdown(together) + made_by(name, count, folder))
    return markdown(rows)


def by_value(text: str) -> tuple[float, str]:
    """To sort by: numbers by their value, before any other text."""
    try:
        return float(text), ""
    except ValueError:
        return math.inf, text


def keep_makers(name: str, fresh: list[str], kept: list[str], folder: Path) -> None:
    """Note in made_by.csv that the rows `fresh` of a table are of this processor and engine; `kept` rows stay as they
    were, and what is known of others is forgotten. Rows are named by their keys."""
    old = read_table(MADE_BY, folder)
    rows = [row for row in old if row["table"] != name or (row["row"] in kept and row["row"] not in fresh)]
    mine = {"processor": processor(), "engine": engine_digest()}
    rows += [{"table": name, "row": row} | mine for row in fresh]
    rows.sort(key=lambda row: (row["table"], row["row"]))
    with (folder / f"{MADE_BY}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, ("table", "row", "processor", "engine"), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def makers(name: str, count: int, folder: Path) -> dict[tuple[str, str], int]:
    """(processor, engine) of a table's rows, and how many are of each: of `count`, those that nothing is known of are
    UNRECORDED."""
    found = Counter((row["processor"], row["engine"]) for row in read_table(MADE_BY, folder) if row["table"] == name)
    if unknown := count - found.total():
        found[UNRECORDED, UNRECORDED] += unknown
    return dict(found)


def made_by(name: str, count: int, folder: Path) -> str:
    """The line below a table."""
    lines = [
        f"{number} of {count} rows: " + (f"{cpu}, engine {engine}" if cpu != UNRECORDED else UNRECORDED)
        for (cpu, engine), number in makers(name, count, folder).items()
    ]
    return f"\nMeasured on: {'; '.join(lines)}.\n"


@cache
def processor() -> str:
    """Its name, and the widest vectors that it has: "AMD EPYC, AVX2"."""
    from llvmlite import binding

    described = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", described.read_text()) if described.is_file() else []
    has = binding.get_host_cpu_features()
    widest = next((text for feature, text in VECTORS.items() if has.get(feature)), "")
    return ", ".join(filter(None, [names[0] if names else platform.processor() or platform.machine(), widest]))


@cache
def engine_digest() -> str:
    """Of the sources in engine/: two tables with the same are of the same engine."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "engine").rglob("*.py")):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:10]


def read_table(name: str, folder: Path) -> list[dict[str, str]]:
    """The rows of `folder`/`name`.csv; none when there is no such file."""
    path = folder / f"{name}.csv"
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def markdown(rows: list[dict]) -> str:
    fields = list(rows[0])
    lines = [fields, ["---"] * len(fields)] + [[str(row[f]) for f in fields] for row in rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)
