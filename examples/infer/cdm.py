"""Camera Depth Models (`pip install rgbd-depth`). Not run with its weights: they are not here.

    python cdm.py todo/frames.csv WEIGHTS.pth   # the model of your camera, ViT-L

Network and prompt are inverse depth.
"""

import sys

import numpy as np
import torch
from frame_list import fill
from rgbddepth.dpt import RGBDDepth

model = RGBDDepth(encoder="vitl", features=256, out_channels=[256, 512, 1024, 1024])
state = torch.load(sys.argv[2], map_location="cpu", weights_only=True)
state = state.get("model", state.get("state_dict", state))
model.load_state_dict({name.removeprefix("module."): v for name, v in state.items()})
device = "cuda" if torch.cuda.is_available() else "cpu"
model = model.to(device).eval()


def answer(color: np.ndarray, raw: np.ndarray, _: np.ndarray) -> np.ndarray:
    inverse = np.where(raw > 0, 1 / np.maximum(raw, 1e-3), 0).astype(np.float32)
    found = model.infer_image(color, inverse, input_size=518)
    return np.where(found > 1e-4, 1 / np.maximum(found, 1e-4), 0)


fill(sys.argv[1], answer)
