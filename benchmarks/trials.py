"""What each technique brings: Lobe beside itself without it, `python benchmarks/trials.py [NAME...]`.

A trial is an edit of a copy of the engine, or another setting. The engine as it is and the trial's render a sample
scene in turn, from the same seeds, each in a process that is new for each scene. What counts is relMSE times the
seconds of the render phase: above 1, the engine is better as it is. What depends on how far apart the rays of
neighbouring pixels are, and on how long a pass is, is tried on large pictures of a few samples. Writes trials.csv and
trials.md to benchmarks/results/, and the list of what was tried into benchmarks/README.md.

Seconds are the median of pairs, relMSE is the mean over the seeds, without the reference's own. Standard errors are by
the bootstrap over the seeds, of the very ratio that is reported. What differs from process to process and not from
render to render, as where memory happens to lie, is seen by the trial without any edit; as no two scenes of a trial
share a process, a mean over the scenes has it once for each of them, by chance of its own.

What has been measured is kept in out/trials/, by scene and trial: after an interruption the same command goes on where
it was, and later runs measure what is new to this engine, processor and these options. Exit code 0; 2 for what the user
can mend, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import inspect
import json
import math
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import common
import numpy as np
import trial_edits as edits
from common import br
from llvmlite import binding
from scipy import stats
from tqdm import tqdm

from benchmarks.convergence.reference import TRIM, Reference, make_reference
from benchmarks.convergence.tables import quote
from engine import Scene
from engine.features import Features
from engine.kernels import rows
from engine.kernels.batch import BATCH, COLUMNS, new_batch
from engine.kernels.embree import PACKET_WIDTH
from engine.lighttree import build_light_tree
from engine.pack import sobol_table
from tools.exported import exported
from tools.render import resolution, whole_number

KERNELS = edits.KERNELS
REFERENCE_SEED = 10_001
REFERENCES = 4  # renders that make a reference together, so that its noise is known: an even number
MARKS = "<!-- the list of trials.py -->\n", "<!-- its end -->\n"
KEYS = "instead", "scene"
COST, NOWHERE = "relMSE x seconds", "none"
RESAMPLES = 1000
CONFIDENCE = 0.95
FIREFLIES = 0.5  # share of the relMSE in a thousandth of the pixels from which on these are left out of the verdict
WORKER = Path(__file__).resolve().parent / "trial_worker.py"


class Need(NamedTuple):
    """What a machine has to have for an edit to change anything. otherwise: what is said instead of a figure."""

    holds: Callable[[], bool]
    otherwise: str


@dataclass(frozen=True, eq=False)
class Trial:
    """name: what stands in the technique's place.  edits: (file, text, other text); every occurrence is replaced, and
    there has to be one.  tried: the technique.  kept: the engine has it, and the trial is without it; otherwise the
    other way round.  price: what it takes, other than seconds.  settings: other ones.  samples, resolution: of both,
    where the usual ones are too few and too small; half as many pairs then have to do, as long renders scatter less.
    scenes: on which it changes anything, or which show it; empty: all.  need: see `Need`."""

    name: str
    tried: str
    kept: bool
    price: str | Callable[[], str]
    edits: Sequence[tuple[str, str, str]] = ()
    settings: dict = field(default_factory=dict)
    samples: int | None = None
    resolution: tuple[int, int] | None = None
    scenes: tuple[str, ...] = ()
    need: Need | None = None

    def pairs(self, seeds: int) -> int:
        return seeds if self.samples is None else max(2, seeds // 2)

    @property
    def changes_nothing(self) -> bool:
        """What noise there is between processes is judged by it."""
        return not self.edits and not self.settings


# Rays of a pixel's neighbours lie as close together as in a picture that somebody wants, and passes are as long.
LARGE: dict = {"resolution": (768, 512), "samples": 8}
# Elsewhere these change nothing.
WITH_GLOSS = "plates_phong", "lamps", "world"
WITH_TREE = "plates_phong", "lamps", "many_lights"
SHOWN = "cornell_diffuse", "world", "many_lights"  # by large pictures: scenes without instances


def compresses_lanes() -> bool:
    return bool(binding.get_host_cpu_features().get("avx512f"))


def permutes_lanes() -> bool:
    """As `_has_permutes` in engine/kernels/simd/memory.py."""
    return bool(binding.get_host_cpu_features().get("avx2")) and not compresses_lanes()


def reserves_huge_pages() -> bool:
    """Embree asks for reserved ones; that others become huge it tells the system in any case."""
    files = [Path("/proc/sys/vm") / name for name in ("nr_hugepages", "nr_overcommit_hugepages")]
    return any(file.is_file() and int(file.read_text()) > 0 for file in files)


WIDE_PACKETS = Need(lambda: PACKET_WIDTH > 8, "not on this processor: its packets are of eight")
PERMUTES = Need(permutes_lanes, "not on this processor: it compresses by itself, or can't permute")
RESERVED = Need(reserves_huge_pages, "not on this system: it has no pages reserved")


def bytes_of_tree(emitters: int = 1000) -> str:
    """Not before the list is written: building one is compiled."""
    three = np.zeros((emitters, 3))
    tree = build_light_tree(np.hstack([three, three]), three, three[:, 0], three[:, 0], np.ones(emitters))
    return f"{(tree.nodes.nbytes + tree.paths.nbytes) / emitters:.0f} bytes an emitter"


TRIALS = (
    Trial("the same engine", "nothing", True, "none"),
    Trial("the same engine, large pictures", "nothing, in large pictures", True, "none", scenes=SHOWN, **LARGE),
    Trial(
        "independent random numbers",
        "tabulated Owen-scrambled Sobol points",
        True,
        f"a table of {sobol_table().nbytes:,} bytes, for all scenes",
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
        "a formula for the lobe's albedo at each vertex",
        settings={"lobe_selection": "CLASSIC"},
        scenes=WITH_GLOSS,
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
        bytes_of_tree,
        [
            (
                KERNELS + "light/tree.py",
                "return left_child, _importance(left, p, n), right_child, _importance(right, p, n)",
                "return left_child, left[POWER], right_child, right[POWER]",
            )
        ],
        scenes=WITH_TREE,
    ),
    Trial(
        "a light tree that knows the lobe",
        "light tree for glossy receivers: a cluster's importance times the Phong lobe's value toward it",
        False,
        "five numbers a path, an exponential for each node",
        edits.TREE_FOR_GLOSS,
        scenes=("plates_phong", "lamps"),
    ),
    Trial(
        "one of four light samples",
        "product sampling of light and lobe: of four light samples one, by what each would bring",
        False,
        "three more light samples for each shadow ray",
        edits.ONE_OF_FOUR,
    ),
    Trial(
        "two light samples at the first vertex",
        "splitting: two light samples at the first vertex",
        False,
        "memory for twice the shadow rays",
        edits.TWO_LIGHT_SAMPLES,
    ),
    Trial(
        "groups of lights by even shares",
        "lamps, suns and world chosen by what each sends",
        True,
        "two nodes of the tree for each vertex",
        [(KERNELS + "light/groups.py", "LEAST_SHARE = np.float32(1 / 3)", "LEAST_SHARE = np.float32(1)")],
        scenes=("lamps", "many_lights"),
    ),
    Trial(
        "lamps in Embree's scene, however few",
        "a few lamps asked one after the other",
        True,
        "a second way for rays to meet lamps",
        [
            (
                "engine/pack/lamps.py",
                "MOST_LISTED_ROUND, MOST_LISTED_FLAT = 128, 16",
                "MOST_LISTED_ROUND, MOST_LISTED_FLAT = 0, 0",
            )
        ],
        scenes=("plates_phong", "lamps"),
    ),
    Trial(
        "emitters sampled by area",
        "solid-angle sampling of triangles and rectangles",
        True,
        "code",
        [(KERNELS + "light/spherical.py", "FAR_RATIO = np.float32(2)", "FAR_RATIO = np.float32(0)")],
        scenes=("cornell_diffuse", *WITH_TREE),
    ),
    Trial(
        "spheres sampled by area",
        "solid-angle sampling of spheres",
        True,
        "none",
        edits.SPHERES_BY_AREA,
        scenes=("lamps",),
    ),
    Trial(
        "adaptive sampling",
        "adaptive sampling that stops good pixels",
        False,
        "a second sum for each pixel; it is an option",
        settings={"use_adaptive_sampling": True},
        samples=512,
    ),
    Trial(
        "samples by the errors of neighbours",
        "samples where the error is, unbiased in the mean: by what a pixel's neighbours show after the first ones",
        False,
        "a second sum for each pixel, tiles of unequal cost",
        edits.SAMPLES_BY_NEIGHBOURS,
        settings={"use_adaptive_sampling": True},
        samples=edits.MOST_SAMPLES,
    ),
    Trial(
        "path by path",
        "stages: batches of paths, rays and shadow rays deferred, sixteen in a register",
        True,
        f"{new_batch(Features()).nbytes:,} bytes a thread, code",
        edits.PATH_BY_PATH,
    ),
    Trial(
        "shadow rays at each vertex",
        "shadow rays deferred until all paths of a batch have theirs",
        True,
        f"{rows.SHADOW_ROWS * COLUMNS * 4:,} bytes a thread",
        [
            (
                KERNELS + "staged.py",
                "shadows += _queue_shadows(f, tables, batch, path, vertex, light, alive, shadows)",
                """\
