"""Experiments as recipes: data, trainings, scores and the table, by one command."""
