"""Features of Blender's materials, textures and worlds, one small scene each.

Cycles and RayBatch render each scene, and the results are compared.
"""
