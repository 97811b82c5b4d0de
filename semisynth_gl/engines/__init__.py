"""Engines, which run any function over numbered tasks: in this process, in worker processes or on a cluster."""
