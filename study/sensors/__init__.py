"""What the sensors of a test must be: uncertainty of constants and force by their accuracy."""
