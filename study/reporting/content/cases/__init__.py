"""Words and tables about single cases: those that failed, their fits, their markers."""
