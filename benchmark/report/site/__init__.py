"""Static leaderboards of the results of many people."""
