"""What the files of a training's folder are called, beside `config.json` and `run.json`."""

BEST = "best.safetensors"  # the weights with the best validation
SCORES = "best.json"  # its step and scores
LAST = "last.safetensors"  # the weights after the last step: written when a training ends
CHECKPOINT = "last.ckpt"  # what a resumed training needs
