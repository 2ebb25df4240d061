"""Cases of hemispheres and of surfaces: directions drawn at a point that is looked at."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from engine.kernels import bsdf
from engine.kernels.bsdf.diffuse import diffuse_pdf, sample_diffuse
from engine.kernels.jit import device, kernel
from engine.kernels.registry import Sampler
from engine.kernels.sampler.random import hash32
from engine.settings import HEMISPHERE_SAMPLING, LOBE_SELECTION
from tests.statistics import chi2
from tests.statistics.drawn import BENT, TILTED, UP, Drawn

f32 = np.float32
COSINE, UNIFORM, REJECTION = range(3)
ANGLES = (0, 15, 30, 45, 60, 70, 80, 85, 89)  # degrees of wo to the normal
EXPONENTS = (0, 1, 10, 100, 1e3, 1e4, 1e6)


@device
def state_of(u):
    """Of the generator that rejection sampling takes its numbers from: another for other u (n, 2 or more)."""
    return hash32(np.uint32(u[0, 0] * np.float32(2**24)) ^ hash32(np.uint32(u[0, 1] * np.float32(2**24))))


@kernel
def draw_hemisphere(hemisphere, n, u, out):
    rng, draws = state_of(u), 0
    for i in range(len(u)):
        wi, rng, more = sample_diffuse(hemisphere, n, u[i, 0], u[i, 1], rng)
        out[i, 0], out[i, 1], out[i, 2] = wi
        draws += more
    return draws


@kernel
def hemisphere_pdf(hemisphere, cosine, out):
    for i in range(len(cosine)):
        out[i] = diffuse_pdf(hemisphere, cosine[i])


class Hemisphere(Drawn):
    def __init__(self, index: int, n=UP) -> None:
        self.index, self.n = index, np.asarray(n, float)
        self.name = f"{HEMISPHERE_SAMPLING[index]} hemisphere about {self.n.round(2)}"

    def draw(self, count: int, seed: int):
        out = np.empty((count, 3), np.float32)
        self.needed = draw_hemisphere(self.index, chi2.vec(self.n), chi2.uniforms(count, 2, seed), out)
        return out.astype(float), np.ones(count, bool)

    def density(self, points: np.ndarray) -> np.ndarray:
        cosine = points @ self.n
        out = np.empty(len(points), np.float32)
        hemisphere_pdf(self.index, cosine.astype(np.float32), out)
        return np.where(cosine > 0, out, 0).astype(float)


def hemispheres(entry: Sampler) -> Iterator[chi2.Case]:
    yield from (Hemisphere(entry.example, n) for n in (UP, TILTED, -UP))


@kernel
def draw_surface(has_phong, hemisphere, surface, wo, n, ng, u, wi_out, f_out, pdf_out, lobe_out):
    rng = state_of(u)
    for i in range(len(u)):
        wi, f, pdf, lobe, rng, _ = bsdf.sample(
            has_phong, hemisphere, surface, wo, n, ng, u[i, 0], u[i, 1], u[i, 2], rng
        )
        pdf_out[i], lobe_out[i] = pdf, lobe
        for k in range(3):
            wi_out[i, k], f_out[i, k] = wi[k], f[k]


@kernel
def evaluate_surface(has_phong, hemisphere, surface, wo, n, ng, wi, f_out, pdf_out):
    for i in range(len(wi)):
        f, pdf = bsdf.evaluate(has_phong, hemisphere, surface, wo, (wi[i, 0], wi[i, 1], wi[i, 2]), n, ng)
        pdf_out[i] = pdf
        for k in range(3):
            f_out[i, k] = f[k]


@kernel
def phong_probability(selection, kd, ks, exponent, cos_o):
    return bsdf.phong_probability(selection, kd, ks, exponent, cos_o)


def _shown(color) -> str:
    return " ".join(f"{x:g}" for x in np.unique(color))


class Surface(Drawn):
    """One surface seen from one direction, `angle` degrees off the normal. kd, ks: a number or three. p_phong: by
    `selection` unless given."""

    def __init__(
        self, kd=0.0, ks=0.0, exponent=0.0, p_phong=None, angle=0.0, hemisphere=COSINE, n=UP, ng=None, selection=0
    ) -> None:
        self.kd, self.ks, self.exponent, self.hemisphere, self.angle = kd, ks, exponent, hemisphere, angle
        self.n = np.asarray(n, float)
        self.ng = self.n if ng is None else np.asarray(ng, float)
        x, _, z = chi2.frame(self.n)
        self.wo = np.sin(np.radians(angle)) * x + np.cos(np.radians(angle)) * z
        self.mirror = 2 * (self.wo @ self.n) * self.n - self.wo
        colors = chi2.vec(np.broadcast_to(kd, 3)), chi2.vec(np.broadcast_to(ks, 3))
        if p_phong is None:
            p_phong = phong_probability(selection, *colors, f32(exponent), f32(self.wo @ self.n))
        self.p_phong = float(p_phong)
        self.surface = (*colors, f32(exponent), f32(p_phong))
        self.arguments = (self.surface, chi2.vec(self.wo), chi2.vec(self.n), chi2.vec(self.ng))
        self.name = (
            f"kd {_shown(kd)} ks {_shown(ks)} exponent {exponent:g} at {angle:g} degrees, "
            f"{HEMISPHERE_SAMPLING[hemisphere]} {LOBE_SELECTION[selection]} p {self.p_phong:.3f}"
        )
        if ng is not None:
            self.name += " bent"

    def sample(self, u: np.ndarray):
        """(wi, f of the first channel, pdf, lobe), float64, for random numbers u (n, 3) float32."""
        wi, f = np.empty((2, len(u), 3), np.float32)
        pdf, lobe = np.empty(len(u), np.float32), np.empty(len(u), np.int32)
        draw_surface(int(np.any(self.ks)), self.hemisphere, *self.arguments, u, wi, f, pdf, lobe)
        return wi.astype(float), f[:, 0].astype(float), pdf.astype(float), lobe

    def evaluate(self, wi: np.ndarray):
        """(f of the first channel, pdf), float64"""
        f, pdf = np.empty((len(wi), 3), np.float32), np.empty(len(wi), np.float32)
        evaluate_surface(int(np.any(self.ks)), self.hemisphere, *self.arguments, np.asarray(wi, np.float32), f, pdf)
        return f[:, 0].astype(float), pdf.astype(float)

    def draw(self, count: int, seed: int):
        wi, _, pdf, _ = self.sample(chi2.uniforms(count, 3, seed))
        return wi, pdf > 0

    def density(self, points: np.ndarray) -> np.ndarray:
        return self.evaluate(points)[1]


def phong_lobes(entry: Sampler) -> Iterator[chi2.Case]:
    for exponent in EXPONENTS:
        yield from (Surface(ks=0.9, exponent=exponent, angle=angle) for angle in ANGLES)
    yield Surface(ks=0.9, exponent=10, angle=70, n=TILTED, ng=BENT)


SHARES = [
    (0.7, 0.0), (0.45, 0.05), (0.4, 0.5), (0.05, 0.9), (0.001, 0.2),
    ((0.6, 0.1, 0.0), (0.05, 0.3, 0.9)), ((0.0, 0.0, 0.5), (0.4, 0.0, 0.0)),
]  # fmt: skip


def combined(entry: Sampler) -> Iterator[chi2.Case]:
    """Some of the grid of kd and ks, by each way to draw the diffuse lobe; exponents and angles take turns."""
    others = [(0, 60), (10, 80), (100, 30), (1e3, 85), (1e4, 60), (1e6, 45)]
    for i, (kd, ks) in enumerate(SHARES[:5]):
        for hemisphere in range(len(HEMISPHERE_SAMPLING)):
            for turn in range(2 if ks else 1):
                exponent, angle = others[(2 * i + hemisphere + 3 * turn) % len(others)]
                yield Surface(kd, ks, exponent, None, angle, hemisphere, TILTED, selection=entry.example)
    for kd, ks in SHARES[5:]:
        yield Surface(kd, ks, 30, None, 60, n=TILTED, selection=entry.example)
    for exponent in (1, 10, 1e4):
        yield Surface(0.4, 0.5, exponent, None, 89, n=TILTED, selection=entry.example)
    yield Surface(0.4, 0.5, 10, None, 60, n=TILTED, ng=BENT, selection=entry.example)


def whole_grid(selection: int, hemisphere: int) -> Iterator[chi2.Case]:
    """Every share of kd and ks with every exponent at every angle."""
    for kd, ks in SHARES:
        for exponent in EXPONENTS if np.any(ks) else (0,):
            for angle in ANGLES:
                yield Surface(kd, ks, exponent, None, angle, hemisphere, TILTED, selection=selection)
