import bpy

lobe = bpy.context.scene.lobe

lobe.viewport_samples = 64
