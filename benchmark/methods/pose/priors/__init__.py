"""Shape priors: what the mean shape of a category is, as points."""
