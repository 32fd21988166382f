"""Results in words, tables, figures and pages; computes nothing."""
