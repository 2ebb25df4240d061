"""The benchmark's figures on made-up renders whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks.convergence import analysis, plan, tables
from benchmarks.convergence.analysis import Curve
from benchmarks.convergence.reference import make_reference
from benchmarks.convergence.runs import Render
from tools import metrics

SHAPE = (24, 32, 3)
SEEDS = 8


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def render(picture, total=1.0, **phases) -> Render:
    return Render(picture.astype(np.float32), {"seconds": {"total": total, "export": None, "build": None,
                                                           "compile": None, "render": None, **phases}})  # fmt: skip


def noisy(rng, truth, spread, seeds=SEEDS):
    return truth + rng.normal(0.0, spread, (seeds, *SHAPE))


def of_errors(samples, errors, seconds, bright=0.0) -> Curve:
    """errors, seconds (levels, seeds). bright: of the errors, what is in the brightest values."""
    return Curve(np.ravel(samples), (errors - bright)[None], bright + np.zeros((1, *errors.shape)), seconds)


def power_law(rng, factor, seconds, slope=-1.0, levels=6, spread=0.0, fixed=0.0) -> Curve:
    """errors factor * samples^slope, seconds fixed + seconds * samples, both with a relative spread between seeds."""
    samples = 4.0 ** np.arange(levels)[:, None]
    wobble = rng.lognormal(0.0, spread, (2, levels, SEEDS)) if spread else np.ones((2, levels, SEEDS))
    return of_errors(samples, factor * samples**slope * wobble[0], (fixed + seconds * samples) * wobble[1])


def test_ratio_of_two_power_laws(rng):
    """Twice the error at the same samples is twice the samples; times thrice the time each."""
    found = analysis.time_ratio(power_law(rng, 1.0, 0.01), power_law(rng, 2.0, 0.03))
    assert found.mean == pytest.approx((6.0, 6.0, 6.0))
    assert found.at_lowest == pytest.approx((6.0, 6.0, 6.0))
    assert found.errors == pytest.approx((2.0 / 4**5, 1.0))


def test_swapped_engines_give_the_inverse(rng):
    a, b = power_law(rng, 1.0, 0.01, spread=0.1), power_law(rng, 2.0, 0.03, spread=0.1)
    there, back = analysis.time_ratio(a, b).mean, analysis.time_ratio(b, a).mean
    assert back == pytest.approx((1 / there[0], 1 / there[2], 1 / there[1]))


def test_fixed_costs_count_less_at_the_lowest_error(rng):
    """An engine with nothing but a longer start: its ratio falls to that of the samples."""
    found = analysis.time_ratio(power_law(rng, 1.0, 0.01), power_law(rng, 1.0, 0.01, fixed=1.0))
    assert found.mean[0] > 5.0
    assert found.at_lowest[0] == pytest.approx((1.0 + 0.01 * 4**5) / (0.01 * 4**5))


def test_interval_covers_the_truth_about_as_often_as_it_says(rng, monkeypatch):
    """Of eight seeds with lognormal errors; the plain 95 % of a bootstrap cover less than 90 %."""
    monkeypatch.setattr(analysis, "BOOTSTRAP_RUNS", 150)
    samples = 4.0 ** np.arange(3)[:, None]

    def lognormal(factor: float) -> Curve:
        errors = factor / samples * rng.lognormal(0.0, 1.0, (3, SEEDS))
        return of_errors(samples, errors, 0.01 * samples * np.ones(SEEDS))

    trials, hits = 200, 0
    for trial in range(trials):
        _, low, high = analysis.time_ratio(lognormal(1.0), lognormal(3.0), seed=trial).mean
        hits += low < 3.0 < high
    assert 0.92 <= hits / trials < 1.0


def test_quantiles_of_few_runs_are_students():
    """A bootstrap's spread is sqrt(7 / 8) of that of the mean of eight, and t with 7 degrees of freedom is 2.365."""
    assert norm.ppf(analysis.tail(8)) == pytest.approx(-2.365 * np.sqrt(8 / 7), abs=1e-3)
    assert analysis.tail(10_000) == pytest.approx(0.025, abs=1e-4)


