"""What is tested and how: specimen, indenter, test, material and forward model as declared."""
