"""Every energy, one class each, and what they share."""
