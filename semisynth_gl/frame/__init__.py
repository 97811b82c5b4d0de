"""A rendered pair as arrays, and the cameras that see it."""
