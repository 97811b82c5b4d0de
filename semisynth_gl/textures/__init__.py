"""Photographs and drawn pictures into the patch atlas: reading, drawing, cropping, judging texture."""