def test_no_ratio_without_errors_that_both_reach(rng):
    found = analysis.time_ratio(power_law(rng, 1e-6, 0.01), power_law(rng, 1.0, 0.01, levels=2))
    assert np.isnan(found.mean).all()
    assert np.isnan(found.errors).all()


def test_curves_that_just_touch_are_too_few_levels(rng):
    """Cycles from 2 to 2 / 4^5, Lobe only from 1 to 1 / 4: their common range spans a factor of 4."""
    assert not analysis.time_ratio(power_law(rng, 1.0, 0.01, levels=2), power_law(rng, 2.0, 0.03)).enough
    assert analysis.time_ratio(power_law(rng, 1.0, 0.01, levels=3), power_law(rng, 2.0, 0.03)).enough
    assert not analysis.time_ratio(power_law(rng, 1e-6, 0.01), power_law(rng, 1.0, 0.01, levels=2)).enough


def levels_of(rng, factor, seconds, levels=6, fixed=0.0, drift=1.0) -> list[analysis.Level]:
    """drift: each level's sampling takes so much longer, beyond what its samples take. fixed: of the whole render."""
    found = []
    for k in range(levels):
        errors, time = np.full(SEEDS, factor / 4.0**k), np.full(SEEDS, seconds * (4.0 * drift) ** k)
        found.append(analysis.Level(4**k, errors, errors / 2, fixed + time, time, {}, 0.0, (0.0, 0.0), 0.0, 1e-9))
    return found


def test_slopes_that_differ_are_told(rng):
    assert not analysis.suspect(levels_of(rng, 1.0, 0.1))
    assert analysis.suspect(levels_of(rng, 1.0, 0.1, drift=0.8))
    assert analysis.suspect(levels_of(rng, 1.0, 0.1, drift=1.3))


def test_all_columns_have_the_same_range(rng):
    """Cycles' first two levels are below its clock: gone from all columns. Lobe's are as short, and stay."""
    lobe, cycles = levels_of(rng, 2.0, 0.001), levels_of(rng, 2.0, 0.005, fixed=10.0)
    ratios, errors = tables.ratios_and_range(lobe, cycles)
    assert errors == pytest.approx((2.0 / 4**5, 2.0 / 4**2))
    assert ratios[tables.SAMPLING_RATIO][0] == pytest.approx(5.0)
    assert ratios[tables.RATIO][0] > 5.0  # with the fixed times
    ratios, errors = tables.ratios_and_range(lobe, cycles[:3])  # one is left
    assert errors == pytest.approx((2.0 / 4**2, 2.0))
    assert np.isnan(ratios[tables.SAMPLING_RATIO][0]) and ratios[tables.RATIO][0] > 100.0
    ratios, _ = tables.ratios_and_range(lobe, levels_of(rng, 2.0, 0.001, levels=3))  # none is
    assert np.isnan(ratios[tables.SAMPLING_RATIO][0]) and ratios[tables.RATIO][0] == pytest.approx(1.0)
    ratios, _ = tables.ratios_and_range(lobe, cycles[2:4])
    assert np.isnan([ratio[0] for ratio in ratios.values()]).all()  # a factor of 4 in common


def fireflies(rng, core, bright, rate, seconds, levels=4) -> Curve:
    """Errors of a known mean: core * samples^-1.25 that is the same with all seeds, and bright / samples by fireflies,
    `rate` of them with each sample, of unequal sizes."""
    samples = 4.0 ** np.arange(levels)[:, None] * np.ones(SEEDS)
    met = rng.poisson(rate * samples)
    sizes = np.array([[rng.lognormal(-0.5, 1.0, count).sum() for count in row] for row in met])
    bright = bright * sizes / rate / samples**2
    return of_errors(samples[:, 0], core * samples**-1.25 + bright, seconds * samples, bright)


