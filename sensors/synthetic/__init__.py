"""A small synthetic recording with known truth: what the tests and the demo run on.

Ray cast with procedural textures, one bounce of reflection and refraction, and a model of an
active stereo sensor's noise, bias and holes. It is quick (a few seconds) rather than physical.
"""

from sensors.synthetic.annotation import annotate_first_frame
from sensors.synthetic.recording import RecordingOptions, Truth, make_recording, read_truth
from sensors.synthetic.score import LabelErrors, label_errors
from sensors.synthetic.truth_scene import scene_from_truth

__all__ = [
    "LabelErrors",
    "RecordingOptions",
    "Truth",
    "annotate_first_frame",
    "label_errors",
    "make_recording",
    "read_truth",
    "scene_from_truth",
]
