import bpy

lobe = bpy.context.scene.lobe

lobe.use_adaptive_sampling = False
lobe.adaptive_threshold = 0.01
lobe.samples = 128
lobe.time_limit = 0.0
