"""NOCS (Wang et al., CVPR 2019): instances and binned coordinates, with another detector."""
