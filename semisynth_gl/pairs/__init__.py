"""From a config to pairs: scenes drawn, checked, and given a rig's imperfections."""
