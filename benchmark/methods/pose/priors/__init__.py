"""Shape priors: the mean shape of a category as points."""
