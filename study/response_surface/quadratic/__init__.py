"""Second-order response surfaces (Box and Wilson 1951; Myers and Montgomery 2016)."""
