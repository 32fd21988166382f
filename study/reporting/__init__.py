"""Reports: sentences, tables and figures from records and their analysis; computes nothing else."""
