"""Known answers of networks: weights by a rule, inputs by seeds, and the test of them."""
