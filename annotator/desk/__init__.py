"""What stands between a session and a front end: selection, tools, tasks, what is told."""
