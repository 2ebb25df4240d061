"""What a comparison says first: whether the pictures agree, and how many times as fast Lobe is, or why nobody can
tell. No bpy.

The rule is here alone: the panel, the reports, the page and the command line show a speed-up where `Headline.speedup`
says so, and nowhere else. A time to equal error means nothing where the engines draw different pictures, where noise
may hide that they do, or where the errors themselves are hardly known.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from .figures import Figures

if TYPE_CHECKING:
    from .run import Outcome

SEEN = 0.01  # relative: pictures that differ by less are the same picture to the eye
AGREED = 0.05  # relative: pictures agree where they are certainly no farther apart
OF_PIXELS = 3.0  # standard errors: there are as many degrees of freedom as pixels, with long tails
OF_NOISE = 0.25  # of the noise: half as large, were both not squared
UNSURE = 0.5  # standard error of the speed-up, relative: from there on it is less than two of them away from nothing


class Headline(NamedTuple):
    text: str
    speedup: bool  # whether the speed-up means something, and may be shown


def headline_of(outcome: Outcome) -> Headline:
    found, reasons = outcome.figures, _reasons(len(outcome.different))
    if apart := _apart(found):
        listed = f" ({reasons})" if reasons else ""
        return Headline(f"The pictures differ: {', '.join(apart)}{listed}, so no speed-up is said", False)
    if reasons:
        return Headline(f"The engines were not asked for the same ({reasons}), so no speed-up is said", False)
    if math.isnan(found.noise_lobe) or math.isnan(found.noise_cycles):
        return Headline("The noise isn't known (see Not Matched), so no speed-up is said", False)
    if open_ := _open(found):
        unsure = f"they may be {' and '.join(open_)}"
        return Headline(f"Too noisy to tell whether the pictures agree ({unsure}): take more samples", False)
    agree = f"The pictures agree within {AGREED:.0%}"
    if not math.isfinite(found.speedup):
        return Headline(f"{agree}. The renders are too short to be timed: take more samples", False)
    if not found.ratio_error < UNSURE:
        return Headline(f"{agree}. Too noisy to tell who is the faster: take more samples", False)
    ratio = times(found.speedup, found.ratio_error)
    return Headline(f"Lobe is {ratio} times as fast as Cycles at equal error. {agree}", True)


def times(ratio: float, error: float) -> str:
    """Two significant digits and the standard error, rounded up to the last of them. error: relative."""
    value = float(f"{ratio:.1e}")
    digits = 1 - math.floor(math.log10(value))  # behind the point
    unit = 10.0**-digits
    upwards = math.ceil(round(ratio * error / unit, 6)) * unit
    return f"{value:.{max(digits, 0)}f} ± {upwards:.{max(digits, 0)}f}"


def _reasons(number: int) -> str:
    return f"{number} reason{'s' if number > 1 else ''} under Not Matched" if number else ""


def _apart(found: Figures) -> list[str]:
    """In what the pictures differ in earnest: more than chance makes of noise, and so much that it matters."""
    apart = []
    mean, margin = found.mean_difference, found.mean_difference_margin
    if math.isinf(mean):
        apart.append("Cycles' is black")
    elif abs(mean) >= SEEN and abs(mean) > margin:
        apart.append(f"in the mean by {mean:+.2%} ± {margin:.2%}")
    least = max(SEEN**2, OF_PIXELS * found.difference_error)
    if found.difference > least and not found.difference < OF_NOISE * found.noise_lobe:  # which may be unknown
        squared = f"{found.difference:.1e}"  # as it stands among the figures
        apart.append(f"in the pixels by {math.sqrt(found.difference):.1%} (root of relMSE {squared}) beyond the noise")
    return apart


def _open(found: Figures) -> list[str]:
    """In what the pictures may differ, for all that can be told through the noise."""
    mean = abs(found.mean_difference) + found.mean_difference_margin
    pixels = math.sqrt(max(found.difference + OF_PIXELS * found.difference_error, 0.0))
    bounds = {"mean": mean, "pixels": pixels}
    return [f"up to {bound:.1%} apart in the {what}" for what, bound in bounds.items() if not bound <= AGREED]
