"""A small synthetic recording with known ground truth, for the tests and the demo.

Ray cast with procedural textures, one bounce of reflection and refraction, and a model of an
active stereo sensor's noise, bias and holes. It is quick (a few seconds) rather than physical.
"""

from sensors.output.recording_writer import Truth, read_truth
from sensors.synthetic.recording import RecordingOptions, make_recording
from sensors.synthetic.truth import (
    LabelErrors,
    annotate_first_frame,
    label_errors,
    scene_from_truth,
)

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
