"""D3RoMa (arXiv 2409.14365), for colour and raw depth. Not run with its weights: they are not here.

cd d3roma && python .../d3roma.py todo/frames.csv FOLDER_OF_WEIGHTS
"""

import sys
from types import SimpleNamespace

import cv2
import numpy as np
from frame_list import fill

sys.path.append(".")  # the checkout
from inference import D3RoMa

SIZE = (360, 640)  # rows, columns: what the weights were trained on
BASELINE_M = 0.055  # of a D415, whose disparities they know

camera = SimpleNamespace(resolution=SIZE, fxb_depth=0.0, change_resolution=lambda _: None)
model = D3RoMa(
    [
        "task=eval_ldm_mixed_rgb+raw",
        f"task.resume_pretrained={sys.argv[2]}",
        f"task.image_size=[{SIZE[0]},{SIZE[1]}]",
        "task.eval_batch_size=1",
        "task.num_inference_rounds=1",
        "task.num_inference_timesteps=10",
    ],
    camera,
    variant="rgb+raw",
)


def answer(color: np.ndarray, raw: np.ndarray, K: np.ndarray) -> np.ndarray:
    camera.fxb_depth = float(K[0, 0]) * SIZE[1] / color.shape[1] * BASELINE_M
    small = cv2.resize(raw, SIZE[::-1], interpolation=cv2.INTER_NEAREST)
    return model.infer_with_rgb_raw(color, small)


fill(sys.argv[1], answer)
