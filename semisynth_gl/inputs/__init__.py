"""Inputs from callers, users and the installation: arguments, files and packaged data, and errors about them."""
