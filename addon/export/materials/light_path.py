"""What stands for a Light Path node, whose values depend on the ray: constants, for materials, worlds and lamps each.

They are what Cycles gives for the ray that matters most there. A ray's length has no such value: 0 leaves a surface as
it is near the camera, and a lamp as it lights what is a metre away.
"""

from __future__ import annotations

_LIGHT_PATH = dict.fromkeys(
    [
        "Is Camera Ray", "Is Shadow Ray", "Is Diffuse Ray", "Is Glossy Ray", "Is Singular Ray", "Is Reflection Ray",
        "Is Transmission Ray", "Is Volume Scatter Ray", "Ray Length", "Ray Depth", "Diffuse Depth", "Glossy Depth",
        "Transparent Depth", "Transmission Depth", "Portal Depth",
    ],
    0.0,
)  # fmt: skip


def _nearest(**values: float) -> dict[tuple[str, str], float]:
    """For an Evaluator: the front of a surface, and of Light Path's outputs 0 but for those that are named."""
    outputs = _LIGHT_PATH | {name.replace("_", " "): value for name, value in values.items()}
    stand_ins = {("ShaderNodeLightPath", name): value for name, value in outputs.items()}
    return stand_ins | {("ShaderNodeNewGeometry", "Backfacing"): 0.0}


# The camera looks at a surface.
IN_MATERIALS = _nearest(Is_Camera_Ray=1.0)
# A diffuse surface that the camera sees is lit: by the world, whose rays come after a bounce, ...
IN_WORLDS = _nearest(Is_Diffuse_Ray=1.0, Is_Reflection_Ray=1.0, Ray_Depth=2.0, Diffuse_Depth=1.0)
# ... or by a lamp that is sampled, a ray that is of no kind in Cycles.
IN_LAMPS = _nearest(Ray_Length=1.0, Ray_Depth=1.0)
