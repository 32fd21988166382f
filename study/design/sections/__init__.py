"""Tables of a study file, each read and checked by itself."""
