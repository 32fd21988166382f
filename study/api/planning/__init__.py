"""What a study will do and cost, before it runs and while it runs."""
