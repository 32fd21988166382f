"""Tasks on processes: knows no study, only keys, plain data and what became of them."""
