"""Forward models that are built in: finite elements, closed forms, half-spaces."""
