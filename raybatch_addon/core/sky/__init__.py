"""Skies of a clear day: what is computed once on the host, in NumPy, for the ops that look directions up (`shading/nodes/sky.py`).

`preetham.py` and `hosek_wilkie.py` give coefficients of formulas; `single_scattering.py` and `multiple_scattering.py` integrate an
atmosphere into a picture of the sky, and two colours of the sun's disc. The models and their constants are those of Blender, so that
pictures are the same.
"""
