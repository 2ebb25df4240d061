"""`scene.lobe`: one property for each field of the engine's Settings (except the threads, which are Blender's own, and
the passes, which are a view layer's), and what the add-on does by itself: the viewport's samples, and denoising.

Defaults and ranges are the engine's, so they cannot drift apart; names, units and costs for the user stand here.
"""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty

from ..engine import CHOICES, RANGES, Settings
from .passes import update_sockets

_DEFAULTS = Settings()
VIEWPORT_SAMPLES = 64
_INT_MAX = (1 << 31) - 1
_FLOAT_MAX = 3.4e38  # FloatProperty holds a float32

# Value of an enum -> what the menu shows, and its tooltip.
# "More noise in most scenes": the trial "uniform directions for diffuse" of benchmarks/results/trials.md.
_CHOICES_TEXT = {
    "COSINE": ("Cosine", "Draw diffuse directions in proportion to the cosine. The least noise: leave it here"),
    "UNIFORM": (
        "Uniform",
        "Draw diffuse directions evenly over the hemisphere. More noise in most scenes; for teaching",
    ),
    "REJECTION": (
        "Rejection",
        "Draw points in a cube until one lies in the half ball, 12/pi draws on average, then use its direction. "
        "Same distribution as Uniform, slower; for teaching",
    ),
    "ALBEDO": ("Albedo", "Weigh the lobes by the light that each reflects at this angle. Less noise at grazing angles"),
    "CLASSIC": ("Classic", "Weigh the lobes by kd and ks alone, as in the literature"),
    "BLACKMAN_HARRIS": ("Blackman-Harris", "Smooth edges, as Cycles does by default"),
    "BOX": ("Box", "Every sample counts for its own pixel alone: sharpest, and best for comparisons"),
    "COMPILED": ("Compiled", "Compiled kernels on all threads. Use this"),
    "REFERENCE": (
        "Reference",
        "The same algorithm in plain numpy at double precision: far slower, to check the other one",
    ),
}


def _limits(key: str) -> dict:
    """Default and hard range of a numeric setting, within what Blender's properties can hold."""
    default = getattr(_DEFAULTS, key)
    end = _INT_MAX if isinstance(default, int) else _FLOAT_MAX
    low, high = RANGES[key]
    return {"default": default, "min": max(low, -end - 1), "max": min(high, end)}


def _items(key: str) -> dict:
    return {"items": [(value, *_CHOICES_TEXT[value]) for value in CHOICES[key]], "default": getattr(_DEFAULTS, key)}


class LobeSettings(bpy.types.PropertyGroup):
    samples: IntProperty(
        name="Samples",
        description="Paths traced for each pixel. Time grows in proportion; noise halves with four times as many",
        soft_max=4096,
        **_limits("samples"),
    )
    viewport_samples: IntProperty(
        name="Viewport Samples",
        description="Paths traced for each pixel of a 3D viewport in Rendered mode. Then it rests and takes no time",
        soft_max=4096,
        **{**_limits("samples"), "default": VIEWPORT_SAMPLES},
    )
    seed: IntProperty(
        name="Seed",
        description="Which random numbers are used. The same seed gives the same picture; animate it to vary the "
        "noise. Costs no time",
        **_limits("seed"),
    )
    time_limit: FloatProperty(
        name="Time Limit",
        description="Seconds after which to stop and keep what was rendered. 0 means no limit. The picture keeps the "
        "noise of the samples that it got",
        unit="TIME_ABSOLUTE",
        soft_max=3600,
        step=100,
        **_limits("time_limit"),
    )
    use_adaptive_sampling: BoolProperty(
        name="Use Adaptive Sampling",
        description="Stop pixels whose noise is below the threshold, which saves time where large parts of the picture "
        "are far less noisy than the rest; no pixel stops before 32 samples. It is slightly biased: not for "
        "measurements",
        default=_DEFAULTS.use_adaptive_sampling,
    )
    adaptive_threshold: FloatProperty(
        name="Noise Threshold",
        description="The noise at which a pixel stops, without unit: 0.01 is less than 1 % of white; dark pixels keep "
        "more, for their brightness. Half of it takes four times as long. No pixel stops before 32 samples",
        precision=4,
        step=0.1,
        soft_max=0.1,
        **_limits("adaptive_threshold"),
    )
    # Seconds and memory: benchmarks/results/denoise_large.md.
    use_denoising: BoolProperty(
        name="Denoise",
        description="Smooth the noise that is left in the finished picture with OpenImageDenoise, which Blender "
        "brings. Takes some seconds and a gigabyte of memory for a picture of full HD, and fine detail where the noise "
        "is strong. The view layer's pass Denoising Data saves edges from it",
        default=False,
        update=update_sockets,
    )
    max_bounces: IntProperty(
        name="Total",
        description="Surfaces that light may bounce off between a lamp and what the camera sees. "
        "0 shows direct light alone; each bounce costs up to as much time as the one before",
        soft_max=64,
        **_limits("max_bounces"),
    )
    diffuse_bounces: IntProperty(
        name="Diffuse",
        description="How many of the bounces may be diffuse. Fewer take less time and darken closed rooms",
        soft_max=64,
        **_limits("diffuse_bounces"),
    )
    glossy_bounces: IntProperty(
        name="Glossy",
        description="How many of the bounces may be glossy (Phong). Fewer take less time and darken what mirrors show",
        soft_max=64,
        **_limits("glossy_bounces"),
    )
    clamp_direct: FloatProperty(
        name="Direct Light",
        description="Upper limit of each contribution of direct light to a path in W/(m² sr), as the mean of its "
        "channels. Removes bright specks and darkens the picture: 0 is off, and unbiased. Costs no time",
        soft_max=100,
        **_limits("clamp_direct"),
    )
    clamp_indirect: FloatProperty(
        name="Indirect Light",
        description="Upper limit of each contribution of indirect light to a path in W/(m² sr), as the mean of its "
        "channels. Removes bright specks and darkens the picture: 0 is off, and unbiased. Costs no time. The preset "
        "Without Bright Specks sets it to 10",
        soft_max=100,
        **_limits("clamp_indirect"),
    )
    hemisphere_sampling: EnumProperty(
        name="Hemisphere",
        description="How diffuse directions are drawn. The picture is the same in the end; the noise is not",
        **_items("hemisphere_sampling"),
    )
    lobe_selection: EnumProperty(
        name="Lobe Choice",
        description="How a path chooses between the diffuse and the Phong lobe. "
        "The picture is the same in the end; the noise is not",
        **_items("lobe_selection"),
    )
    pixel_filter: EnumProperty(
        name="Filter",
        description="How samples near a pixel's edge are weighed. Costs no time",
        **_items("pixel_filter"),
    )
    filter_width: FloatProperty(
        name="Width",
        description="Width of the Blackman-Harris filter in pixels. Wider is softer, and has a little less noise. "
        "Costs no time",
        subtype="PIXEL",
        soft_min=1,
        soft_max=3,
        **_limits("filter_width"),
    )
    road: EnumProperty(
        name="Implementation",
        description="Leave it at Compiled. The other one is a second way to calculate the same picture, far slower, "
        "to check the first one with",
        **_items("road"),
    )


def register() -> None:
    bpy.utils.register_class(LobeSettings)
    bpy.types.Scene.lobe = PointerProperty(type=LobeSettings, name="Lobe", description="Settings of the Lobe renderer")


def unregister() -> None:
    del bpy.types.Scene.lobe
    bpy.utils.unregister_class(LobeSettings)
