"""What is tested: specimen, test and discretization."""
