"""The trials of benchmarks/trials.py still fit the engine."""

from __future__ import annotations

import difflib
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
import scenes
from scipy import stats

from engine import Settings, features
from engine.adaptive import MIN_SAMPLES
from engine.features import Features
from engine.kernels.batch import new_batch
from engine.pack import pack
from engine.schedule import schedule
from tools import metrics
from tools.blender_render import ToolError
from tools.exported import exported
from tools.lobe_blender import enable_lobe


@pytest.fixture(scope="module")
def trials(script):
    return script("trials")


def test_each_edit_finds_its_text(trials, tmp_path):
    for k, trial in enumerate(trials.TRIALS):
        trials.edited(tmp_path / str(k), trial)
        Settings(**trial.settings).validate()
        assert set(trial.scenes) <= set(trials.common.SCENES)
        assert trial.changes_nothing == trial.tried.startswith("nothing")
    assert len({trial.name for trial in trials.TRIALS}) == len({trial.tried for trial in trials.TRIALS}) == k + 1


def test_what_depends_on_the_size_is_tried_on_large_pictures(trials):
    """Where rays of neighbours lie close together, by packets and the order of pixels, and where passes are long."""
    large = {trial.name for trial in trials.TRIALS if trial.resolution == (768, 512)}
    packets = {trial.name for trial in trials.TRIALS if trial.name.startswith(("packets", "single rays", "a batch"))}
    assert packets and packets <= large
    assert {"pixels of a tile in Morton order", "huge pages for Embree", "the same engine, large pictures"} <= large


def test_trials_are_left_out_where_they_change_nothing(trials):
    """By the features of the sample scenes."""
    enable_lobe()
    needed = {}
    for name in trials.common.SCENES:
        trials.common.prepare(trials.common.scene_path(name), (8, 6), 1)
        needed[name] = pack(exported(), Settings()).features
    acts = {
        "lobes chosen by kd and ks": lambda f: f.phong,
        "lights chosen by power": lambda f: f.emitter_choice == features.EMITTER_TREE,
        "a light tree that knows the lobe": lambda f: f.phong and f.emitter_choice == features.EMITTER_TREE,
        "groups of lights by even shares": lambda f: (
            (f.emitter_choice != features.NO_EMITTER) + (f.suns > 0) + (f.world == features.IMAGE_WORLD) > 1
        ),
        "lamps in Embree's scene, however few": lambda f: f.lamp_shapes & features.LISTED_LAMPS,
        "emitters sampled by area": lambda f: f.mesh_emitters or f.lamp_kinds & features.RECTANGLE,
        "spheres sampled by area": lambda f: f.lamp_kinds & features.SPHERE,
        "packets for all rays": lambda f: f.instances,
        "packets for the camera's rays alone": lambda f: not f.instances,
    }
    for name, changes in acts.items():
        tried = set(trials.chosen([name])[0].scenes)
        changed = {scene for scene, found in needed.items() if changes(found)}
        large = trials.chosen([name])[0].resolution is not None
        assert tried <= changed if large else tried == changed, name


@pytest.mark.parametrize(("name", "features", "holds"), [
    ("lanes moved to the front one by one", {"avx2": True, "avx512f": False}, True),
    ("lanes moved to the front one by one", {"avx2": True, "avx512f": True}, False),
    ("lanes moved to the front one by one", {}, False),
])  # fmt: skip
def test_what_a_processor_lacks_is_known(trials, monkeypatch, name, features, holds):
    monkeypatch.setattr(trials.binding, "get_host_cpu_features", lambda: features)
    assert trials.chosen([name])[0].need.holds() == holds


def test_packets_of_sixteen_are_what_narrower_ones_are_compared_with(trials, monkeypatch):
    need = trials.chosen(["packets of eight rays"])[0].need
    for width, holds in ((16, True), (8, False), (4, False)):
        monkeypatch.setattr(trials, "PACKET_WIDTH", width)
        assert need.holds() == holds


def edited(trials, name: str, folder: Path) -> Path:
    """The folder, with the engine of this trial."""
    trials.edited(folder, trials.chosen([name])[0])
    return folder


def changed(trials, folder: Path, name: str) -> list[str]:
    """Lines of a file of the engine that a trial has changed or added."""
    before, after = ((root / "engine" / "kernels" / name).read_text() for root in (trials.common.ROOT, folder))
    return [line[2:].strip() for line in difflib.ndiff(before.splitlines(), after.splitlines()) if line[0] == "+"]


