"""The benchmark from first to last with a renderer that needs no time: what it asks for, keeps, finds again, writes."""

from __future__ import annotations

import contextlib
import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import common
from benchmarks.convergence import analysis, campaign, page, plan, runs, tables
from benchmarks.convergence.plan import VARIANTS, Job, Settings, Variant, job

RESOLUTION = (24, 16)
TRUTH = np.random.default_rng(3).uniform(0.1, 2.0, (16, 24, 3))
BEST = Variant(light_tree=False)
CODES = {"LOBE": "l", "CYCLES": "c"}


def is_best(job: Job) -> bool:
    return job.variant is not None and (job.variant.light_tree, job.variant.guiding) == (False, False)


class FakeRenderer:
    """Lobe: error 1 / samples and 1 ms a sample. Cycles: twice the error, thrice the time; BEST is half as noisy.

    slowing: each render takes longer than the one before by this share. bright: in Lobe's probes one value is off by
    so much. file_samples: as the file has them. textured: the world is, and Cycles takes long over it unless it is told
    how large a map to make.
    """

    def __init__(
        self,
        stop_after: int | None = None,
        slowing: float = 0.0,
        bright: float = 0.0,
        textured: bool = False,
        file_samples: int = 128,
    ) -> None:
        self.jobs: list[Job] = []
        self.textured, self.file_samples = textured, file_samples
        self.stop_after = stop_after
        self.slowing = slowing
        self.bright = bright

    def __call__(self, job: Job) -> runs.Render:
        if self.stop_after is not None and len(self.jobs) >= self.stop_after:
            raise KeyboardInterrupt
        self.jobs.append(job)
        factor, cost = (1.0, 1e-3) if job.engine == "LOBE" else (2.0 if is_best(job) else 4.0, 3e-3)
        cost *= (1.0 + self.slowing) ** len(self.jobs)
        rng = np.random.default_rng(job.seed)
        noise = np.sqrt(factor / job.samples * (TRUTH**2 + 0.01)) * rng.normal(size=TRUTH.shape)
        if (job.engine, job.purpose) == ("LOBE", "probe"):
            noise[3, 4, 0] += self.bright
        told = 0.0 if job.engine == "LOBE" else None
        seconds = {"export": 0.0, "build": told, "compile": told, "render": cost * job.samples}
        return runs.Render(
            (TRUTH + noise).astype(np.float32),
            {"seconds": seconds | {"total": self.fixed(job) + seconds["render"]}, "exposure": 0.5, "osl": False,
             "textured_world": self.textured, "file_samples": self.file_samples},
        )  # fmt: skip

    def fixed(self, job: Job) -> float:
        """Seconds before the first sample."""
        return 0.03 if self.textured and job.variant is not None and job.variant.world_map == 0 else 1e-4


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.blend"
    path.write_bytes(b"a scene")
    return path


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(analysis, "flip", lambda picture, reference: 0.5)
    monkeypatch.setattr(analysis, "BOOTSTRAP_RUNS", 100)


def settings(scene, **changes) -> Settings:
    return Settings(scene, **{"budget": 60.0, "resolution": RESOLUTION, "seeds": 4, **changes})


def measure(tmp_path, chosen: Settings, renderer: FakeRenderer, codes=CODES) -> campaign.Outcome:
    store = runs.Store(tmp_path / "store", chosen, renderer, codes)
    return campaign.Campaign(chosen, store, lambda what, spent: None).measure()


def test_a_bright_pixel_in_the_probe_adds_no_level(tmp_path, scene):
    outcome = measure(tmp_path, settings(scene), FakeRenderer(bright=1e3))
    assert [level.samples for level in outcome.levels["LOBE"]] == [1, 4, 16, 64]


