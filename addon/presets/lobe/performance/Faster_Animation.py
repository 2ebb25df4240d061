import bpy

render = bpy.context.scene.render

render.use_persistent_data = True
