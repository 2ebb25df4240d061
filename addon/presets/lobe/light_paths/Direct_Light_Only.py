import bpy

lobe = bpy.context.scene.lobe

lobe.max_bounces = 0
lobe.diffuse_bounces = 0
lobe.glossy_bounces = 0
lobe.clamp_direct = 0.0
lobe.clamp_indirect = 0.0
