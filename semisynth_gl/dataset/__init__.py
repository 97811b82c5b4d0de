"""A dataset on disk: its plan, its files, and its readers."""
