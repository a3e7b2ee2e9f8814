"""The application without a front end: controller, actions, questions, background work."""
