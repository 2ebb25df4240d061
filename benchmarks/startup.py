"""How long Lobe makes one wait: enabling the add-on, the first-ever compilation, the first pixels of a warm render, and
the end after Escape.

    python benchmarks/startup.py --runs 5

Each figure is taken in fresh Python processes. "enable" is what the add-on adds to Blender's own start: the time in
`addon_utils.enable`, with Blender and numpy loaded already. "first pixels" runs from the call of the render operator
in a process that has not rendered before to the first picture that the engine hands over, of a cube and a lamp at
256 x 256, with the kernels in the disk cache. "compilation" is the same render with an empty cache: the engine's own
count, and what the whole render took longer; then of the same scene with depth of field, for which that cache has most
but not all. "cancelled" is from Escape to the end of the operator, in the middle of a render of
sample_blends/instances.blend. Results go to benchmarks/results/startup.csv and .md.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time

import common
import numpy as np

from tools.render import whole_number

RENDER = "--child-render"
ENABLE = "--child-enable"
CANCEL = "--child-cancel"


def child_enable() -> dict:
    """Seconds to import and register the installed extension."""
    from tools import lobe_blender

    os.environ["BLENDER_USER_RESOURCES"] = str(lobe_blender.install())
    import bpy  # noqa: F401 I001
    import addon_utils

    start = time.perf_counter()
    lobe_blender.enable_lobe()
    seconds = time.perf_counter() - start
    assert addon_utils.check(lobe_blender.MODULE)[1]
    loaded = [name for name in ("numba", "llvmlite", "embreex", "scipy") if name in sys.modules]
    return {"enable": seconds, "loaded": loaded}


def child_render() -> dict:
    """Seconds to the first pixels, to the end, and in compilation."""
    sys.modules["scipy"] = None  # type: ignore[assignment]  # Blender has none, and where it is Numba imports it
    common.enable_lobe()
    import bpy
    from bl_ext.user_default.lobe import engine
    from bl_ext.user_default.lobe.addon import session

    bpy.ops.wm.read_homefile(use_factory_startup=True)  # the cube
    scene = bpy.context.scene
    common.br.set_engine(scene, "LOBE")
    common.br.set_resolution(scene, 256, 256)
    scene.lobe.samples = 64
    first: list[float] = []
    messages: list[str] = []
    real_render = engine.render

    def watched(described, settings, *, progress=None, **others):
        def listen(state):
            message = state.message.partition(":")[0]
            if message not in messages:
                messages.append(message)
            if not first and state.pixels() is not None:
                first.append(time.perf_counter() - start)
            if progress is not None:
                progress(state)

        return real_render(described, settings, progress=listen, **others)

    session.lobe.render = watched
    start = time.perf_counter()
    report = common.br.render(scene)
    total = time.perf_counter() - start
    found = {"first": first[0] if first else total, "total": total, "compile": report["seconds"]["compile"],
             "messages": list(messages)}  # fmt: skip
    scene.camera.data.dof.use_dof = True
    return found | {"other": common.br.render(scene)["seconds"]["compile"]}


def child_cancel() -> dict:
    """Seconds from Escape to the end of the render."""
    common.enable_lobe()
    from bl_ext.user_default.lobe.addon import session
    from bl_ext.user_default.lobe.addon.report import last_report

    scene = common.br.open_blend(common.scene_path("instances"))
    common.br.set_engine(scene, "LOBE")
    common.br.set_resolution(scene, 1920, 1080)
    scene.lobe.samples = 1 << 16
    escape = time.perf_counter() + 3.0
    session.Session.cancelled = lambda self: time.perf_counter() > escape
    common.br.render(scene)
    assert last_report["stopped"], "it ended by itself"
    return {"cancel": time.perf_counter() - escape}


def run_child(kind: str, **environment: str) -> dict:
    done = subprocess.run([sys.executable, __file__, kind], capture_output=True, text=True,
                          env={**os.environ, **environment})  # fmt: skip
    if done.returncode:
        sys.exit(f"startup.py: a run failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=whole_number(1, 100), default=5)
    parser.add_argument("--cold-runs", type=whole_number(0, 100), default=1, help="renders with an empty cache")
    common.add_results(parser)
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()

    enable = [run_child(ENABLE) for _ in range(options.runs)]
    warm = [run_child(RENDER) for _ in range(options.runs + 1)][1:]
    cancel = [run_child(CANCEL) for _ in range(options.runs)]
    rows = [
        line("add-on enabled", [r["enable"] for r in enable], "0.3"),
        line("first pixels, warm", [r["first"] for r in warm], "0.5"),
        line("kernels loaded, warm", [r["compile"] for r in warm], "0.5"),
    ]
    rows.append(line("cancelled", [r["cancel"] for r in cancel], "0.5"))
    cold = []
    for _ in range(options.cold_runs):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(run_child(RENDER, LOBE_CACHE_DIR=cache))
    if cold:
        rows.append(line("compilation, first ever", [r["compile"] for r in cold], "15"))
        rows.append(line("first pixels, first ever", [r["first"] for r in cold], ""))
        rows.append(line("compilation, another kind of scene", [r["other"] for r in cold], ""))
        print("what the first render said:", " / ".join(cold[0]["messages"]))
    if enable[0]["loaded"]:
        print("loaded by enabling the add-on, though only a render needs them:", ", ".join(enable[0]["loaded"]))
    print(common.update_table("startup", ("what",), rows, folder=options.results))
    return 0


def line(what: str, seconds: list[float], at_most: str) -> dict:
    return {
        "what": what,
        "median, s": f"{np.median(seconds):.3f}",
        "range, s": f"{min(seconds):.3f} to {max(seconds):.3f}",
        "runs": len(seconds),
        "wanted: at most, s": at_most,
    }


if __name__ == "__main__":
    children = {ENABLE: child_enable, RENDER: child_render, CANCEL: child_cancel}
    if sys.argv[1:] and sys.argv[1] in children:
        with common.br.quiet_stdout() as say:
            say(json.dumps(children[sys.argv[1]]()))
        sys.exit(0)
    sys.exit(main())
