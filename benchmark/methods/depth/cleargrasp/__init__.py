"""ClearGrasp: depth of transparent objects from predicted normals, boundaries and masks.

Sajjan et al.: ClearGrasp: 3D shape estimation of transparent objects for manipulation. ICRA 2020.
"""
