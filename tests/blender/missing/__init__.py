"""Parts that a render of a scene would lack, reported before the render, and settings of other engines that are taken
over.
"""