waiting = _queue_shadows(f, tables, batch, path, vertex, light, alive, NONE)
            shadows += light_all(f, tables, limits, batch, waiting, stage)""",
            ),
            (KERNELS + "staged.py", "+= light_all(f, tables, limits, batch, shadows, stage)\n", "+= shadows\n"),
        ],
    ),
    Trial(
        "pixels of a tile in Morton order",
        "Morton order of the pixels in a tile",
        False,
        "code",
        edits.IN_MORTON_ORDER,
        scenes=SHOWN,
        **LARGE,
    ),
    Trial(
        "lanes moved to the front one by one",
        "lanes moved to the front eight at a time, where the processor compresses none (AVX2)",
        True,
        "a table of 2 kB",
        [
            (
                KERNELS + "simd/memory.py",
                "(_store_permuted if _has_permutes(context) else _store_compressed)(",
                "_store_compressed(",
            )
        ],
        need=PERMUTES,
    ),
    Trial(
        "passes of 1, 1, 2, 4, ... samples",
        "small pictures in fewer passes, each of more samples of a pixel",
        True,
        "the first picture comes later",
        [("engine/schedule.py", "FIRST_PASS_PATHS = 1 << 19", "FIRST_PASS_PATHS = 1")],
    ),
    Trial(
        "passes of many samples in large pictures",
        "large pictures in fewer passes too",
        False,
        "the first picture comes later",
        [("engine/schedule.py", "FIRST_PASS_PATHS = 1 << 19", "FIRST_PASS_PATHS = 1 << 23")],
        scenes=(*SHOWN, "instances"),
        **LARGE,
    ),
    Trial(
        "single rays",
        "packets for rays",
        True,
        "code",
        [(KERNELS + "rays.py", "return not AS_WRITTEN and (first or not f.instances)", "return False")],
        scenes=(*SHOWN, "instances"),
        **LARGE,
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
        scenes=SHOWN,
        **LARGE,
    ),
    Trial(
        "packets for all rays",
        "packets through instances too",
        False,
        "none",
        [(KERNELS + "rays.py", "return not AS_WRITTEN and (first or not f.instances)", "return not AS_WRITTEN")],
        scenes=("instances",),
        **LARGE,
    ),
    Trial(
        "packets of eight rays",
        "packets of sixteen rays, not eight, where the processor has them",
        True,
        "none",
        [(KERNELS + "embree.py", "PACKET_WIDTH = _packet_width()", "PACKET_WIDTH = min(_packet_width(), 8)")],
        scenes=SHOWN,
        need=WIDE_PACKETS,
        **LARGE,
    ),
    Trial(
        "packets that aren't said to be alike",
        "telling Embree that the first rays are alike",
        True,
        "where surfaces coincide, hits depend on the packet",
        [(KERNELS + "embree.py", "_ALIKE = np.uint32(1 << 16)", "_ALIKE = np.uint32(0)")],
        scenes=(*SHOWN, "instances"),
        **LARGE,
    ),
    Trial(
        "a batch of 256 paths",
        "batches of 1,024 paths, not 256",
        True,
        f"{new_batch(Features()).nbytes // BATCH} bytes a path and thread",
        [(KERNELS + "batch.py", "BATCH = 1024", "BATCH = 256")],
        scenes=SHOWN,
        **LARGE,
    ),
    Trial(
        "a batch of 4,096 paths",
        "batches of 4,096 paths",
        False,
        f"{new_batch(Features()).nbytes // BATCH} bytes a path and thread",
        [(KERNELS + "batch.py", "BATCH = 1024", "BATCH = 4096")],
        scenes=SHOWN,
        **LARGE,
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
        scenes=(*SHOWN, "instances"),
        need=RESERVED,
        **LARGE,
    ),
)


class Worker:
    """A process that renders with the engine in a folder."""

    def __init__(self, engine: Path):
        self._exchange = tempfile.TemporaryDirectory()
        self.process = subprocess.Popen(
            [sys.executable, str(WORKER), self._exchange.name], cwd=engine,
            env={**os.environ, "LOBE_CACHE_DIR": str(engine)}, text=True, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, start_new_session=True,
        )  # fmt: skip

    def load(self, scene: Scene) -> None:
        Path(self._exchange.name, "scene").write_bytes(pickle.dumps(scene))
        self._ask({"load": True})

    def render(self, settings: dict) -> tuple[np.ndarray, float]:
        """(picture (h, w, 3), seconds of the render phase)."""
        seconds = self._ask({"settings": settings})
        return np.load(Path(self._exchange.name, "picture.npy"))[..., :3], seconds

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()
        self._exchange.cleanup()

    def _ask(self, question: dict) -> float:
        assert self.process.stdin is not None and self.process.stdout is not None
        print(json.dumps(question), file=self.process.stdin, flush=True)
        answer = self.process.stdout.readline()
        if not answer:
            raise br.ToolError("the trial's engine has ended; what it said stands above")
        return float(answer)


def edited(folder: Path, trial: Trial | None) -> None:
    """Copy the engine into the folder, with the kernel that goes path by path, and make the trial's edits."""
    shutil.copytree(common.ROOT / "engine", folder / "engine", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "tools").mkdir()
    shutil.copy(common.ROOT / "tools" / "by_path.py", folder / "tools")
    for name, old, new in trial.edits if trial else ():
        path = folder / name
        text = path.read_text()
        if old not in text:
            raise br.ToolError(f"{name} doesn't say {old!r} any more: write the trial {trial.name!r} anew")
        path.write_text(text.replace(old, new))


