"""What each technique brings: Lobe beside itself without it, `python benchmarks/trials.py [NAME...]`.

A trial is an edit of a copy of the engine, or another setting. Both copies render the sample scenes in turn, each in a
process of its own, from the same seeds. What counts is relMSE times the seconds of the render phase: above 1, the
engine is better as it is. Writes trials.csv and trials.md to benchmarks/results/, and the list of what was tried into
benchmarks/README.md.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import pickle
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import common
import numpy as np
from common import br
from scipy import stats
from tqdm import tqdm

from benchmarks.convergence.tables import quote
from engine import Scene
from tools import metrics
from tools.exported import exported
from tools.render import resolution, whole_number

KERNELS = "engine/kernels/"
REFERENCE_SEED = 10_001
MARKS = "<!-- the list of trials.py -->\n", "<!-- its end -->\n"
# Of a ratio of seconds, the standard error of its logarithm: so much, root mean square, are those off 1 that a trial
# leaves as they are ("packets for all rays" where nothing is instanced, "lobes chosen by kd and ks" without Phong).
TIME_NOISE = 0.045
NORMAL_95 = 1.96
WORKER = Path(__file__).resolve().parent / "trial_worker.py"


@dataclass(frozen=True)
class Trial:
    """name: what stands in the technique's place.  edits: (file, text, other text); every occurrence is replaced, and
    there has to be one.  tried: the technique.  kept: the engine has it, and the trial is without it; otherwise the
    other way round.  price: what it takes, other than seconds."""

    name: str
    tried: str
    kept: bool
    price: str
    edits: Sequence[tuple[str, str, str]] = ()
    settings: dict = field(default_factory=dict)


TRIALS = (
    Trial(
        "independent random numbers",
        "tabulated Owen-scrambled Sobol points",
        True,
        "a table of 2 MB, for all scenes",
        [
            (
                KERNELS + "sampler/sobol.py",
                "at(table, dimension & _PAIR_MASK, to_index(_shuffle(order, first) >> _INDEX_SHIFT))",
                "hash32(uint32(first ^ uint32(order * _GOLDEN)))",
            )
        ],
    ),
    Trial(
        "uniform directions for diffuse",
        "directions by their cosine",
        True,
        "none",
        settings={"hemisphere_sampling": "UNIFORM"},
    ),
    Trial(
        "lobes chosen by kd and ks",
        "lobes chosen by their albedos at this angle",
        True,
        "a table of the lobe's albedo",
        settings={"lobe_selection": "CLASSIC"},
    ),
    Trial(
        "no roulette",
        "Russian roulette by throughput",
        True,
        "a random number for each vertex",
        [(KERNELS + "vertex.py", "ROULETTE_KEEP = np.float32(1.25)", "ROULETTE_KEEP = np.float32(1e30)")],
    ),
    Trial(
        "roulette of Cycles",
        "roulette a quarter milder than Cycles'",
        True,
        "more rays",
        [(KERNELS + "vertex.py", "ROULETTE_KEEP = np.float32(1.25)", "ROULETTE_KEEP = np.float32(1)")],
    ),
    Trial(
        "roulette twice as mild",
        "roulette milder still",
        False,
        "more rays",
        [(KERNELS + "vertex.py", "ROULETTE_KEEP = np.float32(1.25)", "ROULETTE_KEEP = np.float32(5)")],
    ),
    Trial(
        "light sampling without MIS",
        "multiple importance sampling, power heuristic",
        True,
        "densities of what rays meet by chance",
        [
            (KERNELS + "mis.py", "select(light.alone, ONE, power_heuristic(light.pdf, pdf_bsdf))", "ONE"),
            (KERNELS + "mis.py", "power_heuristic(ray.pdf, pdf_light) if shares else ZERO", "ZERO if shares else ZERO"),
        ],
    ),
    Trial(
        "balance heuristic",
        "the balance heuristic",
        False,
        "none",
        [(KERNELS + "mis.py", "ONE / (ONE + ratio * ratio)", "ONE / (ONE + ratio)")],
    ),
    Trial(
        "lights chosen by power",
        "light tree with bounds of distance, cosines and cones",
        True,
        "64 bytes an emitter",
        [
            (
                KERNELS + "light/tree.py",
                "select(above, _importance_above(node, to, half, height), ZERO)",
                "select(above, node[POWER], ZERO)",
            )
        ],
    ),
    Trial(
        "groups of lights by even shares",
        "lamps, suns and world chosen by what each sends",
        True,
        "two nodes of the tree for each vertex",
        [(KERNELS + "light/groups.py", "LEAST_SHARE = np.float32(1 / 3)", "LEAST_SHARE = np.float32(1)")],
    ),
    Trial(
        "emitters sampled by area",
        "solid-angle sampling of triangles and rectangles",
        True,
        "code",
        [(KERNELS + "light/spherical.py", "FAR_RATIO = np.float32(2)", "FAR_RATIO = np.float32(0)")],
    ),
    Trial(
        "adaptive sampling",
        "adaptive sampling that stops good pixels",
        False,
        "a second sum for each pixel; it is an option",
        settings={"use_adaptive_sampling": True, "adaptive_threshold": 0.1},
    ),
    Trial(
        "path by path",
        "stages: batches of paths, rays and shadow rays deferred, sixteen in a register",
        True,
        "half a megabyte a thread, code",
        [(KERNELS + "staged.py", "usual = f.shared_light and not", "usual = False and f.shared_light and not")],
    ),
    Trial(
        "single rays",
        "packets for rays",
        True,
        "code",
        [(KERNELS + "rays.py", "return not AS_WRITTEN and (first or not f.instances)", "return False")],
    ),
    Trial(
        "packets for the camera's rays alone",
        "packets for rays after the first vertex, where nothing is instanced",
        True,
        "none",
        [
            (
                KERNELS + "rays.py",
                "return not AS_WRITTEN and (first or not f.instances)",
                "return not AS_WRITTEN and first",
            )
        ],
    ),
    Trial(
        "packets for all rays",
        "packets through instances too",
        False,
        "none",
        [(KERNELS + "rays.py", "return not AS_WRITTEN and (first or not f.instances)", "return not AS_WRITTEN")],
    ),
    Trial(
        "packets that aren't said to be alike",
        "telling Embree that the first rays are alike",
        True,
        "where surfaces coincide, hits depend on the packet",
        [(KERNELS + "embree.py", "_ALIKE = np.uint32(1 << 16)", "_ALIKE = np.uint32(0)")],
    ),
    Trial(
        "a batch of 256 paths",
        "batches of 1,024 paths, not 256",
        True,
        "memory",
        [(KERNELS + "batch.py", "BATCH = 1024", "BATCH = 256")],
    ),
    Trial(
        "a batch of 4,096 paths",
        "batches of 4,096 paths",
        False,
        "memory",
        [(KERNELS + "batch.py", "BATCH = 1024", "BATCH = 4096")],
    ),
    Trial(
        "eight numbers in a register",
        "sixteen numbers in a register, not eight",
        True,
        "none where registers are as wide",
        [(KERNELS + "simd/types.py", "\nWIDTH = 16\n", "\nWIDTH = 8\n")],
    ),
    Trial(
        "arithmetic as written",
        "arithmetic that may be reordered",
        True,
        "other bits than the scalar kernel",
        [(KERNELS + "jit.py", "set() if AS_WRITTEN else {", "set() if not AS_WRITTEN else {")],
    ),
    Trial(
        "not watertight",
        "rays that may slip through edges",
        False,
        "leaks",
        [("engine/accel.py", "_SCENE_FLAG_ROBUST = 4", "_SCENE_FLAG_ROBUST = 0")],
    ),
    Trial(
        "leaves that hold numbers of vertices",
        "Embree's full leaves, up to a million triangles",
        True,
        "memory and build time",
        [("engine/accel.py", "_MOST_IN_FULL = 1 << 20", "_MOST_IN_FULL = 0")],
    ),
    Trial(
        "huge pages for Embree",
        "huge pages for Embree",
        False,
        "none",
        [("engine/accel.py", 'f"user_threads=', 'f"hugepages=1,user_threads=')],
    ),
)


class Copy:
    """A copy of the engine with a trial's edits, and a process that renders with it."""

    def __init__(self, folder: Path, trial: Trial | None):
        self.folder = folder
        edited(folder, trial)
        self.process = subprocess.Popen(
            [sys.executable, str(WORKER)], cwd=folder, env={**os.environ, "LOBE_CACHE_DIR": str(folder)}, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip

    def load(self, scene: Scene) -> None:
        (self.folder / "scene").write_bytes(pickle.dumps(scene))
        self._ask({"load": True})

    def render(self, settings: dict) -> tuple[np.ndarray, float]:
        """(picture (h, w, 3), seconds of the render phase)."""
        seconds = self._ask({"settings": settings})
        return np.load(self.folder / "picture.npy")[..., :3], seconds

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()

    def _ask(self, question: dict) -> float:
        assert self.process.stdin is not None and self.process.stdout is not None
        print(json.dumps(question), file=self.process.stdin, flush=True)
        answer = self.process.stdout.readline()
        if not answer:
            raise br.ToolError("the trial's engine has ended; what it said stands above")
        return float(answer)


def edited(folder: Path, trial: Trial | None) -> None:
    """Copy the engine into the folder, and make the trial's edits."""
    shutil.copytree(common.ROOT / "engine", folder / "engine", ignore=shutil.ignore_patterns("__pycache__"))
    for name, old, new in trial.edits if trial else ():
        path = folder / name
        text = path.read_text()
        if old not in text:
            raise br.ToolError(f"{name} doesn't say {old!r} any more: write the trial {trial.name!r} anew")
        path.write_text(text.replace(old, new))


@dataclass(frozen=True)
class Comparison:
    """Of a trial with the engine as it is, on one scene: ratios of seconds and of relMSE, and the relative standard
    error of the latter."""

    time: float
    error: float
    uncertain: float

    @property
    def cost(self) -> float:
        return self.time * self.error


def compare(usual: Copy, other: Copy, trial: Trial, reference: np.ndarray, options: argparse.Namespace) -> Comparison:
    """Renders in turn, from the same seeds. The first of each compiles."""
    seconds: dict[Copy, list[float]] = {usual: [], other: []}
    errors: dict[Copy, list[float]] = {usual: [], other: []}
    base = {"samples": options.samples, "threads": options.threads, "pixel_filter": "BOX"}
    for run in range(options.seeds + 1):
        for copy in (usual, other) if run % 2 else (other, usual):
            extra = trial.settings if copy is other else {}
            picture, taken = copy.render({**base, "seed": run, **extra})
            if run:
                seconds[copy].append(taken)
                errors[copy].append(metrics.rel_mse(picture, reference))
    time = metrics.median_ratio(seconds[other], seconds[usual])[0]
    ratio = np.array(errors[other]) / errors[usual]
    spread = float(stats.sem(np.log(ratio)))
    return Comparison(time, float(np.mean(errors[other]) / np.mean(errors[usual])), spread)


def measure(trial: Trial, scenes: dict[str, Scene], references: dict[str, np.ndarray], usual: Copy, options) -> dict:
    """A row of the table."""
    found = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.closing(Copy(Path(folder), trial)) as other:
        for name, scene in scenes.items():
            usual.load(scene)
            other.load(scene)
            found[name] = compare(usual, other, trial, references[name], options)
    row = {"instead": trial.name}
    row |= {
        name: f"{c.cost:.2f} ({c.time:.2f} x {c.error:.2f} ± {c.error * c.uncertain:.2f})" for name, c in found.items()
    }
    return row | {"geometric mean": f"{stats.gmean([c.cost for c in found.values()]):.2f}"}


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"default: all of {', '.join(t.name for t in TRIALS)}")
    parser.add_argument("--resolution", type=resolution, default=(120, 80), metavar="WxH")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), default=64, metavar="N")
    parser.add_argument("--reference-samples", type=whole_number(1, 1 << 24), default=8192, metavar="N")
    parser.add_argument("--seeds", type=whole_number(2, 1000), default=8, metavar="N")
    parser.add_argument("--threads", type=whole_number(1, 1024), default=2, metavar="N")
    parser.add_argument("--list", action="store_true", help="render nothing: write the list anew from trials.csv")
    common.add_results(parser)
    return parser.parse_args(arguments)


