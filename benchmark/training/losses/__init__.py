"""Losses as published, and as the authors' programs compute them where that differs."""