def reference_from(renders: np.ndarray, samples: int) -> Reference:
    """renders (REFERENCES, h, w, 3), of so many samples each, from other seeds."""
    return make_reference(renders[::2], renders[1::2], samples)


# Rows of `compare`'s arrays, and of `log_ratios` behind those.
SECONDS, WHOLE, TRIMMED = 0, 1, 2
WHOLE_COST, TRIMMED_COST = 3, 4


def compare(
    engines: tuple[Path, Path], trial: Trial, scene: Scene, reference: Reference, options
) -> tuple[np.ndarray, np.ndarray]:
    """Renders in turn, from the same seeds, after one of each that warms up. Of the engine as it is and of the trial,
    arrays (3, seeds): seconds, relMSE and relMSE without the worst pixels."""
    samples = trial.samples or options.samples
    with contextlib.ExitStack() as stack:  # both start at once
        usual, other = (stack.enter_context(contextlib.closing(Worker(engine))) for engine in engines)
        measured: dict[Worker, list[tuple[float, float, float]]] = {usual: [], other: []}
        for worker in measured:
            worker.load(scene)
            worker.render(settings_of(trial if worker is other else None, max(1, samples // 8), options, seed=0))
        for run in range(1, trial.pairs(options.seeds) + 1):
            for worker in (usual, other) if run % 2 else (other, usual):
                settings = settings_of(trial if worker is other else None, samples, options, seed=run)
                picture, taken = worker.render(settings)
                measured[worker].append((taken, *reference.errors(picture)))
    return np.array(measured[usual]).T, np.array(measured[other]).T


def settings_of(trial: Trial | None, samples: int, options, seed: int) -> dict:
    """None: of the engine as it is."""
    usual = {"samples": samples, "threads": options.threads, "pixel_filter": "BOX", "seed": seed}
    return usual | (trial.settings if trial else {})


def log_ratios(usual: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Logarithms of a trial's multiples of the engine's own: seconds, relMSE, trimmed relMSE, and seconds times either.
    usual, other (3, seeds)."""
    time = np.median(np.log(other[SECONDS] / usual[SECONDS]))
    errors = np.log(other[WHOLE:].mean(axis=1) / usual[WHOLE:].mean(axis=1))
    return np.array([time, *errors, *(time + errors)])


def standard_errors(usual: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Of `log_ratios`, by the bootstrap over the seeds: each draw takes the same ones of both."""
    n = usual.shape[1]
    draws = np.random.default_rng(0).integers(0, n, (RESAMPLES, n))
    drawn = [log_ratios(usual[:, seeds], other[:, seeds]) for seeds in draws]
    return np.std(drawn, axis=0) * math.sqrt(n / (n - 1))


Place = tuple[str, tuple[int, int]]  # a scene, and the resolution of its picture


def places(trial: Trial, options) -> list[Place]:
    return [(name, trial.resolution or options.resolution) for name in trial.scenes or common.SCENES]


class Measuring:
    """Rows of trials, which are measured unless an earlier run has left their figures."""

    def __init__(self, scenes: Mapping[Place, Scene], folder: Path, options):
        """folder: for copies of the engine, empty."""
        self._scenes, self._folder, self._options = scenes, folder, options
        self._digests = {place: hashlib.sha256(pickle.dumps(scene)).hexdigest() for place, scene in scenes.items()}
        edited(folder / "usual", None)

    def of(self, trials: Sequence[Trial]) -> Iterator[tuple[Trial, dict[Place, tuple[np.ndarray, np.ndarray]]]]:
        """Each trial with `compare`'s arrays of each scene, of none where the machine lacks what it needs. Of as many
        trials as there are threads kernels are compiled at the same time, as each compiles on one."""
        compiled: set[Place] = set()  # by the engine as it is
        for some in groups(trials, self._options.threads):
            missing = {trial: self._missing(trial) for trial in some}
            usual = {place for places_of in missing.values() for place in places_of} - compiled
            compiled |= usual
            work = [(None, sorted(usual)), *((t, found) for t, found in missing.items() if not t.changes_nothing)]
            with ThreadPoolExecutor(self._options.threads) as pool:
                list(pool.map(lambda one: self._compile(*one), [one for one in work if one[1]]))
            for trial in some:
                yield trial, {place: self._compared(trial, place) for place in self._places(trial)}
                shutil.rmtree(self._folder / trial.name, ignore_errors=True)

    def _places(self, trial: Trial) -> list[Place]:
        return places(trial, self._options) if trial.need is None or trial.need.holds() else []

    def _compared(self, trial: Trial, place: Place) -> tuple[np.ndarray, np.ndarray]:
        def measured():
            engines = self._folder / "usual", self._engine(trial)
            return compare(engines, trial, self._scenes[place], self._reference(place), self._options)

        usual, other = kept(self._file(trial, place), measured)
        return usual, other

    def _reference(self, place: Place) -> Reference:
        samples = reference_samples(place, self._options)

        def rendered():
            with contextlib.closing(Worker(self._folder / "usual")) as usual:
                return [reference_renders(self._scenes[place], usual, samples, self._options)]

        (renders,) = kept(self._file(None, place), rendered)
        return reference_from(renders, samples)

    def _missing(self, trial: Trial) -> list[Place]:
        return [place for place in self._places(trial) if not self._file(trial, place).is_file()]

    def _compile(self, trial: Trial | None, places_of: Sequence[Place]) -> None:
        """The kernels of these scenes. None: of the engine as it is."""
        if trial is not None and trial.edits:
            edited(self._folder / trial.name, trial)
        with contextlib.closing(Worker(self._engine(trial))) as worker:
            for place in places_of:
                worker.load(self._scenes[place])
                worker.render(settings_of(trial, 1, self._options, seed=0))

    def _engine(self, trial: Trial | None) -> Path:
        """Another setting needs no other engine."""
        return self._folder / (trial.name if trial is not None and trial.edits else "usual")

    def _file(self, trial: Trial | None, place: Place) -> Path:
        """Named by all that decides what is measured. None: the reference."""
        asked = self._options
        way = inspect.getsource(compare), inspect.getsource(make_reference), WORKER.read_text()
        of_all = common.engine_digest(), way, self._digests[place], reference_samples(place, asked)
        of_trial = (
            (trial.name, trial.edits, trial.settings, trial.samples, trial.pairs(asked.seeds), asked.samples,
             asked.threads, common.processor()) if trial else ()
        )  # fmt: skip
        return asked.store / f"{hashlib.sha256(repr((of_all, of_trial)).encode()).hexdigest()[:20]}.npz"


def kept(path: Path, make: Callable[[], Sequence[np.ndarray]]) -> list[np.ndarray]:
    """What `make` gives, unless the file is there already. Under another name first: a file with its name is whole."""
    if not path.is_file():
        found = make()
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(".part.npz")
        np.savez(unfinished, *found)
        unfinished.replace(path)
    with np.load(path) as file:
        return [file[name] for name in file.files]


def groups(trials: Sequence[Trial], size: int) -> Iterator[Sequence[Trial]]:
    for first in range(0, len(trials), size):
        yield trials[first : first + size]


def row(trial: Trial, place: Place, usual: np.ndarray, other: np.ndarray, options) -> dict[str, str]:
    """Of the table, from `compare`'s arrays."""
    scene, size = place
    whole, trimmed = usual[WHOLE:].mean(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):  # of errors that are none: refused just below
        logs, errors = log_ratios(usual, other), standard_errors(usual, other)
    if min(whole, trimmed, *other[WHOLE:].mean(axis=1)) <= 0 or not np.isfinite(errors).all():
        raise br.ToolError(f"{scene}: the reference is too noisy for {trial.name!r}: give it more samples")
    ratios = [f"{ratio:.3f} ± {ratio * error:.3f}" for ratio, error in zip(np.exp(logs), errors, strict=True)]
    return {
        "instead": trial.name,
        "scene": scene,
        "resolution": "{}x{}".format(*size),
        "samples": str(trial.samples or options.samples),
        "pairs": str(usual.shape[1]),
        COST: ratios[WHOLE_COST],
        "the same, trimmed": ratios[TRIMMED_COST],
        "seconds": ratios[SECONDS],
        "relMSE": ratios[WHOLE],
        "trimmed relMSE": ratios[TRIMMED],
        "in the worst pixels": f"{1 - trimmed * (1 - TRIM) / whole:.0%}",
    }


def row_without(trial: Trial) -> dict[str, str]:
    """Of the table, where the machine lacks what the trial needs."""
    assert trial.need is not None
    names = ("the same, trimmed", "seconds", "relMSE", "trimmed relMSE", "in the worst pixels")
    return {"instead": trial.name, "scene": NOWHERE, "resolution": "", "samples": "", "pairs": "",
            COST: trial.need.otherwise, **dict.fromkeys(names, "")}  # fmt: skip


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"default: all of {', '.join(t.name for t in TRIALS)}")
    parser.add_argument("--resolution", type=resolution, default=(120, 80), metavar="WxH")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), default=64, metavar="N")
    parser.add_argument("--reference-samples", type=whole_number(1, 1 << 24), default=8192, metavar="N")
    parser.add_argument("--seeds", type=whole_number(2, 1000), default=6, metavar="N")
    parser.add_argument("--threads", type=whole_number(1, 1024), default=2, metavar="N")
    parser.add_argument("--fresh", action="store_true", help="forget what is kept of earlier runs, of all trials")
    parser.add_argument("--store", type=Path, default=common.ROOT / "out" / "trials", metavar="FOLDER",
                        help="for what has been measured; default: out/trials")  # fmt: skip
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
    for name, size in dict.fromkeys(place for trial in trials for place in places(trial, options)):
        common.prepare(common.scene_path(name), size, options.threads)
        scenes[name, size] = exported()
    if options.fresh:
        shutil.rmtree(options.store, ignore_errors=True)
    try:
        with tempfile.TemporaryDirectory() as folder:
            say(tabulated(trials, Measuring(scenes, Path(folder), options), options))
    finally:  # also where not all has been measured: the page is as the table
        if options.results == common.RESULTS:
            quote_list()


def tabulated(trials: Sequence[Trial], measuring: Measuring, options: argparse.Namespace) -> str:
    """The new rows. Those of a trial are written together: a mean is of all scenes. Raises at the end where the
    reference is too noisy for some."""
    found: list[dict] = []
    refused: list[str] = []
    table = ""
    for trial, measured in tqdm(measuring.of(trials), total=len(trials), file=sys.stderr):
        try:
            found += [row(trial, place, *engines, options) for place, engines in measured.items()]
            if not measured:
                found.append(row_without(trial))
            table = common.update_table("trials", KEYS, found, folder=options.results, note=NOTE)
        except br.ToolError as error:
            refused.append(str(error))
    if refused:
        raise br.ToolError("; ".join(refused))
    return table


def reference_samples(place: Place, options) -> int:
    """Of each of its renders: for all of them those that the options say for their resolution, in larger pictures as
    many samples on fewer for each pixel."""
    width, height = place[1]
    usual_width, usual_height = options.resolution
    return max(1, options.reference_samples * usual_width * usual_height // (width * height * REFERENCES))


def reference_renders(scene: Scene, usual: Worker, samples: int, options: argparse.Namespace) -> np.ndarray:
    usual.load(scene)
    asked = [settings_of(None, samples, options, seed=REFERENCE_SEED + k) for k in range(REFERENCES)]
    return np.stack([usual.render(settings)[0] for settings in asked])


def quote_list(page: Path = common.ROOT / "benchmarks" / "README.md", folder: Path = common.RESULTS) -> None:
    quote(page, section(common.read_table("trials", folder)), MARKS)


def section(table: list[dict[str, str]]) -> str:
    """What stands in benchmarks/README.md: the list and where it comes from, or that there is none."""
    if not table or not {*KEYS, "resolution"} <= set(table[0]):
        return "Not measured yet.\n"
    text = list_of_tried(table)
    trimmed = sorted({row["scene"] for row in table if row["scene"] != NOWHERE and has_fireflies(row)})
    if trimmed:
        text += f"\nOf relMSE without its worst 0.1 % of pixels, as those hold most of it: {', '.join(trimmed)}.\n"
    for size in sorted({row["resolution"] for row in table if row["scene"] != NOWHERE}):
        if variance := between_processes(table, size).variance:
            text += f"\nFrom process to process the same render's time differs by {math.sqrt(variance):.1%} ({size}).\n"
    return text + "\nScene by scene: [trials.md](results/trials.md).\n"


def list_of_tried(table: list[dict[str, str]]) -> str:
    """Of each technique, relMSE x seconds without it over that with it."""
    lines = []
    for trial in TRIALS:
        rows_of = [row for row in table if row["instead"] == trial.name]
        found = [row for row in rows_of if row["scene"] != NOWHERE]
        if not rows_of or trial.changes_nothing:
            continue
        gain, scenes, where = rows_of[0][COST], "", ""
        if found:
            noise = between_processes(table, found[0]["resolution"])
            gain, scenes = gain_of([cost_of(row) for row in found], trial.kept, noise)
            where = f"{found[0]['resolution']}, {found[0]['samples']} samples, {scenes_of(found)}"
        lines.append(
            {
                "tried": trial.tried,
                "gain": gain,
                "least and most": scenes,
                "pictures": where,
                "price": trial.price() if callable(trial.price) else trial.price,
                "kept": "yes" if trial.kept else "no",
            }
        )
    return common.markdown(lines) if lines else ""


def scenes_of(found: list[dict[str, str]]) -> str:
    names = [row["scene"] for row in found]
    return "all samples" if set(names) == set(common.SCENES) else ", ".join(names)


class Cost(NamedTuple):
    """Of a trial on a scene: the logarithm of its relMSE x seconds as a multiple of the engine's own, the variance of
    that, and of how many pairs both come."""

    scene: str
    log: float
    variance: float
    pairs: int


def cost_of(row: dict[str, str]) -> Cost:
    """Of a row of trials.csv."""
    log, variance = logarithm(row["the same, trimmed" if has_fireflies(row) else COST])
    return Cost(row["scene"], log, variance, int(row["pairs"]))


def has_fireflies(row: dict[str, str]) -> bool:
    """Whether most of the engine's own relMSE is that of a thousandth of its pixels."""
    return float(row["in the worst pixels"].rstrip("%")) / 100 > FIREFLIES


def logarithm(text: str) -> tuple[float, float]:
    """(logarithm, its variance) of "ratio ± standard error"."""
    ratio, error = map(float, text.split(" ± "))
    return math.log(ratio), (error / ratio) ** 2


class Noise(NamedTuple):
    """That a pair of processes adds to the logarithm of a ratio of seconds: its variance, and of how many pairs of
    processes that is known."""

    variance: float
    pairs: int


def between_processes(table: list[dict[str, str]], size: str) -> Noise:
    """Of pictures of this size, from where the two engines are the same, beyond what the renders' own scatter explains:
    the mean is known to be 0, so each pair of processes is a degree of freedom."""
    names = [trial.name for trial in TRIALS if trial.changes_nothing]
    same = [row for row in table if row["instead"] in names and row["resolution"] == size]
    logs = [logarithm(row["seconds"]) for row in same]
    variance = float(np.mean([log**2 - variance for log, variance in logs])) if logs else 0.0
    return Noise(max(variance, 0.0), len(logs))


def gain_of(costs: list[Cost], kept: bool, noise: Noise) -> tuple[str, str]:
    """Geometric mean over the scenes with its 95 % interval as it was measured, and what it is where it is least and
    most. The quantile is Student's, its degrees of freedom as Satterthwaite has them: of the scenes' own variances, and
    of the processes' noise, which each scene has by itself but whose size is known of all only once."""
    sign = 1 if kept else -1
    gains = {cost.scene: sign * cost.log for cost in costs}
    middle = sum(gains.values()) / len(gains)
    parts = [(cost.variance, cost.pairs - 1) for cost in costs]
    if noise.variance:
        parts.append((len(costs) * noise.variance, noise.pairs))
    half, total = 0.0, sum(variance for variance, _ in parts)
    if total > 0:
        freedom = total**2 / sum(variance**2 / known for variance, known in parts)
        half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, freedom)) * math.sqrt(total) / len(gains)
    interval = f"{math.exp(middle):.2f} ({math.exp(middle - half):.2f} to {math.exp(middle + half):.2f})"
    if abs(middle) <= half:
        interval += ": no difference"
    least, most = min(gains, key=gains.__getitem__), max(gains, key=gains.__getitem__)
    return interval, f"{math.exp(gains[least]):.2f} on {least}, {math.exp(gains[most]):.2f} on {most}"


NOTE = f"""\
Multiples of the engine's own, with the standard error by the bootstrap over the seeds; above 1 the engine is better as
it is. Seconds are of the render phase, the median of pairs; relMSE is without that of the reference, the mean over the
seeds. Trimmed: without the worst 0.1 % of a picture's numbers. "In the worst pixels" is the share of the engine's own
relMSE that those hold; from {FIREFLIES:.0%} on, the list of what was tried takes what is trimmed. "The same engine" has
no edit: what its seconds are off 1 is noise. Without figures are trials that would change nothing on this machine.

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
        except KeyboardInterrupt:
            print("trials.py: interrupted; the same command goes on from here", file=sys.stderr)
            return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
