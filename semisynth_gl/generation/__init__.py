"""Shards as an engine's tasks."""
