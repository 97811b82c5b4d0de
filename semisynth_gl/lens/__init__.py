"""What a lens and a sensor do to an image before it is rectified."""
