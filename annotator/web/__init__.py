"""The annotation session in a browser, for servers without a display."""
