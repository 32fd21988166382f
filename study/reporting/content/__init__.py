"""What a report says: verdicts, sentences, checks and tables."""