def test_lights_by_power_are_another_choice_between_children_and_nothing_else(trials, tmp_path):
    """The same estimate shares the groups out, and says what is below the horizon."""
    lines = changed(trials, edited(trials, "lights chosen by power", tmp_path), "light/tree.py")
    assert lines == ["return left_child, left[POWER], right_child, right[POWER]"]


def test_adaptive_sampling_decides_many_times_at_its_usual_threshold(trials):
    trial = trials.chosen(["adaptive sampling"])[0]
    assert "adaptive_threshold" not in trial.settings
    width, height = trials.parse([]).resolution
    passes = schedule(trial.samples, width * height)
    decisions = [first + count for first, count in passes if first + count >= MIN_SAMPLES]
    assert len(decisions) > 10 and decisions[-1] == trial.samples


def run(folder: Path, code: str) -> str:
    """What a program prints that imports the engine in this folder."""
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_morton_order_has_each_sample_of_a_tile_once(trials, tmp_path):
    """In Python, not compiled. The tile isn't square, and batches end within pixels."""
    found = run(edited(trials, "pixels of a tile in Morton order", tmp_path), MORTON)
    places = [tuple(map(int, line.split())) for line in found.splitlines()]
    assert sorted(places) == sorted((x, y, k) for x in range(10, 15) for y in range(20, 26) for k in range(7, 10))
    pixels = [place[:2] for place in places[::3]]
    assert pixels[:8] == [(10, 20), (11, 20), (10, 21), (11, 21), (12, 20), (13, 20), (12, 21), (13, 21)]


MORTON = """
import types
import numpy as np
from engine.kernels import staged
def plain(f):
    return types.FunctionType(f.py_func.__code__, known)
known = {**vars(staged), "BATCH": 8}
known["_even_bits"] = plain(staged._even_bits)
fill = plain(staged._next_samples)
words = np.zeros((8, 8), np.uint32)
batch = types.SimpleNamespace(sample_words=words)
tile, x, y, done, n = (10, 20, 15, 26), 10, 20, 0, 1
while n:
    n, x, y, done = fill(batch, tile, 7, 3, (0, 0), np.ones((1, 1), bool), x, y, done)
    for k in range(n):
        print(*words[[staged.rows.X, staged.rows.Y, staged.rows.INDEX], k])
"""


def test_spheres_by_area_are_sampled_as_their_density_says(trials, tmp_path):
    """The mean of 1 / density is the solid angle; the density of a direction is that of the draw."""
    found = run(edited(trials, "spheres sampled by area", tmp_path), SPHERE)
    mean, expected, largest_difference, farthest = map(float, found.split())
    assert mean == pytest.approx(expected, rel=0.02)
    assert largest_difference < 1e-3 and farthest < 1e-4


SPHERE = """
import math, numba, numpy as np
from engine.kernels.light.spherical import sample_sphere, sphere_pdf
F = np.float32
p, n, center, radius = (F(0.3), F(-0.2), F(0.1)), (F(0), F(0), F(1)), (F(1.0), F(0.5), F(1.2)), F(0.8)
@numba.njit
def draw(u):
    found = np.zeros((len(u), 6))
    for i in range(len(u)):
        wi, t, pdf = sample_sphere(p, n, center, radius, u[i, 0], u[i, 1])
        found[i] = wi[0], wi[1], wi[2], t, pdf, sphere_pdf(p, n, center, radius, wi)
    return found
found = draw(np.random.default_rng(1).random((200_000, 2), np.float32))
to = np.subtract(center, p).astype(float)
off = np.abs(np.linalg.norm(found[:, :3] * found[:, 3:4] - to, axis=1) - radius)
solid_angle = 2 * math.pi * (1 - math.sqrt(1 - radius**2 / (to @ to)))
print((1 / found[:, 4]).mean(), solid_angle, np.abs(found[:, 5] / found[:, 4] - 1).max(), off.max())
"""


def test_an_edit_of_what_is_gone_is_refused(trials, tmp_path):
    with pytest.raises(ToolError, match="write the trial 'old' anew"):
        trials.edited(
            tmp_path, trials.Trial("old", "new", True, "none", [("engine/accel.py", "no such text", "other")])
        )


def test_names_are_checked(trials):
    assert [trial.name for trial in trials.chosen(["single rays"])] == ["single rays"]
    with pytest.raises(ToolError, match="no trial 'double rays'"):
        trials.chosen(["double rays"])


