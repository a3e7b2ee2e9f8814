"""Files: atomic writes, images, EXR, JSON documents."""
