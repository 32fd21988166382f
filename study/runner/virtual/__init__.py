"""Virtual specimens: measurements with a known truth."""
