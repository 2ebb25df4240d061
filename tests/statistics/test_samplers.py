"""Every sampler of the registry draws as its density says; and a sampler that doesn't is caught, in each family.

What the registry has is compared with what there is: functions that take random numbers, classes of lamps, fields.
The same with thirty times the draws, and the whole grid of surfaces, is in test_power.py.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pytest

from engine import scene
from engine.kernels import registry
from engine.kernels.registry import NO_DENSITY, SAMPLERS
from tests.statistics import chi2
from tests.statistics.adapters import ADAPTERS, Scaled, broken, cases

KERNELS = Path(__file__).resolve().parents[2] / "engine" / "kernels"
LEAST_VALID = 0.05  # share of draws: where less arrives, a case says little


@pytest.mark.parametrize("name", cases())
def test_draws_follow_the_density(name, tmp_path):
    result = chi2.assert_follows(cases()[name], tmp_path, len(cases()))
    if "behind" not in name:
        assert result.failed[0] < (1 - LEAST_VALID) * result.count, "next to nothing arrives here"


@pytest.mark.parametrize("family", broken())
def test_a_broken_sampler_is_caught(family, tmp_path):
    """By the same figures, with the picture that shows where."""
    with pytest.raises(AssertionError, match="chi-squared p-value") as caught:
        chi2.assert_follows(broken()[family], tmp_path, len(cases()))
    picture = next(tmp_path.glob("*.png"))
    assert str(picture) in str(caught.value)


@pytest.mark.parametrize("factor", [0.999, 1.001])
@pytest.mark.parametrize("name", ["PointLight lamp, near", "smooth world 1.0", "lens of 3 blades, ratio 2"])
def test_a_density_that_does_not_integrate_to_1_is_caught(name, factor, tmp_path):
    """Whether it is too large or too small: the shape is right, so that counts alone would not tell."""
    with pytest.raises(AssertionError, match="together too much by"):
        chi2.assert_follows(Scaled(cases()[name], factor), tmp_path, len(cases()))


# --- is everything in the registry? ----------------------------------------------------------------------------------


def test_every_family_has_an_adapter_and_a_broken_sampler():
    families = {entry.family for entry in SAMPLERS}
    assert families == set(ADAPTERS) == {name.split(",")[0] for name in broken()}


@dataclass
class Function:
    """A compiled function: the names of its arguments, and of all that stands in its body."""

    arguments: set[str]
    names: set[str]

    @property
    def draws(self) -> bool:
        return any(re.fullmatch(r"u\d*|u_\w+|rng|state", name) for name in self.arguments)


def compiled_functions(folder: Path = KERNELS) -> dict[str, Function]:
    """By module and name, as in `light.sun.sample_sun`: all that @device or @kernel stands over."""
    found = {}
    for path in folder.rglob("*.py"):
        module = ".".join(path.relative_to(folder).with_suffix("").parts).removesuffix("__init__").rstrip(".")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and any(
                isinstance(d, ast.Name) and d.id in ("device", "kernel") for d in node.decorator_list
            ):
                names = {inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name)}
                found[f"{module}.{node.name}"] = Function({a.arg for a in node.args.args}, names)
    return found


def name_of(function) -> str:
    return f"{function.__module__.removeprefix('engine.kernels.')}.{function.__name__}"


def unregistered(functions: dict[str, Function]) -> set[str]:
    """Those with random numbers among their arguments, or with a name as if, that no entry draws by and no reason
    names. Functions of a file's own go with those that call them."""
    known = {name_of(f) for entry in SAMPLERS for f in entry.draws} | set(NO_DENSITY)
    while True:
        called = {
            f"{name.rpartition('.')[0]}.{inner}" for name in known if name in functions
            for inner in functions[name].names if inner.startswith("_")
        }  # fmt: skip
        if called <= known:
            break
        known |= called
    like = re.compile(r"(sample|regular|concentric)_")
    return {name for name, f in functions.items() if f.draws or like.match(name.rpartition(".")[2])} - known


