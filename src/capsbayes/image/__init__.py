"""From a picture of a capsule to its measurement; OpenCV is used here only."""
