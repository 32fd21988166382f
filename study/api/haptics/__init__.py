"""The verbs export and require: force laws for devices, and what their sensors must be."""
