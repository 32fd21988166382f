"""From a design to records: build problems, fit constants, execute cases, many at a time."""
