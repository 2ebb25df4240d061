"""Value nodes that compute with colours: Mix and its blend modes, Gamma, Hue/Saturation, ramps and their like."""

from __future__ import annotations

import numpy as np

from .nodes_math import safe_divide, stack
from .tree import Slot
from .values import Evaluator, as_color, as_number, value_node


def rgb_to_hsv(rgb: np.ndarray) -> np.ndarray:
    """Smith 1978, "Color gamut transform pairs"; hue in [0, 1)."""
    high, low = rgb.max(axis=-1), rgb.min(axis=-1)
    span = high - low
    safe = np.where(span > 0.0, span, 1.0)
    r, g, b = np.moveaxis((high[..., None] - rgb) / safe[..., None], -1, 0)
    hue = np.select([rgb[..., 0] == high, rgb[..., 1] == high], [b - g, 2.0 + r - b], 4.0 + g - r) / 6.0 % 1.0
    saturation = np.where(high > 0.0, span / np.where(high > 0.0, high, 1.0), 0.0)
    return np.stack([np.where(span > 0.0, hue, 0.0), saturation, high], axis=-1)


def hsv_to_rgb(hsv: np.ndarray) -> np.ndarray:
    hue, saturation, value = np.moveaxis(hsv, -1, 0)
    ramps = [np.abs(hue * 6.0 - 3.0) - 1.0, 2.0 - np.abs(hue * 6.0 - 2.0), 2.0 - np.abs(hue * 6.0 - 4.0)]
    pure = np.clip(np.stack(ramps, axis=-1), 0.0, 1.0)
    return ((pure - 1.0) * saturation[..., None] + 1.0) * value[..., None]


def rgb_to_hsl(rgb: np.ndarray) -> np.ndarray:
    hue, _, high = np.moveaxis(rgb_to_hsv(rgb), -1, 0)
    low = rgb.min(axis=-1)
    lightness = (high + low) / 2.0
    return np.stack([hue, safe_divide(high - low, 1.0 - np.abs(2.0 * lightness - 1.0)), lightness], axis=-1)


def hsl_to_rgb(hsl: np.ndarray) -> np.ndarray:
    hue, saturation, lightness = np.moveaxis(hsl, -1, 0)
    pure = hsv_to_rgb(np.stack([hue, np.ones_like(hue), np.ones_like(hue)], axis=-1))
    chroma = (1.0 - np.abs(2.0 * lightness - 1.0)) * saturation
    return (pure - 0.5) * chroma[..., None] + lightness[..., None]


def _burn(a, b, t):
    divisor = 1.0 - t + t * b
    return np.where(divisor <= 0.0, 0.0, np.clip(1.0 - safe_divide(1.0 - a, divisor), 0.0, 1.0))


def _dodge(a, b, t):
    divisor = 1.0 - t * b
    lightened = np.where(divisor <= 0.0, 1.0, np.minimum(safe_divide(a, divisor), 1.0))
    return np.where(a != 0.0, lightened, a)


def _overlay(a, b, t):
    return np.where(a < 0.5, a * (1.0 - t + 2.0 * t * b), 1.0 - (1.0 - t + 2.0 * t * (1.0 - b)) * (1.0 - a))


def _soft_light(a, b, t):
    screen = 1.0 - (1.0 - b) * (1.0 - a)
    return (1.0 - t) * a + t * ((1.0 - a) * b * a + a * screen)


def _with_parts(a, b, t, parts: str):
    """The hue, saturation or value of `b` on the rest of `a`; a grey `b` has no hue to give."""
    first, second = rgb_to_hsv(a), rgb_to_hsv(b)
    mixed = np.stack([(second if part in parts else first)[..., i] for i, part in enumerate("hsv")], axis=-1)
    usable = np.ones_like(mixed[..., :1], bool)
    if "h" in parts:
        usable = second[..., 1:2] != 0.0
    elif parts == "s":
        usable = first[..., 1:2] != 0.0
    return np.where(usable, (1.0 - t) * a + t * hsv_to_rgb(mixed), a)


# Cycles, kernel/svm/color_util.h; `t` is the factor.
BLEND = {
    "MIX": lambda a, b, t: (1.0 - t) * a + t * b,
    "DARKEN": lambda a, b, t: (1.0 - t) * a + t * np.minimum(a, b),
    "LIGHTEN": lambda a, b, t: (1.0 - t) * a + t * np.maximum(a, b),
    "MULTIPLY": lambda a, b, t: (1.0 - t) * a + t * a * b,
    "ADD": lambda a, b, t: a + t * b,
    "SUBTRACT": lambda a, b, t: a - t * b,
    "DIVIDE": lambda a, b, t: np.where(b == 0.0, a, (1.0 - t) * a + t * safe_divide(a, b)),
    "DIFFERENCE": lambda a, b, t: (1.0 - t) * a + t * np.abs(a - b),
    "EXCLUSION": lambda a, b, t: np.maximum((1.0 - t) * a + t * (a + b - 2.0 * a * b), 0.0),
    "SCREEN": lambda a, b, t: 1.0 - (1.0 - t + t * (1.0 - b)) * (1.0 - a),
    "LINEAR_LIGHT": lambda a, b, t: a + t * (2.0 * b - 1.0),
    "BURN": _burn,
    "DODGE": _dodge,
    "OVERLAY": _overlay,
    "SOFT_LIGHT": _soft_light,
    "HUE": lambda a, b, t: _with_parts(a, b, t, "h"),
    "SATURATION": lambda a, b, t: _with_parts(a, b, t, "s"),
    "VALUE": lambda a, b, t: _with_parts(a, b, t, "v"),
    "COLOR": lambda a, b, t: _with_parts(a, b, t, "hs"),
}


