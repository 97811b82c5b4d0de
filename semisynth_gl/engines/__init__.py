"""Engines: they run one function over numbered tasks, here, in worker processes or on a cluster, whatever it does."""
