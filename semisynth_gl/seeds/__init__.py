"""Random numbers: a generator for each purpose, splits with their own seeds, and evenly spread numbers."""
