"""Shader nodes without a counterpart in the engine: each is named, and drawn with the nearest thing."""

from __future__ import annotations

import numpy as np

from ..units import mean_fresnel
from .surface import DARKER_EDGES, NOTHING, Surface, Walk, shader_node
from .tree import Slot
from .values import node_label

CLEAR = "a clear pane: what is behind it shows straight through, neither bent nor blurred"


def _note(walk: Walk, slot: Slot, drawn_as: str) -> None:
    walk.note(f"{node_label(slot.node)} is not supported, drawn as {drawn_as}")


@shader_node("ShaderNodeBsdfGlass")
def glass(walk: Walk, slot: Slot) -> Surface:
    """A mirror of the mean reflectance, and straight passage for the rest: right for panes, not for lenses."""
    _note(walk, slot, CLEAR)
    walk.note_normal(slot)
    color = np.minimum(walk.color(slot, "Color", (1.0, 1.0, 1.0)), 1.0)
    reflect = mean_fresnel(max(walk.number(slot, "IOR", 1.5), 1e-5))
    return Surface(lobes=((reflect * color, walk.exponent(slot)),), transparency=(1.0 - reflect) * color)


@shader_node("ShaderNodeBsdfRefraction", "ShaderNodeBsdfRayPortal")
def passage(walk: Walk, slot: Slot) -> Surface:
    _note(walk, slot, CLEAR)
    return Surface(transparency=np.minimum(walk.color(slot, "Color", (1.0, 1.0, 1.0)), 1.0))


@shader_node(
    "ShaderNodeSubsurfaceScattering",
    "ShaderNodeBsdfTranslucent",
    "ShaderNodeBsdfSheen",
    "ShaderNodeBsdfVelvet",
    "ShaderNodeBsdfHair",
    "ShaderNodeBsdfHairPrincipled",
)
def matte(walk: Walk, slot: Slot) -> Surface:
    _note(walk, slot, "an opaque, matte surface of its colour")
    walk.note_normal(slot)
    return Surface(diffuse=np.minimum(walk.color(slot, "Color", (0.8, 0.8, 0.8)), 1.0))


@shader_node("ShaderNodeBsdfToon")
def toon(walk: Walk, slot: Slot) -> Surface:
    walk.note_normal(slot)
    color = walk.color(slot, "Color")
    if slot.node.component == "GLOSSY":
        _note(walk, slot, "gloss without the hard edge")
        return Surface(lobes=((color, 10.0),))
    _note(walk, slot, "a matte surface without the hard edge")
    return Surface(diffuse=color)


@shader_node("ShaderNodeBsdfMetallic")
def metallic(walk: Walk, slot: Slot) -> Surface:
    _note(walk, slot, "gloss whose colour stays the same towards the edges")
    walk.note(DARKER_EDGES)
    walk.note_normal(slot)
    color = np.minimum(walk.color(slot, "Base Color", (0.8, 0.8, 0.8)), 1.0)
    if slot.node.fresnel_type == "PHYSICAL_CONDUCTOR":
        color = _conductor(walk.values.vector(slot.input("IOR")), walk.values.vector(slot.input("Extinction")))
    return Surface(lobes=((walk.rough_share(slot) * color, walk.exponent(slot)),))


def _conductor(n: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Reflectance at normal incidence of a complex index of refraction n + ik (Fresnel)."""
    return ((n - 1.0) ** 2 + k**2) / np.maximum((n + 1.0) ** 2 + k**2, 1e-12)


@shader_node("ShaderNodeEeveeSpecular")
def specular(walk: Walk, slot: Slot) -> Surface:
    """EEVEE's own node: a diffuse and a specular colour."""
    walk.note_normal(slot)
    if walk.number(slot, "Clear Coat") > 1e-5:
        walk.note("clear coat is not supported and left out")
    opaque = 1.0 - walk.fraction(slot, "Transparency")
    ks = np.minimum(walk.color(slot, "Specular"), 1.0)
    return Surface(
        diffuse=opaque * (1.0 - ks) * np.minimum(walk.color(slot, "Base Color"), 1.0),
        lobes=((opaque * ks, walk.exponent(slot)),),
        emission=walk.color(slot, "Emissive Color"),
        transparency=np.full(3, 1.0 - opaque),
    )


@shader_node("ShaderNodeHoldout")
def holdout(walk: Walk, slot: Slot) -> Surface:
    """Mixed with others: alone it isn't asked for, see `material.is_hole`."""
    _note(walk, slot, "black")
    return NOTHING


@shader_node(
    "ShaderNodeVolumePrincipled",
    "ShaderNodeVolumeScatter",
    "ShaderNodeVolumeAbsorption",
    "ShaderNodeVolumeCoefficients",
)
def volume(walk: Walk, slot: Slot) -> Surface:
    """A volume shader on a surface socket draws nothing in Cycles either."""
    return NOTHING
