"""Recording a scene with a RealSense camera, or from a file that one recorded."""