def test_prices_are_those_of_the_arrays(trials):
    prices = {t.name: t.price() if callable(t.price) else t.price for t in trials.TRIALS}
    assert prices["independent random numbers"] == f"a table of {4 * 4096 * 4:,} bytes, for all scenes"
    assert prices["lights chosen by power"] == "136 bytes an emitter"  # two nodes of a cache line, and a path
    assert prices["path by path"] == f"{new_batch(Features()).nbytes:,} bytes a thread, code"


def test_ratios_and_their_errors_are_of_the_same_estimate(trials):
    """Seeds that err alike in both engines: each error is large, and their ratio is sure. Times are pairs too."""
    random = np.random.default_rng(3)
    usual = np.exp(random.normal(0, 1, (3, 8)))
    other = usual * np.array([[1.5], [0.5], [0.8]])
    assert trials.log_ratios(usual, other) == pytest.approx(np.log([1.5, 0.5, 0.8, 0.75, 1.2]))
    assert trials.standard_errors(usual, other) == pytest.approx(np.zeros(5), abs=1e-12)


def test_the_bootstrap_finds_the_error_of_the_ratio_of_means(trials):
    """Lognormal errors: the standard deviation of what many experiments find."""
    random = np.random.default_rng(5)
    experiments = np.exp(random.normal(0, 0.3, (400, 2, 3, 8)))
    found = np.array([trials.log_ratios(*pair) for pair in experiments])
    errors = np.array([trials.standard_errors(*pair) for pair in experiments[:20]])
    assert np.sqrt((errors**2).mean(axis=0)) == pytest.approx(found.std(axis=0), rel=0.25)


def test_the_reference_gives_back_what_it_adds(trials):
    """Pictures without any error measure the reference's own noise, and it is taken off again."""
    random, truth = np.random.default_rng(7), np.full((64, 64, 3), 0.7)
    noisy = [truth + random.normal(0, 0.02, truth.shape) for _ in range(trials.REFERENCES)]
    reference = trials.reference_from(np.stack(noisy), 1)
    own = 0.02**2 / trials.REFERENCES / (0.7**2 + metrics.REL_MSE_EPSILON)
    assert reference.noise == pytest.approx(own, rel=0.05)
    assert abs(reference.errors(truth)[0]) < 0.05 * own
    off = truth + random.normal(0, 0.01, truth.shape)
    assert reference.errors(off)[0] == pytest.approx(own, rel=0.05)  # 0.01 is half of 0.02
    firefly = truth.copy()
    firefly[0, 0] = 100
    whole, trimmed = reference.errors(firefly)
    assert whole > 1 and abs(trimmed) < 0.05 * own


SIZE = "120x80"


def rows_of(trials, name: str, *costs: float, spread: float = 0.02, share: str = "10%", seconds=1.0) -> list[dict]:
    """Of trials.csv, as so many scenes: costs with a standard error of `spread`, four times those where trimmed."""
    return [
        {
            "instead": name,
            "scene": f"scene {k}",
            "resolution": SIZE,
            "samples": "64",
            "pairs": "8",
            "relMSE x seconds": f"{cost:.3f} ± {cost * spread:.3f}",
            "the same, trimmed": f"{cost * 4:.3f} ± {cost * 4 * spread:.3f}",
            "seconds": f"{seconds:.3f} ± 0.000",
            "relMSE": f"{cost:.3f} ± {cost * spread:.3f}",
            "trimmed relMSE": f"{cost * 4:.3f} ± {cost * 4 * spread:.3f}",
            "in the worst pixels": share,
        }
        for k, cost in enumerate(costs)
    ]


def listed(trials, table: list[dict]) -> list[list[str]]:
    return [line.strip("| ").split(" | ") for line in trials.list_of_tried(table).splitlines()[2:]]


def test_the_list_of_what_was_tried_turns_gains_about(trials):
    """A technique that the engine has gains what its trial lost; one that it hasn't, what its trial gained."""
    kept, other = rows_of(trials, "no roulette", 1.25, 1.25), rows_of(trials, "balance heuristic", 1.25, 1.25)
    roulette, balance = listed(trials, kept + other)
    assert roulette[1].startswith("1.25 (1.2") and balance[1].startswith("0.80 (0.7")
    pictures = "120x80, 64 samples, scene 0, scene 1"
    assert roulette[2:] == ["1.25 on scene 0, 1.25 on scene 0", pictures, "a random number for each vertex", "yes"]
    assert balance[2:] == ["0.80 on scene 0, 0.80 on scene 0", pictures, "none", "no"]


