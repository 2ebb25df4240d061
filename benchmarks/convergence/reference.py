"""The picture that errors are measured against: the plain mean of long renders of both engines, several seeds of each.

It favours neither engine: if one were biased, both would be off by half of that bias, and the test of agreement would
say so. Its own noise is known from the variance between its seeds. A picture's relMSE against it is too large by that
noise, on the average, so `errors` takes it off again, pixel by pixel; where a level's relMSE comes near the noise of
the reference, its figure is marked.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tools import metrics

TRIM = 0.001
TOLERATED = 0.002  # relative difference of the engines' means
AGREE, OPEN, DIFFER = "agree", "open", "DIFFER"
MARGIN = 5.0  # a relMSE below this many times the reference's noise is marked


@dataclass(frozen=True)
class Reference:
    picture: np.ndarray  # (h, w, 3) float64, scene-linear
    noise_map: np.ndarray  # (h, w, 3) float64: variance of `picture`, relative as relMSE is
    replicates: np.ndarray  # (seeds, h, w, 3) float64: each the mean of one render of either engine
    samples: int  # of each render
    comparison: metrics.Comparison  # of the two engines, Lobe first
    verdict: str  # on the two engines' pictures: AGREE, OPEN or DIFFER
    agreement: np.ndarray  # (h, w): Welch's t of the two, of the mean over channels, positive where Lobe is brighter

    @property
    def noise(self) -> float:
        """The relMSE that the reference has itself."""
        return float(self.noise_map.mean())

    def errors(self, picture: np.ndarray) -> tuple[float, float]:
        """relMSE of a picture that shares no noise with the reference: whole, and without its worst 0.1 %.

        The reference's noise is taken off, so a picture without any error gives 0 in the mean, and as often less.
        """
        raw = metrics.rel_errors(picture, self.picture).ravel()
        net = raw - self.noise_map.ravel()
        kept, _ = worst_apart(raw)
        return float(net.mean()), float(net[kept].mean())

    def shifts(self, picture: np.ndarray, runs: int) -> np.ndarray:
        """(2, runs): what both of `errors` change by when the reference's replicates are drawn anew, with replacement.

        The error that a reference happens to have is the same for all pictures measured against it, of both engines;
        so the same draws are made for each picture. With d_i = replicate i less the reference, draw weights c and the
        inner product of relMSE, |I - R - sum c_i d_i|^2 is that of before, less 2 sum c_i <I - R, d_i>, plus c'Gc with
        G_ij = <d_i, d_j>; less what c'Gc is expected to be of replicates of that variance, drawn so often:
        (sum c_i^2 - 1 / n) tr(G) / (n - 1). Which values are trimmed stays as it is, and so do relMSE's denominators.
        """
        raw = metrics.rel_errors(picture, self.picture).ravel()
        _, worst = worst_apart(raw)
        difference = (picture - self.picture).ravel() * self._weights
        across, trimmed_across = self._deviations @ difference, self._deviations[:, worst] @ difference[worst]
        within, trimmed_within = self._products, self._product(worst)
        size = raw.size
        return np.stack([
            self._shift(across, within, runs) / size,
            self._shift(across - trimmed_across, within - trimmed_within, runs) / (size - len(worst)),
        ])  # fmt: skip

    def _shift(self, across: np.ndarray, within: np.ndarray, runs: int) -> np.ndarray:
        """Summed over pixels. across (replicates,): <I - R, d_i>; within (replicates, replicates): G."""
        n = len(within)
        drawn = np.random.default_rng(1).multinomial(n, np.full(n, 1 / n), runs) / n
        square = np.einsum("ri,ij,rj->r", drawn, within, drawn)
        return -2 * drawn @ across + square - ((drawn**2).sum(axis=1) - 1 / n) * np.trace(within) / (n - 1)

    @cached_property
    def _weights(self) -> np.ndarray:
        return 1.0 / (self.picture**2 + metrics.REL_MSE_EPSILON).ravel()

    @cached_property
    def _deviations(self) -> np.ndarray:
        """(replicates, values)."""
        return (self.replicates - self.picture).reshape(len(self.replicates), -1)

    @cached_property
    def _products(self) -> np.ndarray:
        return self._product(slice(None))

    def _product(self, which) -> np.ndarray:
        some = self._deviations[:, which]
        return (some * self._weights[which]) @ some.T


def worst_apart(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the errors are that trimming keeps, and the worst, that it leaves out."""
    order, kept = np.argsort(errors), metrics.kept_by_trimming(errors.size, TRIM)
    return order[:kept], order[kept:]


def make_reference(lobe: np.ndarray, cycles: np.ndarray, samples: int) -> Reference:
    """From the engines' pictures, (seeds, h, w, 3) each, the same number of both."""
    lobe, cycles = lobe.astype(np.float64), cycles.astype(np.float64)
    picture = (lobe.mean(axis=0) + cycles.mean(axis=0)) / 2
    variance = (lobe.var(axis=0, ddof=1) + cycles.var(axis=0, ddof=1)) / (4 * len(lobe))
    noise_map = variance / (picture**2 + metrics.REL_MSE_EPSILON)
    found = metrics.compare(lobe, cycles)
    return Reference(
        picture, noise_map, (lobe + cycles) / 2, samples, found, verdict(lobe, cycles, found), agreement(lobe, cycles)
    )


def verdict(lobe: np.ndarray, cycles: np.ndarray, found: metrics.Comparison) -> str:
    """AGREE is shown, DIFFER refuted, OPEN neither. Given each engine's pictures and what comparing them has found."""
    judged = {metrics.judge_mean(lobe, cycles, TOLERATED), metrics.judge_pixels(found)}
    return DIFFER if metrics.FAIL in judged else OPEN if metrics.OPEN in judged else AGREE


def agreement(lobe: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Welch's t of two sets of replicates, (seeds, h, w, 3) to (h, w), of the mean over channels; rounding counts 0."""
    a, b = lobe.mean(axis=-1), cycles.mean(axis=-1)
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    t, _, _ = metrics.welch(mean_a, a.var(axis=0, ddof=1), len(a), mean_b, b.var(axis=0, ddof=1), len(b))
    return np.where(np.abs(mean_a - mean_b) <= metrics.ROUNDING * np.abs(mean_b) + 1e-7, 0.0, t)
