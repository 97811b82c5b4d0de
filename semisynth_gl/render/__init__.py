"""The only room that knows OpenGL: contexts, the renderer, the list of devices."""