def chosen(names: list[str]) -> list[Trial]:
    by_name = {trial.name: trial for trial in TRIALS}
    for name in names:
        if name not in by_name:
            raise br.ToolError(f"there is no trial {name!r}: choose from {', '.join(map(repr, by_name))}")
    return [by_name[name] for name in names] or list(TRIALS)


def run(options: argparse.Namespace, say) -> None:
    trials = chosen(options.names)
    common.enable_lobe()
    scenes = {}
    for name in common.SCENES:
        common.prepare(common.scene_path(name), options.resolution, options.threads)
        scenes[name] = exported()
    long = {"samples": options.reference_samples, "seed": REFERENCE_SEED, "pixel_filter": "BOX"}
    with tempfile.TemporaryDirectory() as folder, contextlib.closing(Copy(Path(folder), None)) as usual:
        references, rows = {}, []
        for name, scene in scenes.items():
            usual.load(scene)
            references[name] = usual.render(long)[0].astype(np.float64)
        for trial in tqdm(trials, file=sys.stderr):
            rows.append(measure(trial, scenes, references, usual, options))
            table = common.update_table("trials", ("instead",), rows, folder=options.results, note=NOTE)
    if options.results == common.RESULTS:
        quote_list()
    say(table)


def quote_list(page: Path = common.ROOT / "benchmarks" / "README.md", folder: Path = common.RESULTS) -> None:
    quote(page, section(common.read_table("trials", folder)), MARKS)


