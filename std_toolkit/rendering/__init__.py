"""Ground truth from labels: z-depth, instance mask, NOCS, normals and visible fractions."""
