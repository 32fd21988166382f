"""Tables of what was found, as rows for the terminal."""