def section(rows: list[dict[str, str]]) -> str:
    """What stands in benchmarks/README.md: the list and where it comes from, or that there is none."""
    if not rows:
        return "Not measured yet.\n"
    return list_of_tried(rows) + "\nScene by scene: [trials.md](results/trials.md).\n"


def list_of_tried(rows: list[dict[str, str]]) -> str:
    """Of each technique, relMSE x seconds without it over that with it."""
    measured = {row["instead"]: row for row in rows}
    table = []
    for trial in TRIALS:
        if trial.name in measured:
            gain, scenes = gain_of(costs(measured[trial.name]), trial.kept)
            table.append(
                {
                    "tried": trial.tried,
                    "gain": gain,
                    "least and most": scenes,
                    "price": trial.price,
                    "kept": "yes" if trial.kept else "no",
                }
            )
    return common.markdown(table)


def costs(row: dict[str, str]) -> dict[str, tuple[float, float]]:
    """Of a row of trials.csv, for each scene relMSE x seconds as a multiple of the engine's own, and the standard error
    of its logarithm."""
    found = {}
    for scene, text in row.items():
        if scene not in ("instead", "geometric mean"):
            cost, _, error, uncertain = map(float, re.findall(r"[\d.]+", text))
            found[scene] = cost, math.hypot(uncertain / error, TIME_NOISE)
    return found


