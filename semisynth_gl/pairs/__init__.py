"""Pairs of a config: rendered, checked, and seen through the lenses and imperfections of a rig."""
