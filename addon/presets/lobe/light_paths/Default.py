import bpy

lobe = bpy.context.scene.lobe

lobe.max_bounces = 8
lobe.diffuse_bounces = 8
lobe.glossy_bounces = 8
lobe.clamp_direct = 0.0
lobe.clamp_indirect = 0.0
