"""The cache: results that are built once and kept on disk for later runs."""