def test_the_campaign_finds_what_was_put_in(tmp_path, scene):
    outcome = measure(tmp_path, settings(scene), FakeRenderer())
    assert outcome.reference.verdict != "DIFFER"  # so few pixels leave it open
    assert outcome.variant == BEST
    assert [[trial.variant for trial in trials] for trials in outcome.trials] == [
        list(VARIANTS), [BEST, replace(BEST, tabulated=True)],
    ]  # fmt: skip
    lobe, cycles = (outcome.levels[engine] for engine in ("LOBE", "CYCLES"))
    assert [level.samples for level in lobe] == [level.samples for level in cycles] == [1, 4, 16, 64]
    assert analysis.slopes(lobe)[0] == pytest.approx(-1.0, abs=0.05)
    ratio = analysis.time_ratio(analysis.curve(lobe, "total"), analysis.curve(cycles, "total"))
    assert ratio.mean[0] == pytest.approx(6.0, rel=0.1)  # twice the samples, three times as long each
    fast, slow = outcome.shots
    assert (fast.engine, slow.engine) == ("LOBE", "CYCLES")
    assert fast.render.total == pytest.approx(slow.render.total, rel=0.3)


def test_a_world_with_a_texture_is_sampled_by_the_map_that_is_quickest_in_all(tmp_path, scene):
    """Its preparation is no sampling, and counts all the same."""
    renderer = FakeRenderer(textured=True)
    outcome = measure(tmp_path, settings(scene), renderer)
    stages = [[trial.variant for trial in trials] for trials in outcome.trials]
    assert stages[:2] == [list(VARIANTS), [BEST, replace(BEST, world_map=1024), replace(BEST, world_map=2048)]]
    assert all(variant.world_map == outcome.variant.world_map for stage in stages[2:] for variant in stage)
    assert outcome.variant.world_map in (1024, 2048)
    assert {job.variant for job in renderer.jobs if (job.purpose, job.engine) == ("level", "CYCLES")} == {
        outcome.variant
    }
    (row,) = tables.write([outcome], tmp_path / "results")
    assert row["Cycles' settings"] == f"light tree off, guiding off, world map {outcome.variant.world_map}"
    assert "; then light tree off, guiding off: " in row["pilot: time x error to the best"]
    pilot = [job for job in renderer.jobs if job.purpose == "pilot"]
    seeds = (4 + 3 + 2) * plan.PILOT_SEEDS
    assert len({(job.seed, job.variant) for job in pilot}) == len(pilot) == seeds


@pytest.mark.parametrize(("pays_from", "chosen"), [(64, True), (256, False)])
def test_guiding_that_pays_in_longer_renders_is_chosen(tmp_path, scene, pays_from, chosen):
    class Learning(FakeRenderer):
        def __call__(self, job: Job) -> runs.Render:
            render = super().__call__(job)
            if job.variant is not None and job.variant.guiding and job.samples >= pays_from:
                return replace(render, picture=(TRUTH + (render.picture - TRUTH) / 4).astype(np.float32))
            return render

    outcome = measure(tmp_path, settings(scene, budget=20.0), Learning())
    assert [trials[0].samples for trials in outcome.trials] == [16, 16, 64]
    assert not campaign.best(outcome.trials[-2]).guiding
    assert outcome.variant.guiding == chosen


def test_bright_pixels_do_not_choose_the_variant():
    def trial(variant, error, trimmed, scatter, seconds=1.0):
        return campaign.Trial(variant, 16, error, trimmed, scatter, seconds, 0.9 * seconds)

    known = [trial(VARIANTS[0], 0.3, 0.2, 0.1), trial(BEST, 0.4, 0.1, 0.1)]
    assert campaign.best(known) == VARIANTS[0]
    assert campaign.best([known[0], replace(known[1], scatter=0.9)]) == BEST
    assert campaign.best([known[0], replace(known[1], error=0.2, seconds=1.6)]) == VARIANTS[0]


