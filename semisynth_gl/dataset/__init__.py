"""A dataset on disk: what it shall be, its files, and how it is read."""
