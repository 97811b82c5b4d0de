"""Checks of a dataset's files, which report faults as findings. docs/verify.md derives the bounds."""
