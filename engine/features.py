"""What a scene needs of the kernels. Decided once, in `engine/pack`, and followed everywhere after.

Every field is a plain int: the kernel factory closes over them, so Numba and LLVM fold them away as constants, and
code for what a scene doesn't have is not compiled, its data not stored, its rays not traced.
"""

from __future__ import annotations

from typing import NamedTuple

# Kinds of lamps, as bits in `Features.lamp_kinds` and as values in the lamp table.
POINT, SPHERE, DISK, RECTANGLE, ELLIPSE = 1, 2, 4, 8, 16
SPOT = 32  # a bit on top of POINT, SPHERE or DISK

# How rays find the lamps that they can meet, as bits: a few are listed, and each is asked; many are in Embree's scene.
LISTED_LAMPS, TRACED_LAMPS = 1, 2

# How one of several emitters is chosen.
NO_EMITTER, ONE_EMITTER, EMITTER_TREE = 0, 1, 2

# The world's light.
DARK_WORLD, CONSTANT_WORLD, IMAGE_WORLD = 0, 1, 2


class Features(NamedTuple):
    """Each 0 or 1 unless it says otherwise."""

    phong: int = 0  # some surface has a Phong lobe
    smooth: int = 0  # some mesh has shading normals
    instances: int = 0  # some mesh is an Embree instance
    transparency: int = 0  # some surface lets light through
    mesh_emitters: int = 0  # some surface emits
    rectangle_emitters: int = 0  # some emissive triangles come in pairs that are rectangles
    lamp_kinds: int = 0  # bits, see above
    lamp_shapes: int = 0  # LISTED_LAMPS or TRACED_LAMPS: some lamp has a size that rays can meet
    unshadowed: int = 0  # some lamp casts no shadow
    ray_kinds: int = 0  # diffuse and glossy rays differ in what they see or how far they go
    shared_light: int = 1  # shadow rays and all others see the same objects; where not, see kernels/mis.py
    emitter_choice: int = 0  # NO_EMITTER, ONE_EMITTER, EMITTER_TREE: of lamps and emissive triangles
    suns: int = 0
    sun_disks: int = 0  # some sun has an angle, so that rays can meet it
    world: int = 0  # DARK_WORLD, CONSTANT_WORLD, IMAGE_WORLD
    orthographic: int = 0
    lens: int = 0
    transparent_film: int = 0
    holdout: int = 0  # some surface is a hole in the picture
    hemisphere: int = 0  # 0 cosine, 1 uniform, 2 rejection
    lobe_selection: int = 0  # 0 albedo-weighted, 1 classic
    clamp: int = 0  # some clamp is on
    light_passes: int = 0  # some pass shows a part of the light

    def skipped(self) -> list[str]:
        """What the kernel for this scene leaves out, as the render report lists it."""
        left_out = [text for name, text in _LEFT_OUT.items() if not getattr(self, name)]
        return (
            left_out if self.emitter_choice == EMITTER_TREE else [*left_out, "light tree: there is no choice of lights"]
        )


_LEFT_OUT = {
    "phong": "Phong lobe: no surface has one",
    "smooth": "shading normals: every face is flat",
    "instances": "instance transforms: every mesh is stored where it stands",
    "transparency": "transparent shadows: every surface is opaque",
    "mesh_emitters": "emissive surfaces: none",
    "rectangle_emitters": "emissive rectangles: none",
    "lamp_kinds": "lamps: none",
    "lamp_shapes": "lamps that rays can meet: none has a size",
    "unshadowed": "lamps without shadows: none",
    "ray_kinds": "kinds of rays: diffuse and glossy ones see the same and go as far",
    "suns": "suns: none",
    "sun_disks": "disks of suns: none has an angle",
    "world": "world light: the world is black",
    "lens": "depth of field: the lens is a pinhole",
    "transparent_film": "film alpha: the film is opaque",
    "holdout": "holdouts: no surface is one",
    "clamp": "clamping: off",
    "light_passes": "parts of the light: no pass shows one",
}

# Every feature that a scene can do without, at its most general. Not in here: the choices that change the picture
# (orthographic, transparent_film, holdout), how it is sampled (hemisphere, lobe_selection) or what else is made
# (light_passes), and `shared_light`.
EVERYTHING = {
    "phong": 1,
    "smooth": 1,
    "instances": 1,
    "transparency": 1,
    "mesh_emitters": 1,
    "rectangle_emitters": 1,
    "lamp_kinds": POINT | SPHERE | DISK | RECTANGLE | ELLIPSE | SPOT,
    "lamp_shapes": LISTED_LAMPS | TRACED_LAMPS,
    "unshadowed": 1,
    "ray_kinds": 1,
    "emitter_choice": EMITTER_TREE,
    "suns": 1,
    "sun_disks": 1,
    "world": IMAGE_WORLD,
    "lens": 1,
    "clamp": 1,
}
