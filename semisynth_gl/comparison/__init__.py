"""A dataset's pairs beside the photographs and disparity maps of the place that they are made for."""