def gain_of(found: dict[str, tuple[float, float]], kept: bool) -> tuple[str, str]:
    """Geometric mean over the scenes with its 95 % interval as it was measured, and what it is where it is least and
    most."""
    sign = 1 if kept else -1
    logs = {scene: sign * math.log(cost) for scene, (cost, _) in found.items()}
    middle = sum(logs.values()) / len(logs)
    half = NORMAL_95 * math.hypot(*(noise for _, noise in found.values())) / len(logs)
    interval = f"{math.exp(middle):.2f} ({math.exp(middle - half):.2f} to {math.exp(middle + half):.2f})"
    if abs(middle) <= half:
        interval += ": no difference"
    least, most = min(logs, key=logs.__getitem__), max(logs, key=logs.__getitem__)
    return interval, f"{math.exp(logs[least]):.2f} on {least}, {math.exp(logs[most]):.2f} on {most}"


NOTE = """\
Seconds of the render phase times relMSE with another technique, as a multiple of the engine's own; in brackets the two
factors, of seconds (a median of pairs) and of relMSE with its standard error. Above 1 the engine is better as it is.

"""


def main() -> int:
    options = parse()
    if options.list:
        quote_list()
        return 0
    with br.quiet_stdout() as say:
        try:
            run(options, say)
        except br.ToolError as error:
            print(f"trials.py: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
