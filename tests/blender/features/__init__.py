"""Features of Blender's materials, textures and worlds: one small scene each, rendered by Cycles and by RayBatch and compared."""
