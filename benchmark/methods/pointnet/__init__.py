"""PointNet++ (Qi et al., NeurIPS 2017) in plain torch: networks on point sets.

Points are (b, n, 3), features (b, c, n) as for convolutions; indices (b, ...) refer to the points
of one set.
"""