@pytest.mark.parametrize("slowing", [0.02, -0.02])
def test_a_machine_that_drifts_takes_nothing_from_the_ratio(tmp_path, scene, slowing):
    """Over all renders of the levels its speed changes twofold. What is compared is Lobe's level with Cycles' next."""
    renderer = FakeRenderer(slowing=slowing)
    outcome = measure(tmp_path, settings(scene, seeds=6), renderer)
    levels = [job for job in renderer.jobs if job.purpose == "level"]
    assert (1 + abs(slowing)) ** len(levels) > 2.0
    lobe, cycles = (analysis.curve(outcome.levels[engine], "total") for engine in ("LOBE", "CYCLES"))
    assert analysis.time_ratio(lobe, cycles).mean[0] == pytest.approx(6.0, rel=0.1)


@pytest.mark.parametrize("budget", [4.0, 6.0, 10.0, 40.0])
def test_whole_levels_within_the_budget(tmp_path, scene, budget):
    renderer = FakeRenderer(file_samples=1 << 20)
    measure(tmp_path, settings(scene, budget=budget), renderer)
    spent = sum((1e-3 if job.engine == "LOBE" else 3e-3) * job.samples for job in renderer.jobs)
    assert 0.25 * budget < spent < 1.03 * budget  # a level more is four times the samples
    levels = [(job.engine, job.samples) for job in renderer.jobs if job.purpose == "level"]
    assert {levels.count(level) for level in levels} == {4}


def test_after_an_interruption_nothing_is_rendered_twice(tmp_path, scene):
    whole = FakeRenderer()
    expected = measure(tmp_path / "a", settings(scene), whole)
    first, second = FakeRenderer(stop_after=40), FakeRenderer()
    with pytest.raises(KeyboardInterrupt):
        measure(tmp_path / "b", settings(scene), first)
    found = measure(tmp_path / "b", settings(scene), second)
    assert first.jobs + second.jobs == whole.jobs
    np.testing.assert_array_equal(found.levels["LOBE"][-1].whole, expected.levels["LOBE"][-1].whole)
    again = FakeRenderer()
    measure(tmp_path / "b", settings(scene), again)
    assert again.jobs == []


def test_new_code_of_lobe_runs_both_engines_levels_again_and_not_cycles_reference(tmp_path, scene):
    measure(tmp_path, settings(scene), FakeRenderer())
    again = FakeRenderer()
    measure(tmp_path, settings(scene), again, CODES | {"LOBE": "new"})
    done = {(job.purpose, job.engine) for job in again.jobs}
    assert {("level", "LOBE"), ("level", "CYCLES"), ("reference", "LOBE")} <= done
    assert not {("reference", "CYCLES"), ("pilot", "CYCLES"), ("probe", "CYCLES")} & done


def test_every_part_of_the_key_counts(tmp_path, scene):
    def path(chosen=None, codes=CODES, **changes):
        words = {"purpose": "level", "engine": "CYCLES", "samples": 4, "index": 0, "variant": BEST} | changes
        return runs.Store(tmp_path, chosen or settings(scene), FakeRenderer(), codes).path(job(**words))

    one = path()
    others = [path(samples=16), path(index=1), path(variant=VARIANTS[0]), path(engine="LOBE"), path(purpose="pilot"),
              path(settings(scene, resolution=(48, 32))), path(settings(scene, threads=1)),
              path(codes=CODES | {"CYCLES": "new"}), path(variant=replace(BEST, world_map=1024))]  # fmt: skip
    scene.write_bytes(b"another scene")
    others.append(path())
    assert len({one, *others}) == 1 + len(others)


def test_both_engines_renders_depend_on_what_the_tools_set(monkeypatch):
    before = runs.fingerprints()
    assert runs.fingerprints() == before
    for place, tool in enumerate(runs.TOOLS):
        with monkeypatch.context() as patch:
            patch.setattr(runs, "TOOLS", (*runs.TOOLS[:place], settings, *runs.TOOLS[place + 1 :]))  # another source
            after = runs.fingerprints()
        assert after["LOBE"] != before["LOBE"] and after["CYCLES"] != before["CYCLES"], tool
    with monkeypatch.context() as patch:
        patch.setattr(common, "LOBES_OFF", {})
        assert runs.fingerprints()["CYCLES"] != before["CYCLES"]