@pytest.mark.parametrize("swapped", [False, True])
def test_interval_covers_the_truth_where_one_engine_has_fireflies(rng, monkeypatch, swapped):
    """One with every tenth sample or so, and most of the error in them; the other with none. With each level's mean as
    it is the curve would miss what short levels never met, and the interval would hold the truth in seven of ten."""
    monkeypatch.setattr(analysis, "BOOTSTRAP_RUNS", 150)
    samples = 4.0 ** np.arange(4)[:, None] * np.ones(SEEDS)
    truly = of_errors(samples[:, 0], 0.3 * samples**-1.25 + 0.7 / samples, 0.03 * samples)
    clean = of_errors(samples[:, 0], 0.8 * samples**-1.1, 0.01 * samples)
    truth = analysis.time_ratio(clean, truly).mean[0]
    trials, hits, logs = 150, 0, []
    for trial in range(trials):
        pair = clean, fireflies(rng, 0.3, 0.7, 0.1, 0.03)
        ratio, low, high = analysis.time_ratio(*(pair[::-1] if swapped else pair), seed=trial).mean
        wanted = 1 / truth if swapped else truth
        hits += low < wanted < high
        logs.append(np.log(ratio / wanted))
    assert 0.85 <= hits / trials <= 1.0
    assert abs(np.mean(logs)) < 0.08


def test_bright_pixels_are_taken_by_their_power_law():
    """A level that met none, and one that met too many: together they are about 1 / samples."""
    samples = np.array([1.0, 4.0, 16.0, 64.0])
    assert analysis.power_law(samples, np.array([0.0, 0.5, 0.05, 0.016])) == pytest.approx(1 / samples, rel=0.15)
    assert analysis.power_law(samples, 2.0 * samples**-1.3) == pytest.approx(2.0 * samples**-1.3)
    assert (analysis.power_law(samples, np.zeros((2, 4))) == 0.0).all()


def test_whole_and_trimmed_errors_have_each_a_ratio(rng):
    """Figures of Cycles on the sample scene `world`: 7.9e-2 at 4 samples, 1.0e-1 at 16. The trimmed errors are half."""
    lobe, cycles = levels_of(rng, 2.0, 0.1, levels=4), levels_of(rng, 2.0, 0.5, levels=4)
    ratios, errors = tables.ratios_and_range(lobe, cycles)
    assert ratios[tables.RATIO] == ratios[tables.TRIMMED_RATIO] == pytest.approx((5.0, 5.0, 5.0))
    rising = with_errors(cycles, [1.5, 0.3, 0.36, 0.08], 0.3)
    ratios, errors = tables.ratios_and_range(lobe, rising)
    assert ratios[tables.TRIMMED_RATIO] == pytest.approx((5.0, 5.0, 5.0))
    ratio, low, high = ratios[tables.RATIO]
    assert low < ratio < high and high > 1.2 * low
    assert np.isfinite(errors).all() and analysis.slopes(rising)[0] < -0.8


def with_errors(levels, errors, scatter: float) -> list[analysis.Level]:
    """These mean errors, each known to `scatter` of it; the trimmed ones stay."""
    spread = 1.0 + scatter * np.sqrt(SEEDS - 1) * np.resize([-1.0, 1.0], SEEDS)
    return [replace(level, whole=error * spread) for level, error in zip(levels, errors, strict=True)]


def test_the_short_table_has_both_ratios_with_their_intervals():
    ratios = {}
    for name in (tables.RATIO, tables.LOWEST_RATIO, tables.SAMPLING_RATIO):
        ratios |= tables.ratio_columns(name, (2.0, 1.0, 4.0))
    ratios |= tables.ratio_columns(tables.TRIMMED_RATIO, (np.nan,) * 3)
    (row,) = tables.short([{"scene": "world", "Cycles' settings": "", "engines' pictures": ""} | ratios])
    assert (row[tables.RATIO], row[tables.TRIMMED_RATIO]) == ("2.00 (1.00 to 4.00)", "too few levels")


