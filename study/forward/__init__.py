"""Forward models: a setup and a material in, a force-displacement curve out."""
