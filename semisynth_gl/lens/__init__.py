"""The lens and sensor of an eye, and the rectification of its images."""
