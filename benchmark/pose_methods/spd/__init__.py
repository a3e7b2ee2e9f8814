"""SPD: shape priors deformed to the object that is seen (Tian et al., ECCV 2020)."""
