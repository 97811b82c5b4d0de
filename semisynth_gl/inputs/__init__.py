"""Arguments of Python callers, the user's files, packaged data, and errors about them."""
