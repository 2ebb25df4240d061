"""Shader nodes that the engine's lobes cover as they are, and the ones that combine shaders."""

from __future__ import annotations

import numpy as np

from .surface import DARKER_EDGES, NOTHING, Surface, Walk, shader_node
from .tree import Slot, is_phong_group


@shader_node("ShaderNodeBsdfDiffuse")
def diffuse(walk: Walk, slot: Slot) -> Surface:
    walk.note_normal(slot)
    if walk.number(slot, "Roughness") > 1e-5:
        walk.approximate("Diffuse BSDF's roughness is not supported, drawn without it")
    return Surface(diffuse=walk.color(slot, "Color"))


@shader_node("ShaderNodeBsdfGlossy", "ShaderNodeBsdfAnisotropic")
def glossy(walk: Walk, slot: Slot) -> Surface:
    """One id since Blender 4.0, which kept the name "Anisotropic" for it inside."""
    walk.note_normal(slot)
    if walk.number(slot, "Anisotropy") != 0.0:
        walk.note("anisotropy is not supported, drawn with round highlights")
    walk.note(DARKER_EDGES)
    return Surface(lobes=((walk.rough_share(slot) * walk.color(slot, "Color"), walk.exponent(slot)),))


@shader_node("ShaderNodeEmission", "ShaderNodeBackground")
def emission(walk: Walk, slot: Slot) -> Surface:
    """A negative strength is kept: the engine refuses it by the material's name."""
    color = walk.values.color(slot.input("Color"))
    return Surface(emission=color * walk.values.array(slot.input("Strength"), 1.0))


@shader_node("ShaderNodeBsdfTransparent")
def transparent(walk: Walk, slot: Slot) -> Surface:
    return Surface(transparency=walk.color(slot, "Color", (1.0, 1.0, 1.0)))


@shader_node("ShaderNodeAddShader")
def add(walk: Walk, slot: Slot) -> Surface:
    return walk.surface(slot.input("Shader")) + walk.surface(slot.input("Shader_001"))


@shader_node("ShaderNodeMixShader")
def mix(walk: Walk, slot: Slot) -> Surface:
    """A side with no share is not looked at, so that nothing in it is named."""
    factor = np.clip(walk.values.array(slot.input("Fac"), 0.5), 0.0, 1.0)
    first = walk.surface(slot.input("Shader")) if factor.min() < 1.0 else NOTHING
    second = walk.surface(slot.input("Shader_001")) if factor.max() > 0.0 else NOTHING
    return first.scaled(1.0 - factor) + second.scaled(factor)


@shader_node("ShaderNodeGroup")
def group(walk: Walk, slot: Slot) -> Surface:
    """Only `Phong BSDF` and groups without an output end here: `source` walks through all others."""
    if not is_phong_group(slot.node):
        walk.note(f"node group {slot.node.name!r} has no output, drawn black")
        return NOTHING
    exponent = walk.number(slot, "exponent")  # A negative one is refused by the engine, with the material's name.
    return Surface(diffuse=walk.color(slot, "kd"), lobes=((walk.color(slot, "ks"), exponent),))
