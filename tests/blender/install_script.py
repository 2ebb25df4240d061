"""What `test_addon_install.py` does in another Python: installs a zip by the operator that dropping it on Blender's
window runs, and renders a file.

    install_script.py PACKAGES ZIP FILE.blend OUT.exr

To be run without site-packages (-S), where what the zip brings would be found too: PACKAGES holds bpy and what that
needs. What was found is printed as JSON, on the last line.
"""

from __future__ import annotations

import importlib
import json
import sys

packages, package, blend, output = sys.argv[1:]
sys.path.append(packages)

import bpy  # noqa: E402

import addon_utils  # noqa: E402  isort: skip  (bpy makes it importable)

addon_utils.enable("bl_pkg", default_set=True)
bpy.ops.extensions.package_install_files(filepath=package, repo="user_default", enable_on_install=True)
bpy.ops.wm.open_mainfile(filepath=blend, load_ui=False)
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 48, 32, 100
scene.lobe.samples = 8
image = scene.render.image_settings
if hasattr(image, "media_type"):  # Blender 5.0 on
    image.media_type = "IMAGE"
image.file_format, image.color_mode, image.color_depth = "OPEN_EXR", "RGBA", "32"
scene.render.filepath = output
bpy.ops.render.render(write_still=True)
print(
    json.dumps(
        {
            "version": bpy.app.version,
            "engine": scene.render.engine,
            "addons": [addon.module for addon in bpy.context.preferences.addons],
            "files": {
                name: importlib.import_module(name).__file__ for name in ("embreex", "llvmlite", "numba", "OpenImageIO")
            },
        }
    )
)
