"""Elements: shape functions, the compiled point laws and their assembly."""
