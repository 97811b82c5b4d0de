"""From a rig's calibration, disparity maps and photographs to a config: readers, measures, and the YAML."""
