"""Judges of datasets and predictions: `verify`, `report` and `evaluate`."""
