"""Principled BSDF on a diffuse and a Phong lobe.

The lobes have no Fresnel term, so every reflectance that depends on the angle is replaced by its mean under diffuse
light. With base colour b, metallic m, transmission t, index of refraction eta and alpha a (Cycles,
kernel/svm/closure.h, for the order of the layers):

    f = s mean_fresnel(eta), s = rough_share
    ks = a (m s mean(F82, b) + (1 - m) f)
    kd = a (1 - m) (1 - t) (1 - f) b
    transparency = (1 - a) + a (1 - m) t (1 - f) sqrt(b)
    emission = a * strength * colour
    exponent = 2 / roughness^4 - 2

kd + ks + transparency <= 1 for every base colour up to 1. One above is kept in kd, where Cycles keeps it too, and
counts as 1 in the rest. Coat, sheen, subsurface, thin film and anisotropy are named when used.
"""

from __future__ import annotations

import numpy as np

from ..notes import PRINCIPLED_GLOSS
from ..units import ior_with_specular_level, mean_fresnel
from .shaders_nearest import CLEAR
from .surface import DARKER_EDGES, Surface, Walk, shader_node
from .tree import Slot

# Input -> what happens to it instead. Named only where it is not zero.
LEFT_OUT = {
    "Subsurface Weight": "subsurface is not supported, drawn as an opaque surface of its colour",
    "Coat Weight": "coat is not supported and left out",
    "Sheen Weight": "sheen is not supported and left out",
    "Anisotropic": "anisotropy is not supported, drawn with round highlights",
    "Thin Film Thickness": "thin film is not supported and left out",
}


def mean_metal(f0: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Hemispherical mean of the F82 tint model: Schlick's is f0 + (1 - f0) / 21, the tint takes its dip off.

    Kutz, Hasan & Edmondson 2021, "Novel aspects of the Adobe Standard Material", section 2: with edge tint 1 it is
    Schlick's; the dip mu (1 - mu)^6 has a mean of 1 / 126, and is scaled to reach the tint at cos(theta) = 1 / 7.
    """
    schlick = f0 + (1.0 - f0) / 21.0
    at_edge = f0 + (1.0 - f0) * (6.0 / 7.0) ** 5
    scale = 7.0 * at_edge * (1.0 - edge) / (6.0 / 7.0) ** 6
    return np.clip(schlick - scale / 126.0, 0.0, 1.0)


@shader_node("ShaderNodeBsdfPrincipled")
def principled(walk: Walk, slot: Slot) -> Surface:
    walk.note_normal(slot)
    for name, sentence in LEFT_OUT.items():
        if walk.number(slot, name) > 1e-5:
            walk.note(sentence)
    if walk.number(slot, "Diffuse Roughness") > 1e-5:
        walk.approximate("diffuse roughness is not supported, drawn without it")
    unlimited = walk.color(slot, "Base Color")
    base = np.minimum(unlimited, 1.0)
    metallic = walk.fraction(slot, "Metallic")
    if metallic > 1e-5:
        walk.note(DARKER_EDGES)
    transmission = walk.fraction(slot, "Transmission Weight")
    alpha = walk.fraction(slot, "Alpha", 1.0)
    tint = walk.color(slot, "Specular Tint", (1.0, 1.0, 1.0))

    ior = max(walk.number(slot, "IOR", 1.45), 1e-5)
    surface_ior = ior_with_specular_level(ior, walk.number(slot, "Specular IOR Level", 0.5))
    coated = mean_fresnel(surface_ior) * tint
    share = walk.rough_share(slot)
    reflect = share * np.minimum((1.0 - transmission) * coated + transmission * mean_fresnel(ior), 1.0)
    ks = metallic * share * mean_metal(base, np.minimum(tint, 1.0)) + (1.0 - metallic) * reflect
    kd = (1.0 - metallic) * (1.0 - transmission) * (1.0 - reflect) * unlimited
    if alpha * (1.0 - metallic) * reflect.max() > 0.0:
        walk.approximate(PRINCIPLED_GLOSS)

    through = np.zeros(3)
    if transmission > 0.0 and metallic < 1.0:
        walk.note(f"transmission is not supported, drawn as {CLEAR}")
        through = (1.0 - metallic) * transmission * (1.0 - reflect) * np.sqrt(base)
    glow = walk.values.color(slot.input("Emission Color"), (1.0, 1.0, 1.0)) * walk.number(slot, "Emission Strength")
    return Surface(
        diffuse=alpha * kd,
        lobes=((alpha * ks, walk.exponent(slot)),),
        emission=alpha * glow,
        transparency=(1.0 - alpha) + alpha * through,
    )
