"""NOCS (Wang et al., CVPR 2019): instances and binned coordinates, on a detector of our own."""
