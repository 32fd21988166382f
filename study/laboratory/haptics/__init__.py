"""Force laws and force surfaces for real-time use."""
