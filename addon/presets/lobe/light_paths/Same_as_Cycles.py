import bpy

lobe = bpy.context.scene.lobe

lobe.max_bounces = 12
lobe.diffuse_bounces = 4
lobe.glossy_bounces = 4
lobe.clamp_direct = 0.0
lobe.clamp_indirect = 10.0