def test_a_level_that_is_no_better_is_left_out(rng):
    lobe, cycles = power_law(rng, 1.0, 0.01), power_law(rng, 1.0, 0.02)
    lobe.core[0, 3] = lobe.core[0, 2]
    assert analysis.time_ratio(lobe, cycles).mean[0] == pytest.approx(2.0)


def test_pairs_are_drawn_together(rng):
    """A slow minute that hits both engines of a pair takes nothing from the ratio's certainty."""
    lobe, cycles = power_law(rng, 1.0, 0.01), power_law(rng, 1.0, 0.02)
    slow = rng.lognormal(0.0, 0.5, SEEDS)
    found = analysis.time_ratio(*(replace(curve, seconds=curve.seconds * slow) for curve in (lobe, cycles)))
    assert found.mean == pytest.approx((2.0, 2.0, 2.0))


def test_slope():
    assert analysis.slope([1, 4, 16], [2.0, 2.0 / 8, 2.0 / 64]) == pytest.approx(-1.5)
    assert np.isnan(analysis.slope([1], [1.0]))


def test_geometric_mean():
    assert analysis.geometric_mean([(2.0, 1.0, 4.0), (8.0, 8.0, 8.0)]) == pytest.approx((4.0, 4.0 / 2**0.5, 4 * 2**0.5))


def test_the_noise_of_the_reference_is_taken_off(rng):
    """An error as large as the reference's own noise is found, whole and trimmed, where a plain relMSE shows double."""
    truth = rng.uniform(0.5, 2.0, SHAPE)
    reference = make_reference(noisy(rng, truth, 0.1), noisy(rng, truth, 0.1), 1)
    spread = 0.1 / np.sqrt(2 * SEEDS)  # that of the reference
    plain = float((spread**2 / (truth**2 + 0.01)).mean())
    assert reference.noise == pytest.approx(plain, rel=0.1)
    found = np.array([reference.errors(picture) for picture in noisy(rng, truth, spread, 32)]).mean(axis=0)
    assert found[0] == pytest.approx(plain, rel=0.15)
    assert 0.5 * plain < found[1] <= found[0]
    assert np.mean([reference.errors(p)[0] for p in noisy(rng, truth, 0.0, 1)]) == pytest.approx(0.0, abs=0.15 * plain)


def test_draws_of_the_reference_scatter_as_references_do(rng):
    """What another reference would say of the same picture, whole and trimmed, beside what one's draws say."""
    truth, found, shifts = rng.uniform(0.5, 2.0, SHAPE), [], []
    picture = noisy(rng, truth, 0.05, 1)[0]
    for _ in range(100):
        reference = make_reference(noisy(rng, truth, 0.2), noisy(rng, truth, 0.2), 1)
        found.append(reference.errors(picture))
        shifts.append(reference.shifts(picture, 100))
    assert np.mean(shifts, axis=(0, 2)) == pytest.approx((0.0, 0.0), abs=0.1 * np.std(found))
    assert np.std(shifts, axis=2).mean(axis=0) == pytest.approx(np.std(found, axis=0), rel=0.3)


def test_draws_of_the_reference_by_hand(rng):
    """The errors of the picture against the mean of the replicates that are drawn, as often as they are."""
    truth = rng.uniform(0.5, 2.0, SHAPE)
    lobe, cycles, picture = noisy(rng, truth, 0.1), noisy(rng, truth, 0.1), noisy(rng, truth, 0.1, 1)[0]
    reference, pairs = make_reference(lobe, cycles, 1), (lobe + cycles) / 2
    denominators = reference.picture**2 + metrics.REL_MSE_EPSILON
    variance = (pairs.var(axis=0, ddof=1) / denominators).mean()
    changes = []
    for counts in np.random.default_rng(1).multinomial(SEEDS, np.full(SEEDS, 1 / SEEDS), 3):
        drawn = np.repeat(pairs, counts, axis=0).mean(axis=0)
        change = ((picture - drawn) ** 2 - (picture - reference.picture) ** 2) / denominators
        changes.append(change.mean() - ((counts / SEEDS) ** 2 - 1 / SEEDS**2).sum() * variance)
    assert reference.shifts(picture, 3)[0] == pytest.approx(changes)


