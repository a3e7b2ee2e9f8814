"""LIDF: where the ray of a pixel ends among the voxels that it passes.

Zhu et al.: RGB-D local implicit function for depth completion of transparent objects. CVPR 2021.
"""
