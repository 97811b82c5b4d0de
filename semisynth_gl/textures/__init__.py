"""From photographs and painted pictures to the patch atlas: reading, painting, cropping, measuring texture."""