def test_the_noise_of_the_reference_widens_the_interval(rng):
    """All seeds of both engines are equally far from the truth; what is between them and the reference isn't known."""
    truth = rng.uniform(0.5, 2.0, SHAPE)
    offsets = [rng.normal(0.0, spread, SHAPE) for spread in (0.2, 0.05, 0.0125)]
    widths = []
    for noise in (0.001, 0.05):
        reference = make_reference(noisy(rng, truth, noise), noisy(rng, truth, noise), 1)
        levels = {}
        for factor in (1.0, 2.0):
            levels[factor] = [
                analysis.level(4 ** (2 * k), [render(truth + offset, factor * 16.0**k, render=1.0)] * SEEDS, reference)
                for k, offset in enumerate(offsets)
            ]
        scale = {1.0: 1.0, 2.0: 1.3}  # other errors than the other's, or nothing would be left of it
        curves = [
            analysis.curve([replace(lv, whole=s * lv.whole, trimmed=s * lv.trimmed) for lv in levels[f]], "total")
            for f, s in scale.items()
        ]
        _, low, high = analysis.time_ratio(*curves).at_lowest
        widths.append(np.log(high / low))
    assert widths[1] > 4 * widths[0] > 0.0


def test_engines_that_differ_are_told(rng):
    truth = np.ones(SHAPE)
    assert make_reference(noisy(rng, truth, 0.05), noisy(rng, truth, 0.05), 1).verdict == "agree"
    assert make_reference(noisy(rng, truth, 0.1), noisy(rng, truth * 1.01, 0.1), 1).verdict == "DIFFER"
    for factor in (1.0, 1.01):  # means that scatter by a few per cent say neither
        wide = [truth * f * (1 + rng.normal(0.0, 0.05, (SEEDS, 1, 1, 1))) for f in (1.0, factor)]
        assert make_reference(*wide, 1).verdict == "open"


def test_a_level_says_what_it_can(rng):
    truth = rng.uniform(0.5, 1.0, SHAPE)
    reference = make_reference(noisy(rng, truth, 0.01), noisy(rng, truth, 0.01), 1)
    runs = [render(p, 2.0 + 0.1 * i, render=1.5, export=0.3) for i, p in enumerate(noisy(rng, truth * 1.1, 0.05))]
    level = analysis.level(4, runs, reference)
    assert level.mean_difference[0] == pytest.approx(0.1, rel=0.02)
    assert level.squared_bias == pytest.approx(0.01, rel=0.1)  # the truth is far above the epsilon
    assert level.error == pytest.approx(level.squared_bias + 0.05**2 * np.mean(1 / (truth**2 + 0.01)), rel=0.1)
    assert level.phases["start"] == pytest.approx(0.55)  # the medians' seeds: total - 1.8
    assert level.phases["build"] is None
    assert 0.0 < level.flip < 1.0
    assert level.usable and not level.marked


def test_flip_knows_alike_from_different(rng):
    picture = rng.uniform(0.0, 2.0, SHAPE)
    assert analysis.flip(picture, picture) == pytest.approx(0.0, abs=1e-6)
    assert analysis.flip(np.zeros(SHAPE), picture) > 0.3


def test_no_seed_serves_two_purposes():
    seeds = [plan.job(purpose, engine, 1, index).seed for purpose in plan.FIRST_SEED for engine in plan.ENGINES
             for index in range(1000)]  # fmt: skip
    assert len(set(seeds)) == len(seeds)


def test_cost_of_a_render():
    assert plan.cost((1, 1.1), (11, 2.1)) == plan.Cost(pytest.approx(1.0), pytest.approx(0.1))
    assert plan.cost((1, 2.0), (10, 1.0)).per_sample == pytest.approx(0.01)  # noise: never nothing


