"""What callers, users and the installation hand in: arguments, files and packaged data, and the errors about them."""
