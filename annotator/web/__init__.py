"""Browser front end of the annotation session, for servers without a display."""
