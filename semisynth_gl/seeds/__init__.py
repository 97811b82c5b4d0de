"""Random generators, the splits of a dataset, and evenly spaced numbers."""
