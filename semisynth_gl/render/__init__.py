"""The only room that uses OpenGL: contexts, the renderer, the list of devices."""
