"""What ``semisynth-gl bench`` measures on the machine it runs on. Nothing here is used to make datasets."""
