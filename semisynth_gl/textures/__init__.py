"""From photographs and drawn pictures to the patch atlas: reading, drawing, cropping, measuring texture."""
