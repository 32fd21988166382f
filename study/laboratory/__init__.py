"""Trackers, scans, force laws for haptics, and what a force sensor must resolve."""