def test_a_kept_render_is_the_same(tmp_path):
    render = FakeRenderer()(job("level", "CYCLES", 4, 0))
    runs.save(tmp_path / "a.npz", render)
    found = runs.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(found.picture, render.picture)
    assert found.report == render.report
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_a_file_that_was_not_finished_is_not_found(tmp_path, scene, monkeypatch):
    def interrupted(file, **content):
        file.write(b"half")
        raise KeyboardInterrupt

    store = runs.Store(tmp_path / "store", settings(scene), FakeRenderer(), CODES)
    one = job("level", "LOBE", 4, 0)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(np, "savez_compressed", interrupted)
        store(one)
    assert not store.path(one).exists()
    store(one)
    assert (store.rendered, store.found) == (1, 0)


def test_forget(tmp_path, scene):
    measure(tmp_path, settings(scene), FakeRenderer())
    runs.forget(tmp_path / "store", scene)
    again = FakeRenderer()
    measure(tmp_path, settings(scene), again)
    assert again.jobs


def test_lobe_alone_is_still_measured_against_both(tmp_path, scene):
    renderer = FakeRenderer()
    outcome = measure(tmp_path, settings(scene, engines=("LOBE",)), renderer)
    assert {j.engine for j in renderer.jobs if j.purpose == "reference"} == {"LOBE", "CYCLES"}
    assert {j.engine for j in renderer.jobs if j.purpose in ("level", "pilot")} == {"LOBE"}
    assert set(outcome.levels) == {"LOBE"}
    assert tables.write([outcome], tmp_path / "results") == []


def test_tables(tmp_path, scene):
    outcome = measure(tmp_path, settings(scene), FakeRenderer())
    rows = tables.write([outcome], tmp_path / "results")
    assert [row["scene"] for row in rows] == ["scene"]  # and no mean: it is none of the samples
    assert 4.0 < float(rows[0][tables.RATIO]) < 7.0
    assert rows[0]["Cycles' settings"] == "light tree off, guiding off"
    assert rows == tables.write([outcome], tmp_path / "results")  # again: the same
    levels = common.read_table("convergence", tmp_path / "results")
    assert len(levels) == len(outcome.levels["LOBE"]) + len(outcome.levels["CYCLES"])
    assert "ratio" in (tmp_path / "results" / "equal_error.md").read_text().split("|")[0]
    assert "no claim" in (tmp_path / "results" / "convergence.md").read_text().split("|")[0]
    for name in ("equal_error.md", "convergence.md"):
        assert "box filter, the same bounces" in (tmp_path / "results" / name).read_text().split("|")[0]


def made_up(scene: str, ratio: float, **changes) -> dict[str, str]:
    """A row of `equal_error` with what the geometric means look at."""
    ratios = {}
    for name in (tables.RATIO, tables.LOWEST_RATIO, tables.SAMPLING_RATIO, tables.TRIMMED_RATIO):
        ratios |= tables.ratio_columns(name, (ratio, ratio, ratio))
    return {"scene": scene, "resolution": "384x256", "threads": "2", "seeds": "8", "Cycles' settings": "light tree on",
            "engines' pictures": "agree: +0.07%"} | ratios | changes  # fmt: skip


