"""The built-in finite-element model."""