def test_the_list_says_where_a_trial_would_change_nothing(trials):
    """By the table, not by the machine that writes the list; figures of another machine count more."""
    trial = trials.chosen(["packets of eight rays"])[0]
    without = [trials.row_without(trial)]
    ((_, gain, scenes, pictures, *_),) = listed(trials, without)
    assert gain.startswith("not on this processor") and scenes == pictures == ""
    assert set(without[0]) == set(rows_of(trials, trial.name, 1.0)[0])
    trials.section(without)  # neither noise nor fireflies are looked for there
    ((_, gain, *_),) = listed(trials, without + rows_of(trials, trial.name, 1.25))
    assert gain.startswith("1.25")


def test_intervals_have_the_quantile_of_so_few_seeds(trials):
    """Two scenes of eight pairs, as sure as each other: fourteen degrees of freedom."""
    (line,) = listed(trials, rows_of(trials, "no roulette", 0.9, 1.5))
    half = stats.t.ppf(0.975, 14) * 0.02 * 2**0.5 / 2
    middle = (0.9 * 1.5) ** 0.5
    assert line[1] == f"{middle:.2f} ({middle * np.exp(-half):.2f} to {middle * np.exp(half):.2f})"
    assert line[2] == "0.90 on scene 0, 1.50 on scene 1"
    assert listed(trials, rows_of(trials, "no roulette", 0.98, 1.04))[0][1].endswith(": no difference")


def test_what_the_same_engine_differs_from_itself_widens_all_intervals(trials):
    table = rows_of(trials, "no roulette", 1.08, 1.08)
    assert not listed(trials, table)[0][1].endswith(": no difference")
    same = rows_of(trials, "the same engine", 1.0, 1.0, seconds=1.1)
    large = [row | {"resolution": "768x512"} for row in same]
    assert not listed(trials, table + large)[0][1].endswith(": no difference")  # those are of other pictures
    table += same
    assert trials.between_processes(table, SIZE) == (pytest.approx(np.log(1.1) ** 2), 2)
    ((tried, gain, *_),) = listed(trials, table)  # no row for what isn't a technique
    assert tried == "Russian roulette by throughput" and gain.endswith(": no difference")
    assert "differs by 9.5% (120x80)" in trials.section(table)


def test_the_noise_of_processes_is_known_of_no_more_pairs_than_there_were(trials):
    """Without any other noise the interval is that of a mean of six, whose scatter three pairs of processes tell."""
    noise = trials.Noise(0.01**2, 3)
    gain, _ = trials.gain_of([trials.Cost(f"scene {k}", 1.0, 0.0, 1000) for k in range(6)], True, noise)
    half = stats.t.ppf(0.975, 3) * 0.01 / 6**0.5
    assert gain == f"{np.exp(1):.2f} ({np.exp(1 - half):.2f} to {np.exp(1 + half):.2f})"


def test_intervals_hold_the_truth_as_often_as_they_say(trials):
    """Renders and processes that scatter alike: a whole benchmark, again and again, of a technique that changes
    nothing."""
    random, held, runs = np.random.default_rng(11), 0, 400
    for _ in range(runs):
        own, processes = random.normal(0, 0.01, (2, 6)) + random.normal(0, 0.02, (2, 6)), 0.01**2
        noise = trials.Noise(max(float(np.mean(own[0] ** 2 - processes)), 0.0), 6)
        costs = [trials.Cost(f"scene {k}", log, processes, 8) for k, log in enumerate(own[1])]
        held += trials.gain_of(costs, True, noise)[0].endswith(": no difference")
    assert 0.92 < held / runs <= 1


def test_fireflies_are_left_out_of_the_verdict_and_it_is_said_where(trials):
    (line,) = listed(trials, rows_of(trials, "no roulette", 1.0, share="80%"))
    assert line[1].startswith("4.00 (")
    assert "as those hold most of it: scene 0." in trials.section(rows_of(trials, "no roulette", 1.0, share="80%"))
    assert "hold most" not in trials.section(rows_of(trials, "no roulette", 1.0))


