"""Methods that find the pose and size of objects of known categories."""
