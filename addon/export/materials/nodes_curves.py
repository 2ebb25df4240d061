"""Value nodes with curves that are drawn by hand: RGB Curves, Vector Curves and Float Curve.

As in Cycles (blender/shader.cpp, kernel/svm/ramp.h) a curve is read at some places, between which it is straight. They
span all of its points, and at least 0 to 1; beyond them it goes on as straight or stays level, as its node says. What
doesn't vary Blender works out by itself before Cycles sees it, from 5.0 on: then it is exact.
"""

from __future__ import annotations

import numpy as np

from .tree import INLINED, Slot
from .values import Evaluator, value_node

PLACES = 256  # RAMP_TABLE_SIZE


class Curves:
    """Those of a bpy CurveMapping, one for each channel.

    with_common  its fourth comes before each of them
    clips        whether Blender clips what comes out, where the mapping says so; Cycles does not
    """

    def __init__(self, mapping, channels: int, with_common: bool = False, clips: bool = False) -> None:
        mapping.initialize()
        self._clips = clips and mapping.use_clip
        self._mapping = mapping
        self._curves = list(mapping.curves)[:channels]
        self._common = mapping.curves[3] if with_common else None
        used = [*self._curves, self._common] if with_common else self._curves
        ends = [curve.points[i].location[0] for curve in used for i in (0, -1)]
        self._low, self._high = min(0.0, *ends), max(1.0, *ends)

    def of(self, value: np.ndarray) -> np.ndarray:
        """(..., channels), each by its own curve."""
        read = self._read_exactly if INLINED and value.ndim == 1 else self._read_table
        return np.stack([read(curve, value[..., i]) for i, curve in enumerate(self._curves)], axis=-1)

    def _read_exactly(self, curve, value: np.ndarray) -> np.ndarray:
        mapping = self._mapping
        low, high = (mapping.clip_min_y, mapping.clip_max_y) if self._clips else (-np.inf, np.inf)
        for each in (self._common, curve) if self._common else (curve,):
            value = np.clip(mapping.evaluate(each, float(value)), low, high)
        return np.asarray(value)

    def _read_table(self, curve, value: np.ndarray) -> np.ndarray:
        evaluate, places = self._mapping.evaluate, np.linspace(self._low, self._high, PLACES).tolist()
        if self._common:
            places = [evaluate(self._common, place) for place in places]
        table = np.array([evaluate(curve, place) for place in places])
        at = (value - self._low) / (self._high - self._low) * (PLACES - 1)
        inside = np.interp(at, np.arange(PLACES), table)
        if self._mapping.extend != "EXTRAPOLATED":
            return inside
        before, after = np.minimum(at, 0.0), np.maximum(at - (PLACES - 1), 0.0)
        return inside + before * (table[1] - table[0]) + after * (table[-1] - table[-2])


def blend(evaluator: Evaluator, slot: Slot, factor: str, value: np.ndarray, curves: Curves) -> np.ndarray:
    """factor: the name of the input that says how much the curves count."""
    share = evaluator.array(slot.input(factor), 1.0)
    return (1.0 - share) * value + share * curves.of(value)


@value_node("ShaderNodeRGBCurve")
def rgb_curves(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    curves = Curves(slot.node.mapping, 3, with_common=True)
    return blend(evaluator, slot, "Fac", evaluator.color(slot.input("Color")), curves)


@value_node("ShaderNodeVectorCurve")
def vector_curves(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    return blend(evaluator, slot, "Fac", evaluator.vector(slot.input("Vector")), Curves(slot.node.mapping, 3))


@value_node("ShaderNodeFloatCurve")
def float_curve(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    curves = Curves(slot.node.mapping, 1, clips=True)
    return blend(evaluator, slot, "Factor", evaluator.array(slot.input("Value")), curves)
