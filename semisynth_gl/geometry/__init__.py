"""Models as triangle meshes with UV maps: built here from parameters, or read from the user's files."""
