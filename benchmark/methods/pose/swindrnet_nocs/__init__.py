"""SwinDRNet with heads for classes and NOCS: category-level poses, as in the DREDS paper."""
