"""The built-in library of parametric objects."""
