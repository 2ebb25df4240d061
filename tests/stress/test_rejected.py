"""Values that are no numbers are counted wherever they arise, never dropped in silence: broken on purpose, in a process
of its own, as compiled functions cannot be exchanged in one that has used them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

# A tenth of the directions gets a density that is no number: of a grey of 0.5 by the BSDF, of lamps by light sampling;
# in the kernel that goes in stages, and in the one that goes path by path.
BROKEN = """
import json, sys
import numpy as np
import engine.kernels.direct as direct
import engine.kernels.vertex as vertex
from engine.kernels.jit import device
from engine.kernels.light.emitters import LightSample
from engine.kernels.simd import select

NAN = np.float32("nan")
sample, sample_light = vertex.sample, direct.sample_light

@device
def broken_sample(phong, hemisphere, surface, wo, n, ng, u, u1, u2, state):
    wi, value, pdf, lobe, state, draws = sample(phong, hemisphere, surface, wo, n, ng, u, u1, u2, state)
    broken = (surface[0][0] == np.float32(0.5)) & (u1 > np.float32(0.9))
    return wi, value, select(broken, NAN, pdf), lobe, state, draws

@device
def broken_light(f, geometry, lights, environment, tree, p, n, own, u, u1, u2):
    l = sample_light(f, geometry, lights, environment, tree, p, n, own, u, u1, u2)
    pdf = select(u1 > np.float32(0.9), NAN, l.pdf)
    return LightSample(l.wi, l.t, l.radiance, pdf, l.alone, l.shadowed, l.mask)

vertex.sample, direct.sample_light = broken_sample, broken_light

import engine, scenes
from engine import Settings
from engine.scene import PointLight, World

bsdf = scenes.plate()
bsdf.materials = [scenes.Material("grey", kd=(0.5, 0.5, 0.5))]
bsdf.world = World(color=(1.0, 1.0, 1.0))
light = scenes.plate()
light.lights = [PointLight("lamp", scenes.place((0, 0, 2)), intensity=(1.0, 1.0, 1.0))]
report = {}
cases = ("bsdf", bsdf, "COSINE"), ("light", light, "COSINE")
cases += ("bsdf by path", bsdf, "REJECTION"), ("light by path", light, "REJECTION")
for name, scene, hemisphere in cases:
    result = engine.render(scene, Settings(samples=64, threads=1, max_bounces=0, hemisphere_sampling=hemisphere))
    finite = bool(np.isfinite(result.pixels).all())
    report[name] = result.rejected, result.pixels.shape[0] * result.pixels.shape[1] * 64, finite, result.warnings
print(json.dumps(report))
"""


@pytest.fixture(scope="module")
def broken(tmp_path_factory) -> dict:
    root, folder = Path(__file__).resolve().parents[2], tmp_path_factory.mktemp("broken")
    (folder / "broken.py").write_text(BROKEN)
    environment = {
        **os.environ,
        "LOBE_CACHE_DIR": str(folder),  # Numba doesn't see the exchange
        "PYTHONPATH": os.pathsep.join([str(root), str(root / "tests")]),
    }
    command = [sys.executable, str(folder / "broken.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("where", ["bsdf", "light", "bsdf by path", "light by path"])
def test_a_density_that_is_no_number_is_counted(broken, where: str) -> None:
    rejected, samples, finite, warnings = broken[where]
    assert rejected == pytest.approx(0.1 * samples, rel=0.05)
    assert finite
    assert f"{rejected} samples were not finite numbers and count as black" in warnings