def test_every_function_that_draws_is_registered():
    """A new one anywhere in the kernels has to be drawn by some entry, or say why it has no density."""
    functions = compiled_functions()
    assert sum(function.draws for function in functions.values()) > 30
    assert not unregistered(functions), "without an entry in engine/kernels/registry.py"
    assert set(NO_DENSITY) <= set(functions), "reasons for what is gone"


def test_a_function_that_nobody_registered_is_noticed(tmp_path):
    (tmp_path / "lens.py").write_text("@device\ndef through_prism(camera, u1):\n    return u1\n")
    (tmp_path / "warp.py").write_text("@device\ndef spiral(state):\n    return state\n")
    (tmp_path / "bsdf.py").write_text("def plain(u1):\n    return u1\n")
    assert unregistered(compiled_functions(tmp_path)) == {"lens.through_prism", "warp.spiral"}


def test_what_is_registered_is_called():
    """From the doors by which the cases come in: an entry can't name a function that its cases never see."""
    functions = compiled_functions()
    seen, new = set(), {"sample_light", "sample_diffuse", "sample", "generate_ray", "sample_filter"}
    while new:
        seen |= new
        new = {inner for name, f in functions.items() if name.rpartition(".")[2] in new for inner in f.names} - seen
    assert {f.__name__ for entry in SAMPLERS for f in entry.draws} <= seen


def missing_lamps() -> set[str]:
    """Classes of lamps without an example, and fields of theirs that nobody has said anything about."""
    missing = set()
    for kind in registry.lamp_classes():
        examples = [entry.example for entry in SAMPLERS if type(entry.example) is kind]
        for field, tried in registry.lamp_fields(kind):
            given = [getattr(lamp, field.name) for lamp in examples]
            if not tried or not all(value in given for value in tried):
                missing.add(f"{kind.__name__}.{field.name}")
        if not examples:
            missing.add(kind.__name__)
    return missing


def test_every_lamp_and_every_switch_of_it_is_an_example():
    kinds = {kind.__name__ for kind in registry.lamp_classes()}
    assert kinds >= {"PointLight", "SpotLight", "AreaLight", "SunLight"}
    assert not missing_lamps(), "say in engine/kernels/registry.py how it is drawn, and what the field is tried with"


def test_a_lamp_that_nobody_registered_is_noticed(monkeypatch):
    @dataclass(frozen=True, eq=False)
    class TubeLight(scene.AreaLight):
        bent: bool = False
        twist: float = 0.0

    monkeypatch.setattr(registry, "lamp_classes", lambda: iter([scene.SunLight, TubeLight]))
    assert {"TubeLight", "TubeLight.bent", "TubeLight.twist"} <= missing_lamps()
    entries = list(registry._lamp_samplers())
    assert {entry.family for entry in entries} == {"sun"}  # without values for `twist` there is nothing to try
    monkeypatch.setitem(registry.LAMP_FIELDS, "twist", (0.5,))
    tubes = [entry for entry in registry._lamp_samplers() if entry.family == "TubeLight"]
    assert len(tubes) == 8  # ellipse, spread, bent; and its family has no adapter


@pytest.mark.parametrize("kind", registry.OTHER_FIELDS)
def test_fields_that_adapters_vary_are_all_there_are(kind):
    assert {field.name for field in fields(getattr(scene, kind))} == registry.OTHER_FIELDS[kind]


# --- the quadrature --------------------------------------------------------------------------------------------------


def test_the_quadrature_finds_a_disk():
    """The area of a disk that crosses the cells, and the integral of a bell in one of them."""
    edge = np.linspace(-1, 1, 9)
    disk = chi2.integrate(lambda p: (np.hypot(*p.T) < 0.7).astype(float), (edge, edge))
    assert disk.sum() == pytest.approx(np.pi * 0.49, rel=3e-4)
    bell = chi2.integrate(lambda p: np.exp(-np.sum((p - 0.1) ** 2, axis=1) / 2e-4), (edge, edge), 1e-5)
    assert bell.sum() == pytest.approx(2e-4 * np.pi, rel=1e-4)