def test_means_are_of_the_samples_as_make_bench_renders_them():
    rows = [
        made_up("world", 2.0),
        made_up("lamps", 8.0, **{"Cycles' settings": "light tree on, OSL"}),
        made_up("instances", 100.0, **{"engines' pictures": "DIFFER: +5%"}),
        made_up("instances", 100.0, resolution="24x16"),
        made_up("instances", 100.0, threads="1"),
        made_up("instances", 100.0, seeds="2"),
        made_up("somebody's", 100.0),
        made_up("many_lights", np.nan),
    ]
    found = {row["scene"]: row[tables.RATIO] for row in tables.summary(rows)}
    assert found == {"geometric mean of 2": "4.00", "geometric mean of 1 without OSL": "2.00"}
    assert [tables.is_headline(row) for row in rows] == [True, True, True, False, False, False, False, True]
    assert tables.summary(rows[3:]) == []


def test_old_means_give_way_to_new_ones(tmp_path):
    for count in (2, 1):
        rows = [made_up(name, 2.0) for name in common.SCENES[:count]]
        common.update_table("t", ("scene",), rows, folder=tmp_path, summary=tables.summary)
    assert [row["scene"] for row in common.read_table("t", tmp_path)][-2:] == [
        "geometric mean of 2", "geometric mean of 2 without OSL",
    ]  # fmt: skip


def test_another_resolution_has_a_row_of_its_own(tmp_path, scene):
    for resolution in (RESOLUTION, (24, 16), (16, 24)):
        chosen = settings(scene, resolution=resolution)
        rows = tables.write([measure(tmp_path, chosen, FakeRenderer())], tmp_path / "results")
    assert sorted(row["resolution"] for row in rows) == ["16x24", "24x16"]


def test_a_run_of_lobe_alone_leaves_the_ratios_of_before(tmp_path, scene):
    both = tables.write([measure(tmp_path, settings(scene), FakeRenderer())], tmp_path / "results")
    alone = measure(tmp_path, settings(scene, engines=("LOBE",)), FakeRenderer())
    assert tables.write([alone], tmp_path / "results") == both != []


def test_the_page_needs_nothing_else_and_keeps_other_scenes(tmp_path, scene):
    path, sections = tmp_path / "results" / "page.html", tmp_path / "sections"
    outcome = measure(tmp_path, settings(scene), FakeRenderer())
    sections.mkdir()
    (sections / "other.html").write_text("<h2>other</h2>")
    page.write(path, sections, [outcome], tables.short(tables.write([outcome], tmp_path / "results")))
    text = path.read_text()
    sources = re.findall(r'(?:src|href)\s*=\s*"([^"]{0,30})', text)
    assert len(sources) == 9  # a plot, three pictures, three maps, two legends
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert not re.search(r"https?://|url\(|<script|<link|@import", text)
    assert "<h2>other</h2>" in text
    assert f"{outcome.settings.seeds} seeds a point" in text and "Eight" not in text
    assert "box filter, the same bounces" in text and "below 0.2 %" in text
    assert path.with_name("page_scene.png").read_bytes().startswith(b"\x89PNG")
    assert len(text) < 400_000


def test_each_round_of_levels_has_a_process_of_its_own(tmp_path):
    chosen = Settings(common.scene_path("cornell_diffuse"), resolution=(8, 8), threads=1)
    levels = [job("level", engine, 1, index) for index in (0, 1) for engine in plan.ENGINES]
    jobs = [job("probe", "LOBE", 1, 0), *levels, job("picture", "LOBE", 1, 0)]
    processes = []
    with contextlib.closing(runs.Processes(chosen)) as renderer:
        for one in jobs:
            assert renderer(one).picture.shape == (8, 8, 3)
            processes.append(renderer.process.pid)
    first, second, third = dict.fromkeys(processes)
    assert processes == [first, second, second, third, third, third]
    assert renderer.process is None


def test_what_a_process_cannot_do_is_told(tmp_path):
    renderer = runs.Processes(Settings(tmp_path / "no.blend"))
    with contextlib.closing(renderer), pytest.raises(common.br.ToolError, match=r"no\.blend' does not exist"):
        renderer(job("probe", "LOBE", 1, 0))
