"""The Qt window: panels and dialogs around the views, all of it calls of the controller."""
