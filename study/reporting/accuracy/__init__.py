"""Pages of accuracy: a tracker against its references, a surface against a scan."""
