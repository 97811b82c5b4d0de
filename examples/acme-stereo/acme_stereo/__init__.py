"""Plug-ins of the made-up company Acme."""
