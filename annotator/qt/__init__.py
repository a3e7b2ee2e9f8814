"""Qt front end: window, panels and dialogs that call the controller."""
