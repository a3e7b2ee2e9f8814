"""LIDF: depth as the end of a pixel's ray among the voxels that it crosses.

Zhu et al.: RGB-D local implicit function for depth completion of transparent objects. CVPR 2021.
"""
