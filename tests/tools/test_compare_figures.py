"""The figures of a comparison on pictures whose truth is known, FLIP beside its authors' program, and the page."""

from __future__ import annotations

import dataclasses
import json
import math
import re

import numpy as np
import pytest
from scipy import stats

from tools import compare, metrics
from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

from bl_ext.user_default.lobe.addon.compare import figures, flip, headline_of, html, page, pictures  # noqa: E402
from bl_ext.user_default.lobe.addon.compare.figures import Timing  # noqa: E402
from bl_ext.user_default.lobe.addon.compare.run import Outcome, _seeds, clock_seconds, cycles_seconds  # noqa: E402

SHAPE = (2, 120, 160, 3)
TIMES = Timing(2.0, 1.5), Timing(5.0, 4.0)


def renders(mean: float, deviation: float, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(mean, deviation, SHAPE).astype(np.float32)


def test_figures_of_a_constructed_case():
    """Lobe: mean 1.02, deviation 0.03; Cycles: 1 and 0.06. With 57,600 values each is known to a per cent."""
    found = figures.measure(renders(1.02, 0.03, 1), renders(1.0, 0.06, 2), TIMES, 0.25)
    scale = 1.01**2 + 0.01
    assert found.noise_lobe == pytest.approx(0.03**2 / scale, rel=0.02)
    assert found.noise_cycles == pytest.approx(0.06**2 / scale, rel=0.02)
    assert found.rel_mse == pytest.approx((0.02**2 + 0.03**2 + 0.06**2) / scale, rel=0.02)
    assert abs(found.difference - 0.02**2 / scale) < 4 * found.difference_error
    assert found.difference_error < 0.25 * 0.02**2 / scale  # else the line before says nothing
    assert found.mean_difference == pytest.approx(0.02, abs=0.002)
    assert found.mean_difference_margin < 0.01
    assert found.flip == 0.25
    ratio = found.noise_cycles / found.noise_lobe
    assert found.speedup_sampling == pytest.approx(ratio * 4.0 / 1.5)
    assert found.speedup == pytest.approx((1.0 + 4.0 * ratio) / 2.0)
    assert found.speedup_sampling == pytest.approx(4 * 4.0 / 1.5, rel=0.05)
    # The square of a normal number spreads by sqrt(2) times its mean; each noise is a mean of 57,600.
    assert found.ratio_error == pytest.approx(2**0.5 * (2 / 57600) ** 0.5, rel=0.1)


def test_specks_make_the_speedup_unsure():
    lobe, cycles = renders(1.0, 0.01, 7), renders(1.0, 0.01, 8)
    lobe[0, 5, 5] = 20.0
    found = figures.measure(lobe, cycles, TIMES, 0.0)
    assert found.ratio_error > 0.5


def test_figures_are_those_of_the_metrics():
    lobe, cycles = renders(1.0, 0.1, 3), renders(1.1, 0.3, 4)
    reference = figures.brightness(lobe.astype(np.float64), cycles.astype(np.float64))
    assert reference.shape == SHAPE[1:] and reference.mean() == pytest.approx(1.05, abs=0.01)
    found = figures.measure(lobe, cycles, TIMES, 0.0)
    assert found.noise_lobe == pytest.approx(metrics.noise(lobe, reference))
    assert found.noise_cycles == pytest.approx(metrics.noise(cycles, reference))
    crossed = figures.measure(lobe, cycles[::-1], TIMES, 0.0).difference  # the other two of the four products
    assert (found.difference + crossed) / 2 == pytest.approx(_squared_bias(lobe, cycles, reference))
    assert found.mean_difference == pytest.approx(metrics.mean_difference(lobe, cycles)[0])


@pytest.mark.parametrize("louder", [1.0, 2.0, 10.0, 1e3])  # Cycles' noise, as a multiple of Lobe's
def test_the_margin_of_the_means_holds_whichever_engine_is_noisy(louder):
    """The true difference, 0, is outside it in 5 % of cases or fewer; Satterthwaite's is known to miss by a little."""
    rng = np.random.default_rng(9)
    trials, outside = 4000, 0
    for means in rng.normal(size=(trials, 2, 2)) * [[[0.01], [0.01 * louder]]]:
        lobe, cycles = (np.full((2, 1, 1, 3), 100.0) + pair[:, None, None, None] for pair in means)
        difference, margin = figures._mean_difference(lobe, cycles)
        outside += abs(difference) > margin
    assert 0.01 < outside / trials < 0.07


def test_the_margin_is_by_students_t():
    for a, b in ((1.0, 1.0), (1.0, 0.3), (0.1, 1.0), (0.0, 2.0)):
        degrees = (a + b) ** 2 / (a**2 + b**2)
        exact = stats.t.ppf(0.975, degrees) * (a + b) ** 0.5
        assert exact * 0.999 < figures._margin(a, b) < exact * 1.04
    assert figures._margin(0.0, 0.0) == 0.0


def _squared_bias(lobe, cycles, reference) -> float:
    """`metrics.squared_bias` over both ways of making pairs."""
    pairs = (metrics.squared_bias(lobe, other, reference) for other in (cycles, cycles[::-1]))
    return float(np.mean(list(pairs)))


def test_the_speedup_does_not_depend_on_the_samples():
    """Four times the samples: a quarter of the noise and four times the sampling. Preparation 0."""
    few = figures.speedups(0.04, 0.08, Timing(1.0, 1.0), Timing(3.0, 3.0))
    many = figures.speedups(0.04, 0.02, Timing(1.0, 1.0), Timing(12.0, 12.0))
    assert few == pytest.approx((6.0, 6.0)) and many == pytest.approx((6.0, 6.0))


def test_renders_too_short_to_be_timed():
    short = figures.speedups(0.04, 0.08, Timing(1.0, 1.0), Timing(1.0, 0.04))
    assert all(map(math.isnan, short))


def test_equal_renders_have_no_noise_to_speak_of():
    still = np.repeat(renders(1.0, 0.1, 5)[:1], 2, axis=0)
    found = figures.measure(still, renders(1.0, 0.1, 6), TIMES, 0.0)
    assert math.isnan(found.noise_lobe) and math.isnan(found.speedup) and math.isnan(found.speedup_sampling)
    assert page.number(found.noise_lobe, ".3e") == "not known"
    black = np.zeros(SHAPE, np.float32)
    assert figures.measure(black, black, TIMES, 0.0).mean_difference == 0.0


def _pairs():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    y, x = np.mgrid[:48, :64]
    ramp = np.stack([x * 4, y * 5, (x + y) * 2], axis=-1).astype(np.uint8)
    square = ramp.copy()
    square[10:20, 30:50] = 255 - square[10:20, 30:50]
    return {"noise": (noise, ramp), "square": (ramp, square), "small": (ramp[:3, :5], square[10:13, 30:35])}


@pytest.mark.parametrize("name", ["noise", "square", "small"])
def test_flip_is_that_of_its_authors(name):
    from flip_evaluator import evaluate

    pair = _pairs()[name]
    expected = np.asarray(evaluate(*(p.astype(np.float32) / 255 for p in pair), "LDR", applyMagma=False)[0]).squeeze()
    assert flip.flip_map(*pair) == pytest.approx(expected, abs=1e-4)
    assert expected.max() > 0.1
    assert not flip.flip_map(pair[0], pair[0]).any()


def test_maps():
    lobe, cycles = np.ones((2, 4, 4, 3)), np.ones((2, 4, 4, 3))
    lobe[:, 0, 0], cycles[:, 0, 1] = 1.3, 1.3
    apart = pictures.relative_difference(lobe, cycles)
    assert apart[0, 0] == pytest.approx(0.3 / math.sqrt(1.15**2 + 0.01)) == -apart[0, 1] and not apart[1:].any()
    assert pictures.map_range(apart) == 0.5 and pictures.map_range(np.full((2, 2), 99.0)) == pictures.RANGES[-1]
    red, blue, equal = pictures.colored(apart, -0.2, 0.2, pictures.SIGNS)[[0, 0, 1], [0, 1, 0]].astype(int)
    assert red[0] > red[2] and blue[2] > blue[0] and np.ptp(equal) < 5
    picture = np.zeros((2, 3, 3), np.uint8)
    assert pictures.strip(picture, picture, picture).shape == (2, 9 + 2 * pictures.GAP, 3)


def test_clocks_and_seeds():
    assert clock_seconds("01:02.34") == pytest.approx(62.34) and clock_seconds("1:00:01.5") == pytest.approx(3601.5)
    assert cycles_seconds({"cycles.ViewLayer.render_time": "00:01.50", "cycles.x": "9"}, "render_time") == 1.5
    assert cycles_seconds({"Software": "Blender"}, "render_time") is None
    for seed in (0, 7, -5, (1 << 31) - 1, -(1 << 31)):
        (shown, other), cycles = _seeds(seed)["LOBE"], _seeds(seed)["CYCLES"]
        assert shown == seed and other != seed and abs(other) <= 1 << 31
        assert min(cycles) >= 0 and max(cycles) < (1 << 31) - 1 and cycles[0] != cycles[1]


@pytest.fixture
def outcome() -> Outcome:
    found = figures.measure(renders(1.0, 0.1, 1), renders(1.0, 0.2, 2), TIMES, 0.25)
    names = ("lobe", "cycles", "difference", "flip")
    return Outcome(
        scene="<A & B>",
        size=(160, 120),
        seconds=0.0,
        samples={"LOBE": 64.0, "CYCLES": 64.0},
        times=dict(zip(("LOBE", "CYCLES"), TIMES, strict=True)),
        figures=found,
        pictures={name: b"\x89PNG" + name.encode() for name in names},
        difference_range=0.5,
        changed=[("Cycles: Seed", "1", "2")],
        unmatched=["Passes are ticked in <Layer>"],
        different=[],
        threads="2",
    )


def with_figures(outcome: Outcome, **others) -> Outcome:
    return dataclasses.replace(outcome, figures=dataclasses.replace(outcome.figures, **others))


def test_the_headline_of_pictures_that_agree(outcome):
    """Cycles' noise is four times Lobe's: (1 + 4 x 4) s over 2 s."""
    assert headline_of(outcome) == (
        "Lobe is 8.5 ± 0.1 times as fast as Cycles at equal error. The pictures agree within 5%",
        True,
    )
    slower = with_figures(outcome, speedup=0.4961, ratio_error=0.021)
    assert headline_of(slower).text.startswith("Lobe is 0.50 ± 0.02 times as fast as Cycles at equal error.")


# What makes the speed-up mean nothing, and what is said then.
MEANINGLESS = {
    "means": (
        {"mean_difference": -0.21, "mean_difference_margin": 0.004},
        "The pictures differ: in the mean by -21.00% ± 0.40%, so no speed-up is said",
    ),
    "pixels": (
        {"difference": 0.0144, "difference_error": 0.001},
        "The pictures differ: in the pixels by 12.0% (root of relMSE 1.4e-02) beyond the noise, so no speed-up is said",
    ),
    "black": (
        {"mean_difference": math.inf, "mean_difference_margin": 0.0},
        "The pictures differ: Cycles' is black, so no speed-up is said",
    ),
    "noisy means": (
        {"mean_difference": 0.2, "mean_difference_margin": 0.23},
        "Too noisy to tell whether the pictures agree (they may be up to 43.0% apart in the mean): take more samples",
    ),
    "noisy means that happen to be equal": (
        {"mean_difference": 0.0, "mean_difference_margin": 0.0501},
        "Too noisy to tell whether the pictures agree (they may be up to 5.0% apart in the mean): take more samples",
    ),
    "noisy pixels": (
        {"difference": 0.01, "difference_error": 0.005},
        "Too noisy to tell whether the pictures agree (they may be up to 15.8% apart in the pixels): take more samples",
    ),
    "a difference that the noise covers": (
        {"difference": 0.01, "difference_error": 1e-9, "noise_lobe": 0.05, "noise_cycles": 0.05},
        "Too noisy to tell whether the pictures agree (they may be up to 10.0% apart in the pixels): take more samples",
    ),
    "noisy": (
        {"ratio_error": 0.5},
        "The pictures agree within 5%. Too noisy to tell who is the faster: take more samples",
    ),
    "unknown noise": (
        {"noise_lobe": math.nan, "speedup": math.nan},
        "The noise isn't known (see Not Matched), so no speed-up is said",
    ),
    "unknown times": (
        {"speedup": math.nan},
        "The pictures agree within 5%. The renders are too short to be timed: take more samples",
    ),
}


@pytest.mark.parametrize("case", MEANINGLESS)
def test_no_speedup_where_it_means_nothing(outcome, case):
    """Neither on the page, nor in the panel's rows, nor at the command line."""
    changed, said = MEANINGLESS[case]
    poor = with_figures(outcome, **changed)
    assert headline_of(poor) == (said, False)
    assert html(poor).index(html_of(said)) < html(poor).index('<div class="slider')
    lines = compare.text(poor).splitlines()
    assert lines[0] == said
    values = compare.data(poor)
    assert values["headline"] == said
    assert values["figures"]["speedup"] is None and values["figures"]["speedup_sampling"] is None
    figure = page.times(outcome.figures.speedup, outcome.figures.ratio_error)
    for text in (html(poor), compare.text(poor)):
        assert figure not in text and "Speed-up at equal error" not in text and "sampling alone" not in text
    for text in (html(outcome), compare.text(outcome)):
        assert figure in text and "Speed-up at equal error" in text
    assert compare.data(outcome)["figures"]["speedup"] == outcome.figures.speedup


def html_of(text: str) -> str:
    return text.replace("'", "&#x27;")


def test_no_speedup_where_the_engines_were_asked_for_different_things(outcome):
    lines = ["motion blur is left out", "bump is not drawn"]
    said = "The engines were not asked for the same ({} under Not Matched), so no speed-up is said"
    one, two = (dataclasses.replace(outcome, unmatched=lines[:n], different=lines[:n]) for n in (1, 2))
    assert headline_of(one) == (said.format("1 reason"), False)
    assert headline_of(two) == (said.format("2 reasons"), False)
    both = headline_of(with_figures(two, mean_difference=0.5, mean_difference_margin=0.001))
    assert both.text == (
        "The pictures differ: in the mean by +50.00% ± 0.10% (2 reasons under Not Matched), so no speed-up is said"
    )


@pytest.mark.parametrize(
    "harmless",
    [
        {"mean_difference": 0.009, "mean_difference_margin": 1e-6},  # nobody sees it
        {"mean_difference": 0.02, "mean_difference_margin": 0.029},  # chance, and no more than the tolerance
        {"difference": 0.01**2 * 0.9, "difference_error": 1e-9, "noise_lobe": 1e-6},  # nobody sees it
        {"difference": 0.001, "difference_error": 0.0004},  # chance
        {"difference": 0.001, "difference_error": 1e-9, "noise_lobe": 0.05, "noise_cycles": 0.05},  # lost in the noise
        {"ratio_error": 0.49},
    ],
)
def test_differences_that_do_not_matter(outcome, harmless):
    assert headline_of(with_figures(outcome, **harmless)).speedup


def test_the_headline_of_pictures_that_are_measured_to_differ(outcome):
    """Not of figures made up: a picture that is brighter, and one that is so in a corner, the mean made good."""
    lobe, cycles = renders(1.05, 0.1, 1), renders(1.0, 0.1, 2)
    brighter = dataclasses.replace(outcome, figures=figures.measure(lobe, cycles, TIMES, 0.0))
    assert headline_of(brighter).text.startswith("The pictures differ: in the mean by +4.98% ±")
    lobe = renders(1.0, 0.1, 1)
    lobe[:, :20] += 0.5
    lobe[:, 20:] -= 0.1
    elsewhere = dataclasses.replace(outcome, figures=figures.measure(lobe, cycles, TIMES, 0.0))
    assert headline_of(elsewhere).text.startswith("The pictures differ: in the pixels by 19.0%")


@pytest.mark.parametrize(
    ("ratio", "error", "text"),
    [
        (5.36, 0.01, "5.4 ± 0.1"),
        (5.36, 0.1, "5.4 ± 0.6"),
        (9.96, 0.2, "10 ± 2"),
        (128.0, 0.1, "130 ± 20"),
        (0.0312, 0.5, "0.031 ± 0.016"),
        (2.0, 0.05, "2.0 ± 0.1"),
    ],
)
def test_two_digits_and_an_error_that_is_never_too_small(ratio, error, text):
    assert page.times(ratio, error) == text


def test_the_page_needs_nothing_else(outcome):
    text = html(outcome)
    assert text.count("data:image/png;base64,") == 4
    assert not re.search(r"https?:|//|<link|@import|\burl\(", re.sub(r"base64,[^\"]*", "", text))
    assert "<script src" not in text and text.count("<script>") == 1
    assert "&lt;A &amp; B&gt;" in text and "<A & B>" not in text
    assert "Passes are ticked in &lt;Layer&gt;" in text
    assert "Cycles: Seed" in text and "prefers-color-scheme: dark" in text
    assert page.times(outcome.figures.speedup, outcome.figures.ratio_error) in text
    assert "as it comes from two renders of each engine alone" in text and "of more than 5%," in text
    assert 'type="range"' in text


def test_the_page_holds_upright_pictures_and_long_names(outcome):
    """Seen in a browser: the slider was higher than the window, and a name ran out of the page."""
    text = html(dataclasses.replace(outcome, size=(1080, 1920)))
    assert re.search(r'<div class="slider" style="max-width: calc\(\d+vh \* 1080 / 1920\)">', text)
    assert re.search(r"^body \{[^}]*overflow-wrap: anywhere", text, re.MULTILINE)


def test_the_page_without_anything_to_say(outcome):
    text = html(dataclasses.replace(outcome, changed=[], unmatched=[]))
    assert "both engines were asked for the same picture" in text and "<p>None.</p>" in text


def test_what_is_not_known_is_null(outcome):
    found = dataclasses.replace(outcome.figures, speedup=math.nan, mean_difference=math.inf)
    values = json.loads(json.dumps(compare.data(dataclasses.replace(outcome, figures=found)), allow_nan=False))
    assert values["figures"]["speedup"] is None and values["figures"]["mean_difference"] is None
    assert values["figures"]["flip"] == 0.25 and "pictures" not in values


def test_times_that_wander_make_the_speedup_unsure():
    """Two renders of each engine: what their sampling times differ by is in the error, whichever is the quicker, and
    what is prepared only once is not."""
    cold, slow, quick = Timing(9.0, 1.0), Timing(2.2, 1.2), Timing(2.0, 1.0)
    assert figures.wander([(cold, quick), (quick, quick)]) == 0.0
    one = math.log(1.2) / math.sqrt(2)
    assert figures.wander([(slow, quick), (quick, quick)]) == pytest.approx(one)
    assert figures.wander([(quick, slow), (slow, quick)]) == pytest.approx(one * math.sqrt(2))
    assert math.isnan(figures.wander([(quick, quick), (Timing(0.1, 0.0), quick)]))
    steady, unsure = (figures.measure(renders(1.0, 0.1, 1), renders(1.0, 0.2, 2), TIMES, 0.0, e) for e in (0.0, 0.3))
    assert unsure.ratio_error == pytest.approx(math.hypot(steady.ratio_error, 0.3))
    assert unsure.speedup == steady.speedup


def test_what_was_changed_is_listed_by_the_command(outcome):
    changed = [("Cycles: Clamp Indirect", "5", "0")]
    lines = compare.text(dataclasses.replace(outcome, changed=changed)).splitlines()
    assert lines[-2:] == ["Changed for the comparison:", "  Cycles: Clamp Indirect: 5 -> 0"]
    assert "Changed" not in compare.text(dataclasses.replace(outcome, changed=[]))


def test_samples_that_cycles_does_not_tell(outcome):
    timed = dataclasses.replace(outcome, seconds=1.0, samples={"LOBE": 12.5, "CYCLES": 0.0})
    assert page.engine_rows(timed)[0] == ("Samples", "12.5", "not told")
    assert compare.data(timed)["samples"] == {"LOBE": 12.5, "CYCLES": None}
    assert page.engine_rows(outcome)[0] == ("Samples", "64", "64")
