"""PointNet++ (Qi et al., NeurIPS 2017) in plain torch: networks on sets of points.

Everywhere points are (b, n, 3), features (b, c, n) as convolutions want them, and indices (b, ...)
count the points of one set.
"""
