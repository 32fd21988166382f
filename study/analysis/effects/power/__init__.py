"""What a planned number of blocks or runs can show."""
