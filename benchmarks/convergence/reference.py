"""The picture that errors are measured against: the plain mean of long renders of both engines, several seeds of each.

It favours neither engine: if one were biased, both would be off by half of that bias, and the test of agreement would
say so. Its own noise is known from the variance between its seeds. A picture's relMSE against it is too large by that
noise, on the average, so `errors` takes it off again, pixel by pixel; where a level's relMSE comes near the noise of
the reference, its figure is marked.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tools import metrics

TRIM = 0.001
MARGIN = 5.0  # a relMSE below this many times the reference's noise is marked


@dataclass(frozen=True)
class Reference:
    picture: np.ndarray  # (h, w, 3) float64, scene-linear
    noise_map: np.ndarray  # (h, w, 3) float64: variance of `picture`, relative as relMSE is
    replicates: np.ndarray  # (seeds, h, w, 3) float64: each the mean of one render of either engine
    samples: int  # of each render
    comparison: metrics.Comparison  # of the two engines, Lobe first
    agreement: np.ndarray  # (h, w): Welch's t of the two, of the mean over channels, positive where Lobe is brighter

    @property
    def noise(self) -> float:
        """The relMSE that the reference has itself."""
        return float(self.noise_map.mean())

    @property
    def verdict(self) -> str:
        return "agree" if metrics.agree(self.comparison) else "DIFFER"

    def errors(self, picture: np.ndarray) -> tuple[float, float]:
        """relMSE of a picture that shares no noise with the reference: whole, and without its worst 0.1 %.

        The reference's noise is taken off, so a picture without any error gives 0 in the mean, and as often less.
        """
        raw = metrics.rel_errors(picture, self.picture).ravel()
        net = raw - self.noise_map.ravel()
        kept = np.argsort(raw)[: metrics.kept_by_trimming(raw.size, TRIM)]
        return float(net.mean()), float(net[kept].mean())


def make_reference(lobe: np.ndarray, cycles: np.ndarray, samples: int) -> Reference:
    """From the engines' pictures, (seeds, h, w, 3) each, the same number of both."""
    lobe, cycles = lobe.astype(np.float64), cycles.astype(np.float64)
    picture = (lobe.mean(axis=0) + cycles.mean(axis=0)) / 2
    variance = (lobe.var(axis=0, ddof=1) + cycles.var(axis=0, ddof=1)) / (4 * len(lobe))
    noise_map = variance / (picture**2 + metrics.REL_MSE_EPSILON)
    return Reference(
        picture, noise_map, (lobe + cycles) / 2, samples, metrics.compare(lobe, cycles), agreement(lobe, cycles)
    )


def agreement(lobe: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Welch's t of two sets of replicates, (seeds, h, w, 3) to (h, w), of the mean over channels; rounding counts 0."""
    a, b = lobe.mean(axis=-1), cycles.mean(axis=-1)
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    t, _, _ = metrics.welch(mean_a, a.var(axis=0, ddof=1), len(a), mean_b, b.var(axis=0, ddof=1), len(b))
    return np.where(np.abs(mean_a - mean_b) <= metrics.ROUNDING * np.abs(mean_b) + 1e-7, 0.0, t)
