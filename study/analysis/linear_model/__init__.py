"""The linear model of a table: columns, sums of squares, residuals, influence."""
