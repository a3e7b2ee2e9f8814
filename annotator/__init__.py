"""The annotation GUI over a headless session."""
