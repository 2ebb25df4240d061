"""Value nodes that bring constants in, and those whose value varies over a surface but has a fair constant."""

from __future__ import annotations

import numpy as np

from ..units import blackbody_rgb, mean_fresnel
from .cie import wavelength_rgb
from .tree import Slot
from .values import Evaluator, node_label, own_value, value_node


@value_node("ShaderNodeRGB", "ShaderNodeValue")
def constant(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    return own_value(slot.socket)


@value_node("ShaderNodeBlackbody")
def blackbody(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    return blackbody_rgb(evaluator.number(slot.input("Temperature")))


@value_node("ShaderNodeWavelength")
def wavelength(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    return wavelength_rgb(evaluator.number(slot.input("Wavelength")))


@value_node("ShaderNodeGroup")
def group(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    """Only groups without an output end here: `source` walks through all others."""
    evaluator.note(f"node group {slot.node.name!r} has no output, which counts as black")
    return np.zeros(3)


@value_node("ShaderNodeFresnel")
def fresnel(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    _note_average(evaluator, slot)
    return np.array([mean_fresnel(evaluator.number(slot.input("IOR"), 1.45))])


@value_node("ShaderNodeLayerWeight")
def layer_weight(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    """Cycles, kernel/svm/fresnel.h: the blend is 1 - 1 / eta for the Fresnel output, and shapes 1 - cos for Facing.

    Facing is cos-weighted over the hemisphere: the mean of 1 - cos^b is 1 - 2 / (b + 2).
    """
    _note_average(evaluator, slot)
    blend = min(max(evaluator.number(slot.input("Blend"), 0.5), 0.0), 1.0 - 1e-5)
    if slot.socket.identifier == "Fresnel":
        return np.array([mean_fresnel(1.0 / (1.0 - blend))])
    power = 2.0 * blend if blend < 0.5 else 0.5 / (1.0 - blend)
    return np.array([1.0 - 2.0 / (power + 2.0)])


@value_node("ShaderNodeTexCoord")
def texture_coordinate(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    """The middle of the object for the coordinates that run from 0 to 1 over it, and near enough for the others."""
    evaluator.note(f"{node_label(slot.node)} is not supported and counts with its middle")
    return np.full(3, 0.5)


@value_node("ShaderNodeTexChecker")
def checker(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    _note_average(evaluator, slot)
    if slot.socket.identifier == "Fac":
        return np.array([0.5])
    return (evaluator.color(slot.input("Color1")) + evaluator.color(slot.input("Color2"))) / 2.0


@value_node("ShaderNodeLightFalloff")
def light_falloff(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    """The quadratic one is how light falls off by itself."""
    if slot.socket.identifier != "Quadratic" or evaluator.number(slot.input("Smooth")) != 0.0:
        evaluator.note("Light Falloff is supported for a quadratic falloff without smoothing only")
    return evaluator.array(slot.input("Strength"), 1.0)


def _note_average(evaluator: Evaluator, slot: Slot) -> None:
    evaluator.note(f"{node_label(slot.node)} is not supported and counts with its average")
