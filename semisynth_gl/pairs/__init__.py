"""Pairs of a config: renders their scenes, checks them, and adds a rig's imperfections."""
