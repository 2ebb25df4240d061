"""The two reflection lobes, for batches of n directions: diffuse, and modified Phong (Lafortune & Willems 1994).

Directions are unit vectors (n, 3) that leave the surface: `wo` to where the light goes (the camera), `wi` to where it
comes from. The values never contain the cosine. A density is per steradian. All in float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .vectors import around, dot, random_angle, unit


@dataclass
class Lobes:
    """What n surface points reflect, and how a direction is drawn there.

    kd, ks      (n, 3) diffuse and Phong reflectance
    exponent    (n,) of the Phong lobe
    normal      (n, 3) shading normal
    flat        (n, 3) geometric normal, on the side of `wo`
    phong_share (n,) probability of drawing from the Phong lobe rather than from the diffuse one
    hemisphere  how the diffuse lobe is drawn: "COSINE", "UNIFORM" or "REJECTION"
    """

    kd: np.ndarray
    ks: np.ndarray
    exponent: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    phong_share: np.ndarray
    hemisphere: str = "COSINE"


def make_lobes(kd, ks, exponent, normal, flat, wo, selection: str = "ALBEDO", hemisphere: str = "COSINE") -> Lobes:
    """`selection` "CLASSIC" shares the draws as kd : ks; "ALBEDO" weighs ks with what the lobe reflects from `wo`.

    The Phong lobe needs `wo` above the shading normal's horizon; it is left out where an interpolated normal
    leans so far that it is not.
    """
    diffuse, phong = kd.mean(axis=1), ks.mean(axis=1)
    cosine = dot(normal, wo)
    weight = phong * phong_albedo(np.maximum(cosine, 0), exponent) if selection == "ALBEDO" else phong
    weight = np.where(cosine > 0, weight, 0)
    total = diffuse + weight
    share = np.divide(weight, total, out=np.zeros_like(total), where=total > 0)
    return Lobes(kd, ks, exponent, normal, flat, share, hemisphere)


def phong_albedo(cosine: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    """About the fraction that the lobe reflects at ks = 1; exact for exponent 0. It only steers the choice of lobe.

    A sharp lobe reflects cos(theta); at grazing angles, where half of it lies below the surface, 0.5 / sqrt(1 + 1.5 n)
    is within 3 % of the quadrature for every n.
    """
    grazing = 0.5 / np.sqrt(1 + 1.5 * exponent)
    return cosine + (1 - cosine) * grazing


def evaluate(lobes: Lobes, wo: np.ndarray, wi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The diffuse value (n, 3), the Phong value (n, 3), and the density (n,) with which `sample` draws `wi`.

    All are zero for a `wi` below the horizon of the shading normal or of the geometric one.
    """
    cosine = dot(lobes.normal, wi)
    above = (cosine > 0) & (dot(lobes.flat, wi) > 0)
    cos_n = np.where(dot(lobes.normal, wo) > 0, mirror_power(lobes.normal, wo, wi, lobes.exponent), 0)

    # Lafortune & Willems 1994: (n + 2) / (2 pi) cos^n(alpha), drawn with (n + 1) / (2 pi) cos^n(alpha).
    f_diffuse = lobes.kd / np.pi
    f_phong = lobes.ks * ((lobes.exponent + 2) / (2 * np.pi) * cos_n)[:, None]
    pdf_diffuse = cosine / np.pi if lobes.hemisphere == "COSINE" else np.full_like(cosine, 0.5 / np.pi)
    pdf_phong = (lobes.exponent + 1) / (2 * np.pi) * cos_n

    b = lobes.phong_share
    pdf = (1 - b) * pdf_diffuse + b * pdf_phong
    return f_diffuse * above[:, None], f_phong * above[:, None], pdf * above


def sample(lobes: Lobes, wo: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Directions `wi` (n, 3), drawn with the density that `evaluate` gives. Those below the surface count as zero."""
    phong = rng.random(len(wo)) < lobes.phong_share
    wi = np.empty_like(wo)
    wi[~phong] = around(lobes.normal[~phong], _hemisphere(np.count_nonzero(~phong), lobes.hemisphere, rng))
    wi[phong] = around(mirror(lobes.normal, wo)[phong], _phong_lobe(lobes.exponent[phong], rng))
    return wi


def mirror(normal: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """The mirror direction of `wo` about `normal`."""
    return unit(2 * dot(normal, wo)[:, None] * normal - wo)


def mirror_power(normal: np.ndarray, wo: np.ndarray, wi: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    """cos^n of the angle between `wi` and the mirror direction R of `wo`; zero beyond a right angle.

    1 - cos = |wi - R|^2 / 2 keeps its digits where cos is nearly 1, and with a large exponent that is everywhere.
    """
    off = wi - mirror(normal, wo)
    one_minus_cos = dot(off, off) / 2
    inside = one_minus_cos < 1
    return np.where(inside, np.exp(exponent * np.log1p(-np.where(inside, one_minus_cos, 0))), 0)


def _phong_lobe(exponent: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Directions about z with density (n + 1) / (2 pi) cos^n: cos = u^(1 / (n + 1)), written without cancellation."""
    t = -np.log(1 - rng.random(len(exponent))) / (exponent + 1)
    sine, cosine = np.sqrt(-np.expm1(-2 * t)), np.exp(-t)
    x, y = random_angle(len(exponent), rng)
    return np.column_stack([sine * x, sine * y, cosine])


def _hemisphere(count: int, method: str, rng: np.random.Generator) -> np.ndarray:
    """Directions about z, (count, 3)."""
    if method == "REJECTION":
        return rejection_hemisphere(count, rng)[0]
    u = rng.random(count)
    cosine = np.sqrt(1 - u) if method == "COSINE" else u
    sine = np.sqrt(np.maximum(1 - cosine * cosine, 0))
    x, y = random_angle(count, rng)
    return np.column_stack([sine * x, sine * y, cosine])


def rejection_hemisphere(count: int, rng: np.random.Generator) -> tuple[np.ndarray, int]:
    """Uniform directions about z, (count, 3), and how many points it took.

    Points in the cube around the unit ball are kept if they fall into its upper half: one in 12 / pi = 3.82.
    """
    kept, draws = np.empty((count, 3)), 0
    missing = np.arange(count)
    while len(missing):
        point = rng.uniform(-1, 1, (len(missing), 3))
        draws += len(missing)
        length2 = dot(point, point)
        good = (point[:, 2] > 0) & (length2 <= 1) & (length2 > 1e-12)
        kept[missing[good]] = unit(point[good])
        missing = missing[~good]
    return kept, draws
