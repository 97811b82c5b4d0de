"""What stands where in pair i, from (config, seed, i) alone; pure numpy."""
