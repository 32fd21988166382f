"""Force laws for haptic rendering: a simulated test as a function that a device can call."""
