"""Forward models of strangers: a command, a Python function, and what they exchange."""