@value_node("ShaderNodeMixRGB")
def mix_rgb(evaluator: Evaluator, slot: Slot) -> np.ndarray | None:
    blend = BLEND.get(slot.node.blend_type)
    if blend is None:
        return None
    factor = np.clip(evaluator.array(slot.input("Fac"), 0.5), 0.0, 1.0)
    first, second = (evaluator.color(slot.input(name)) for name in ("Color1", "Color2"))
    value = blend(*np.broadcast_arrays(first, second), factor)
    return np.clip(value, 0.0, 1.0) if slot.node.use_clamp else value


@value_node("ShaderNodeMix")
def mix(evaluator: Evaluator, slot: Slot) -> np.ndarray | None:
    node = slot.node
    kind = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}.get(node.data_type)
    blend = BLEND.get(node.blend_type) if kind == "Color" else BLEND["MIX"]
    if kind is None or blend is None:
        return None
    uniform = kind != "Vector" or node.factor_mode == "UNIFORM"
    factor = evaluator.value(slot.input("Factor_Float" if uniform else "Factor_Vector"))
    factor = as_number(factor) if uniform else as_color(factor)
    if node.clamp_factor:
        factor = np.clip(factor, 0.0, 1.0)
    shape = as_number if kind == "Float" else as_color
    first, second = (shape(evaluator.value(slot.input(f"{side}_{kind}"))) for side in "AB")
    value = blend(*np.broadcast_arrays(first, second), factor)
    return np.clip(value, 0.0, 1.0) if kind == "Color" and node.clamp_result else value


@value_node("ShaderNodeGamma")
def gamma(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    color, power = evaluator.color(slot.input("Color")), evaluator.array(slot.input("Gamma"), 1.0)
    return np.where(color > 0.0, np.maximum(color, 1e-30) ** power, color)


@value_node("ShaderNodeBrightContrast")
def brightness_contrast(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    bright, contrast = evaluator.array(slot.input("Bright")), evaluator.array(slot.input("Contrast"))
    color = evaluator.color(slot.input("Color"))
    return np.maximum((1.0 + contrast) * color + bright - contrast / 2.0, 0.0)


@value_node("ShaderNodeHueSaturation")
def hue_saturation(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    hue, saturation, value, factor = (
        evaluator.array(slot.input(name), default)
        for name, default in (("Hue", 0.5), ("Saturation", 1.0), ("Value", 1.0), ("Fac", 1.0))
    )
    color = evaluator.color(slot.input("Color"))
    h, s, v = (rgb_to_hsv(color)[..., i : i + 1] for i in range(3))
    changed = hsv_to_rgb(stack((h + hue + 0.5) % 1.0, np.clip(s * saturation, 0.0, 1.0), v * value))
    return np.maximum(factor * changed + (1.0 - factor) * color, 0.0)


@value_node("ShaderNodeInvert")
def invert(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    factor, color = evaluator.array(slot.input("Fac"), 1.0), evaluator.color(slot.input("Color"))
    return factor * (1.0 - color) + (1.0 - factor) * color


MODES = {"RGB": (lambda c: c, lambda c: c), "HSV": (rgb_to_hsv, hsv_to_rgb), "HSL": (rgb_to_hsl, hsl_to_rgb)}


@value_node("ShaderNodeCombineColor")
def combine_color(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    channels = stack(*(evaluator.array(slot.input(name)) for name in ("Red", "Green", "Blue")))
    return MODES[slot.node.mode][1](channels)


@value_node("ShaderNodeSeparateColor")
def separate_color(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    index = ("Red", "Green", "Blue").index(slot.socket.identifier)
    return MODES[slot.node.mode][0](evaluator.color(slot.input("Color")))[..., index : index + 1]


@value_node("ShaderNodeRGBToBW")
def luminance(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    return as_number(evaluator.color(slot.input("Color")))


@value_node("ShaderNodeValToRGB")
def color_ramp(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    """The ramp is read at 256 places, as Cycles does (RAMP_TABLE_SIZE), and interpolated between them."""
    places = np.linspace(0.0, 1.0, 256)
    factor = evaluator.array(slot.input("Fac"), 0.5)
    if factor.size == 1:  # Exact where there is only one to read.
        table = np.array([slot.node.color_ramp.evaluate(min(max(float(factor.flat[0]), 0.0), 1.0))])
        return table[0, 3:] if slot.socket.identifier == "Alpha" else table[0, :3]
    table = np.array([slot.node.color_ramp.evaluate(float(place)) for place in places])
    columns = table[:, 3:].T if slot.socket.identifier == "Alpha" else table[:, :3].T
    return np.stack([np.interp(factor[..., 0], places, column) for column in columns], axis=-1)