def test_a_row_is_written_from_what_was_measured(trials):
    usual = np.array([[1.0, 1.0], [0.2, 0.2], [0.1, 0.1]])
    other, place = usual * np.array([[2.0], [0.5], [0.75]]), ("lamps", (120, 80))
    row = trials.row(trials.chosen(["no roulette"])[0], place, usual, other, trials.parse([]))
    assert row == {
        "instead": "no roulette",
        "scene": "lamps",
        "resolution": "120x80",
        "samples": "64",
        "pairs": "2",
        "relMSE x seconds": "1.000 ± 0.000",
        "the same, trimmed": "1.500 ± 0.000",
        "seconds": "2.000 ± 0.000",
        "relMSE": "0.500 ± 0.000",
        "trimmed relMSE": "0.750 ± 0.000",
        "in the worst pixels": "50%",
    }


@pytest.mark.parametrize("engine", [0, 1])
@pytest.mark.parametrize("errors", [1, 2])
@pytest.mark.parametrize("seeds", [[-0.3, 0.1], [-0.1, 0.3]])
def test_errors_below_those_of_the_reference_are_refused(trials, engine, errors, seeds):
    """Whole ones or trimmed, in their mean or in a mean that the bootstrap draws."""
    measured = np.array([[[1.0, 1.0], [0.2, 0.2], [0.1, 0.1]]] * 2)
    measured[engine, errors] = seeds
    with pytest.raises(ToolError, match="lamps: the reference is too noisy for 'no roulette'"):
        trials.row(trials.chosen(["no roulette"])[0], ("lamps", (8, 8)), *measured, trials.parse([]))


def small(*names: str) -> dict:
    """Scenes by their places."""
    return {(name, (120, 80)): f"scene {name}" for name in names}


class Made:
    """Stands for a process that renders: pictures of a few numbers, that differ with the seed."""

    rendered: ClassVar[list[dict]] = []
    last = 10**9  # render after which it is interrupted

    def __init__(self, engine: Path):
        assert (engine / "engine").is_dir()

    def load(self, scene) -> None:
        pass

    def render(self, settings: dict) -> tuple[np.ndarray, float]:
        if len(self.rendered) == self.last:
            raise KeyboardInterrupt
        self.rendered.append(settings)
        noise = np.random.default_rng(settings["seed"]).normal(0, settings["samples"] ** -0.5, (8, 8, 3))
        return 1 + noise, 1.0

    def close(self) -> None:
        pass


def test_an_interrupted_run_goes_on_where_it_was(trials, monkeypatch, tmp_path):
    """Nothing that was finished is rendered again; names choose trials; a second run renders nothing at all."""
    monkeypatch.setattr(trials, "Worker", Made)
    monkeypatch.setattr(trials.common, "SCENES", ("a", "b"))
    monkeypatch.setattr(Made, "rendered", [])
    options = trials.parse(["--store", str(tmp_path / "store"), "--results", str(tmp_path), "--seeds", "2"])
    some = trials.chosen(["no roulette", "uniform directions for diffuse"])

    def table(run: int) -> list[dict]:
        folder = tmp_path / str(run)
        folder.mkdir()
        trials.tabulated(some, trials.Measuring(small("a", "b"), folder, options), options)
        return trials.common.read_table("trials", tmp_path)

    monkeypatch.setattr(Made, "last", 25)
    with pytest.raises(KeyboardInterrupt):
        table(1)
    assert trials.common.read_table("trials", tmp_path) == []  # means are of all scenes
    monkeypatch.setattr(Made, "last", 10**9)
    assert len(table(2)) == 4
    long = [settings for settings in Made.rendered if settings["samples"] == options.samples]
    assert len(long) == 4 * 2 * 2 + 3  # of the second scene three of four were made before, in vain
    assert len([settings for settings in Made.rendered if settings["seed"] >= trials.REFERENCE_SEED]) == 2 * 4
    count = len(Made.rendered)
    assert len(table(3)) == 4 and len(Made.rendered) == count


def test_what_the_machine_lacks_is_not_measured(trials, monkeypatch, tmp_path):
    monkeypatch.setattr(trials, "PACKET_WIDTH", 8)
    options = trials.parse(["--store", str(tmp_path / "store"), "--results", str(tmp_path)])
    measuring = trials.Measuring({}, tmp_path, options)  # a process would look for scenes here
    trials.tabulated(trials.chosen(["packets of eight rays"]), measuring, options)
    (row,) = trials.common.read_table("trials", tmp_path)
    assert (row["scene"], row["seconds"]) == (trials.NOWHERE, "")
    assert row[trials.COST].startswith("not on this processor")


