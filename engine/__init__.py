"""Lobe's engine: a path tracer for diffuse and Phong surfaces. It knows nothing of Blender.

    from engine import Camera, Mesh, Scene, Settings, render
    result = render(scene, Settings(samples=64))

Importing it is cheap: Numba and Embree are loaded by the first render.
"""

from __future__ import annotations

import json
from collections.abc import Callable

from .elsewhere import compile_elsewhere
from .errors import LobeError, SceneError, SettingsError, told_of_memory
from .interactive import Interactive
from .memory import foresee
from .passes import PASSES
from .prepared import Prepared
from .result import Picture, Progress, Result
from .scene import (
    DEFAULT_MATERIAL,
    Aperture,
    AreaLight,
    Camera,
    Instances,
    Lamp,
    Material,
    Mesh,
    Mist,
    PointLight,
    Scene,
    SpotLight,
    SunLight,
    Visibility,
    World,
)
from .settings import CHOICES, RANGES, Settings

__all__ = [
    "CHOICES",
    "DEFAULT_MATERIAL",
    "PASSES",
    "RANGES",
    "Aperture",
    "AreaLight",
    "Camera",
    "Instances",
    "Interactive",
    "Lamp",
    "LobeError",
    "Material",
    "Mesh",
    "Mist",
    "Picture",
    "PointLight",
    "Prepared",
    "Progress",
    "Result",
    "Scene",
    "SceneError",
    "Settings",
    "SettingsError",
    "SpotLight",
    "SunLight",
    "Visibility",
    "World",
    "compile_elsewhere",
    "foresee",
    "kernel_folder",
    "left_out",
    "precompile",
    "render",
]


def render(
    scene: Scene,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
    stop: Callable[[], bool] | None = None,
    prepared: Prepared | None = None,
) -> Result:
    """Render a scene by the road that the settings name.

    progress  called several times a second, on the caller's thread
    stop      asked at least ten times a second; True ends the render and keeps what was done
    prepared  of the render of the frame before, and then of this one

    Raises SceneError or SettingsError for what cannot be rendered. Without Numba the reference road steps in, and the
    result says so.
    """
    with told_of_memory():
        return _render(scene, settings, progress, stop, prepared)


def _render(scene: Scene, settings: Settings, progress, stop, prepared: Prepared | None) -> Result:
    settings.validate()
    scene.validate()
    problem = None if settings.road == "REFERENCE" else numba_problem()
    if settings.road == "COMPILED" and problem is None:
        from .schedule import render_compiled

        return render_compiled(scene, settings, progress=progress, stop=stop, prepared=prepared)
    from .reference import render_reference

    result = render_reference(scene, settings, progress=progress, stop=stop)
    result.road = "REFERENCE"
    if problem is not None:
        result.warnings.append(f"Numba cannot be used ({problem}): rendered by the slow reference road")
    return result


def left_out(settings: Settings) -> list[str]:
    """What the settings ask for that the road which they name doesn't do, as sentences. Those of a render's result are
    among its warnings."""
    if settings.road == "COMPILED":
        return []
    from . import reference

    return reference.left_out(settings)


def numba_problem() -> str | None:
    """Why Numba can't do its work, None where it can.

    Another extension may have brought versions of it, of llvmlite or of numpy that don't go together, or others than
    the kernels are made for, which shows in errors of many kinds; the reference road needs none of them.
    """
    try:
        import numba

        if getattr(numba.config, "DISABLE_JIT", 0):
            return "NUMBA_DISABLE_JIT is set"
        from . import schedule  # noqa: F401
    except Exception as error:
        return (str(error).splitlines() or [type(error).__name__])[0]
    return None


def precompile(kernel: str, progress: Callable[[int, int], None]) -> None:
    """Fill the cache on disk. Takes long, so call it in a process of its own.

    kernel    which, as `compile_elsewhere` names it; empty: those that scenes most often need, unless they are there
    progress  told, before each of those, how many are done and of how many
    """
    from . import loading

    if kernel:
        loading.precompile_one(json.loads(kernel))
    else:
        loading.precompile_common(progress)


def kernel_folder() -> str:
    """Where these kernels, compiled for this processor, are kept. Loads Numba."""
    from .kernels.jit import CACHE_FOLDER

    return str(CACHE_FOLDER)
