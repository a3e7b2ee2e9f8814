"""`std-bench audit`: what the labels of a data set are worth."""
