"""Photographs into the patch atlas: reading, cropping, judging texture."""
