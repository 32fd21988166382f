"""Series on refined meshes: observed order, bound of the error, bound of a contrast."""
