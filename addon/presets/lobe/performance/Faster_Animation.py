import bpy

render = bpy.context.scene.render

render.threads_mode = "AUTO"
render.use_persistent_data = True
