"""Checks of a finished dataset: from its files' arrays to findings. docs/verify.md says where each bound comes from."""
