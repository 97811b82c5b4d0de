"""The scene of pair i, from (config, seed, i) alone; pure numpy."""
