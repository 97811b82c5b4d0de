"""Stereo training pairs from photographs, rendered headless with exact disparity."""