def test_references_of_large_pictures_have_as_many_samples(trials):
    options = trials.parse(["--reference-samples", "8192", "--resolution", "120x80"])
    usual, large = (trials.reference_samples(("a", size), options) for size in ((120, 80), (768, 512)))
    assert usual == 8192 // trials.REFERENCES and large == 8192 * 120 * 80 // (768 * 512 * trials.REFERENCES)


def test_what_is_refused_does_not_end_the_others(trials, monkeypatch, tmp_path):
    """One trial's errors are below the reference's own on one scene: it has no row, and the next has all."""
    good, some = np.ones((3, 2)), trials.chosen(["no roulette", "balance heuristic"])
    a, b = small("a", "b")
    measured = [(some[0], {a: (good, good), b: (good, -good)}), (some[1], {a: (good, good), b: (good, good)})]
    options = trials.parse(["--results", str(tmp_path)])
    measuring = SimpleNamespace(of=lambda _: iter(measured))
    with pytest.raises(ToolError, match="b: the reference is too noisy for 'no roulette'"):
        trials.tabulated(some, measuring, options)
    rows = trials.common.read_table("trials", tmp_path)
    assert [(row["instead"], row["scene"]) for row in rows] == [("balance heuristic", "a"), ("balance heuristic", "b")]


def test_what_is_measured_otherwise_is_measured_anew(trials, tmp_path):
    """The file's name tells engines, scenes, trials and options apart."""
    names = set()
    for words in [], ["--samples", "32"], ["--seeds", "3"], ["--threads", "1"], ["--reference-samples", "64"]:
        options = trials.parse([*words, "--store", str(tmp_path)])
        folder = tmp_path / str(len(names))
        folder.mkdir()
        scenes_of = small("a", "b")
        measuring = trials.Measuring(scenes_of, folder, options)
        names |= {measuring._file(trial, place).name for trial in (*trials.TRIALS, None) for place in scenes_of}
    references = 2 * 2  # by their own samples alone
    assert len(names) == 5 * 2 * len(trials.TRIALS) + references


@pytest.mark.long  # compiles the engine with an empty cache
def test_processes_render_what_a_trial_compares(trials, monkeypatch, tmp_path):
    """A small picture, by an engine with an edit beside the engine as it is: other random numbers, other errors."""
    words = ["--samples", "8", "--reference-samples", "64", "--seeds", "2", "--store", str(tmp_path / "store")]
    trial = trials.chosen(["independent random numbers"])[0]
    monkeypatch.setattr(trials.common, "SCENES", ("sphere",))
    options = trials.parse([*words, "--resolution", "16x16"])
    measuring = trials.Measuring({("sphere", (16, 16)): scenes.lit_sphere(size=16)}, tmp_path, options)
    ((_, found),) = measuring.of([trial])
    ((usual, other),) = found.values()
    assert usual.shape == other.shape == (3, 2)
    assert (usual[0] > 0).all() and (other[0] > 0).all() and (usual[1] != other[1]).all()


def test_the_list_is_written_from_the_kept_rows_alone(trials, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{trials.MARKS[0]}old\n{trials.MARKS[1]}after\n")
    rows = rows_of(trials, "no roulette", 1.25, 1.25)
    trials.common.update_table("trials", trials.KEYS, rows, folder=tmp_path)
    trials.quote_list(page, tmp_path)
    table = trials.section(rows)
    assert "| Russian roulette by throughput |" in table and "(results/trials.md)" in table
    assert page.read_text() == f"before\n{trials.MARKS[0]}{table}{trials.MARKS[1]}after\n"
    trials.quote_list(page, tmp_path / "nothing")
    assert "Not measured yet" in page.read_text() and "](" not in page.read_text()


def test_the_readme_of_the_benchmarks_quotes_the_list(trials, repository):
    page = (repository / "benchmarks" / "README.md").read_text(encoding="utf-8")
    quoted = page.split(trials.MARKS[0])[1].split(trials.MARKS[1])[0]
    kept = trials.common.read_table("trials", trials.common.RESULTS)
    assert quoted == trials.section(kept), "write it anew: python benchmarks/trials.py --list"
    names = [trial.name for trial in trials.TRIALS]
    assert [row["instead"] for row in kept if row["instead"] not in names] == []
