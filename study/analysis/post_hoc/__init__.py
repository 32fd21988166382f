"""What is read beside the table of an analysis: coefficients, pairs of levels, unusual rows."""
