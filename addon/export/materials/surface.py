"""What a shader socket comes to: lobes, emission and transparency that add and scale like light does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..notes import APPROXIMATED
from ..units import LUMINANCE, exponent_to_roughness, rough_share, roughness_to_exponent
from .memo import Memo
from .tree import Slot, source
from .values import Evaluator, node_label

BLACK = np.zeros(3)

# Of what is all gloss: a Phong lobe's albedo falls with the cosine.
DARKER_EDGES = (
    "metal and gloss get darker where they turn away from the camera, to half at 60 degrees: in Cycles they stay bright"
)


@dataclass(frozen=True)
class Surface:
    """A sum of lobes. Colours are (3,) arrays; in a world, `emission` may be an image (H, W, 3).

    lobes  pairs of a reflectance and a Phong exponent, one for each exponent
    """

    diffuse: np.ndarray = field(default_factory=BLACK.copy)
    lobes: tuple[tuple[np.ndarray, float], ...] = ()
    emission: np.ndarray = field(default_factory=BLACK.copy)
    transparency: np.ndarray = field(default_factory=BLACK.copy)

    def __add__(self, other: Surface) -> Surface:
        lobes = {exponent: ks for ks, exponent in self.lobes}
        for ks, exponent in other.lobes:  # Not two of a kind: shaders that are mixed with themselves would double them.
            lobes[exponent] = lobes[exponent] + ks if exponent in lobes else ks
        return Surface(
            self.diffuse + other.diffuse,
            tuple((ks, exponent) for exponent, ks in lobes.items()),
            self.emission + other.emission,
            self.transparency + other.transparency,
        )

    def scaled(self, factor) -> Surface:
        lobes = tuple((ks * factor, exponent) for ks, exponent in self.lobes)
        return Surface(self.diffuse * factor, lobes, self.emission * factor, self.transparency * factor)


NOTHING = Surface()

# Filled by the files that define converters: bl_idname -> function(Walk, Slot) -> Surface.
SHADER_NODES: dict[str, Callable] = {}


def shader_node(*names: str):
    """Register a converter for shader nodes of these `bl_idname`s."""

    def register(function):
        for name in names:
            SHADER_NODES[name] = function
        return function

    return register


class Walk:
    """Turns the shader sockets of one tree into surfaces; `values` evaluates the other sockets."""

    def __init__(self, values: Evaluator) -> None:
        self.values = values
        self._known = Memo(NOTHING, values.check)

    def note(self, sentence: str) -> None:
        self.values.note(sentence)

    def approximate(self, sentence: str) -> None:
        """Of what is drawn nearly as asked."""
        self.values.note(sentence, APPROXIMATED)

    def surface(self, slot: Slot | None) -> Surface:
        """Of a shader input; black where nothing is linked. What is no shader there shines, as in Cycles."""
        if slot is None:
            return NOTHING
        origin = source(slot)
        if origin.socket.type != "SHADER":
            return Surface(emission=self.values.color(slot))
        if not origin.socket.is_output:
            return NOTHING
        return self._known.get(origin.key, lambda: self._convert(origin))

    def _convert(self, slot: Slot) -> Surface:
        convert = SHADER_NODES.get(slot.node.bl_idname)
        if convert is None:
            self.note(f"{node_label(slot.node)} is not supported, drawn as default grey")
            return Surface(diffuse=np.full(3, 0.8))
        return convert(self, slot)

    def color(self, slot: Slot, name: str, default=(0.0, 0.0, 0.0)) -> np.ndarray:
        """A colour input of the slot's node, never negative."""
        return np.maximum(self.values.color(slot.input(name), default), 0.0)

    def number(self, slot: Slot, name: str, default: float = 0.0) -> float:
        return self.values.number(slot.input(name), default)

    def fraction(self, slot: Slot, name: str, default: float = 0.0) -> float:
        return min(max(self.number(slot, name, default), 0.0), 1.0)

    def exponent(self, slot: Slot) -> float:
        return roughness_to_exponent(self.fraction(slot, "Roughness", 0.5))

    def rough_share(self, slot: Slot) -> float:
        """What the node's microfacet distribution leaves of its reflectance, see units.py."""
        return rough_share(getattr(slot.node, "distribution", ""), self.fraction(slot, "Roughness", 0.5))

    def note_normal(self, slot: Slot, name: str = "Normal") -> None:
        """Normal maps and bump change nothing here."""
        normal = slot.input(name)
        origin = None if normal is None else source(normal)
        if origin is not None and origin.socket.is_output:
            self.note(f"{node_label(origin.node)} is not supported, the surface keeps its own normals")


def merge_lobes(lobes, note: Callable[..., None]) -> tuple[np.ndarray, float]:
    """One lobe in place of several: their reflectances add, their roughness is averaged by brightness."""
    lobes = [(ks, exponent) for ks, exponent in lobes if ks.max() > 0.0]
    if not lobes:
        return BLACK.copy(), 0.0
    total = np.sum([ks for ks, _ in lobes], axis=0)
    exponents = np.array([exponent for _, exponent in lobes])
    if np.allclose(exponents, exponents[0], rtol=1e-6):
        return total, float(exponents[0])
    weights = np.array([ks @ LUMINANCE for ks, _ in lobes])
    note("several reflections of different roughness are drawn as one", APPROXIMATED)
    roughness = [exponent_to_roughness(exponent) for exponent in exponents]
    return total, roughness_to_exponent(float(np.average(roughness, weights=weights)))
