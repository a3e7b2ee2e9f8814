"""Methods that estimate the pose and size of objects of known categories."""