def test_shares_of_the_budget():
    costs = {"LOBE": plan.Cost(0.0, 0.01), "CYCLES": plan.Cost(0.0, 0.03)}
    assert plan.reference_samples(costs, 80.0) == 64  # 0.3 * 80 s / 8 renders of 0.04 s a sample: 75
    assert plan.pilot_samples(costs["CYCLES"], 100.0) == 16
    # 0.1 * 100 s / renders of 0.03 s a sample and of twice that: 111.
    assert [plan.long_pilot_samples(costs["CYCLES"], 100.0, wanted) for wanted in (1, 63, 64, 512)] == [16, 16, 64, 64]


def forecast(at_one: float, per_sample: float) -> plan.Forecast:
    return plan.Forecast(plan.Cost(0.0, per_sample), (1, at_one), (16, at_one / 16))


def test_levels_end_at_the_most():
    assert [plan.ladder(most) for most in (1, 4, 64)] == [[1], [1, 4], [1, 4, 16, 64]]
    assert plan.units({"LOBE": 4, "CYCLES": 16}) == [("LOBE", 1), ("CYCLES", 1), ("LOBE", 4), ("CYCLES", 4),
                                                     ("CYCLES", 16)]  # fmt: skip


def test_forecast_of_an_error():
    """Through both renders, and after them as plain samples."""
    found = plan.Forecast(plan.Cost(0.0, 1.0), (1, 1.0), (16, 16**-1.25))
    assert [found.error(n) for n in (1, 4, 16, 32)] == pytest.approx([1.0, 4**-1.25, 16**-1.25, 16**-1.25 / 2])
    for bright in (0.001, 1e9):  # pixels that were not met, or were: slopes of 1 and 1.5
        found = plan.Forecast(plan.Cost(0.0, 1.0), (1, bright), (16, 1 / 16))
        assert found.error(4) == pytest.approx(1 / 4 if bright < 1 else 1 / 2)


@pytest.mark.parametrize(("wanted", "last"), [(1, 4), (16, 16), (63, 16), (64, 64), (128, 64), (255, 64), (256, 256)])
def test_levels_are_powers_of_four_up_to_the_files_samples(wanted, last):
    both = {"LOBE": forecast(100.0, 0.001), "CYCLES": forecast(100.0, 0.1)}
    most = plan.most_samples(both, wanted, 8, 1e9)
    assert most == {"LOBE": max(last, 16), "CYCLES": max(last, 16)}  # 4 samples wouldn't span WANTED_OVERLAP
    assert plan.ladder(most["LOBE"])[-3:] == [most["LOBE"] // 16, most["LOBE"] // 4, most["LOBE"]]


def test_the_engine_with_the_larger_error_goes_on_within_the_budget():
    """Cycles with nearly four times the error."""
    both = {"LOBE": forecast(0.63, 0.001), "CYCLES": forecast(2.51, 0.1)}
    assert plan.most_samples(both, 64, 8, 1e9) == {"LOBE": 64, "CYCLES": 64}
    # 8 seeds of 1 + 4 + 16 + 64 samples at 0.1 s: 68 s.
    assert plan.most_samples(both, 64, 8, 69.0) == {"LOBE": 64, "CYCLES": 64}
    assert plan.most_samples(both, 64, 8, 67.0) == {"LOBE": 16, "CYCLES": 16}
    assert plan.most_samples(both, 64, 8, 0.0) == {"LOBE": 4, "CYCLES": 4}


def test_a_file_of_few_samples_has_enough_levels():
    """From 0.08 and 0.32 on to 0.08 / WANTED_OVERLAP."""
    both = {"LOBE": forecast(0.08, 0.001), "CYCLES": forecast(0.32, 0.001)}
    assert plan.most_samples(both, 1, 8, 1e9) == {"LOBE": 16, "CYCLES": 64}
