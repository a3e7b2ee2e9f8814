"""FoundationStereo (github.com/NVlabs/FoundationStereo). Not run with its weights: not here.

    cd FoundationStereo && python .../foundation_stereo.py todo/frames.csv WEIGHTS.pth

`cfg.yaml` lies beside the weights. The list must have infrared pairs.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from frame_list import fill_from_pair
from omegaconf import OmegaConf

sys.path.append(".")  # the checkout
from core.foundation_stereo import FoundationStereo
from core.utils.utils import InputPadder

weights = Path(sys.argv[2])
config = OmegaConf.load(weights.with_name("cfg.yaml"))
config.setdefault("vit_size", "vitl")
model = FoundationStereo(config)
model.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True)["model"])
device = "cuda" if torch.cuda.is_available() else "cpu"
model = model.to(device).eval()


@torch.inference_mode()
def answer(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    images = [
        torch.tensor(image.copy(), device=device).float().permute(2, 0, 1)[None]
        for image in (left, right)
    ]
    padder = InputPadder(images[0].shape, divis_by=32, force_square=False)
    with torch.autocast(device):
        found = model.forward(*padder.pad(*images), iters=32, test_mode=True)
    disparity = padder.unpad(found.float()).cpu().numpy().reshape(left.shape[:2])
    # The right image does not show what lies left of its border.
    seen = np.arange(left.shape[1]) - disparity >= 0
    return np.where(seen, disparity, 0)


fill_from_pair(sys.argv[1], answer)
