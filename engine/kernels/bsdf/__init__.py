"""How surfaces scatter. Callers need `combined` only."""

from .combined import ALBEDO, CLASSIC, DIFFUSE_LOBE, PHONG_LOBE, evaluate, phong_probability, sample

__all__ = ["ALBEDO", "CLASSIC", "DIFFUSE_LOBE", "PHONG_LOBE", "evaluate", "phong_probability", "sample"]
