"""From a frame to named files in memory, and from there to the dataset's disk."""
