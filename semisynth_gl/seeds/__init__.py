"""Random numbers: a generator for each purpose, splits with their own seeds, and even spreads without chance."""
