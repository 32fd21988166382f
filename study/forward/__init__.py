"""Forward simulation: problem in, force-displacement curve with gradients out."""

from study.forward.problem import (
    Block,
    Cone,
    Cylinder,
    Flat,
    Model,
    Problem,
    Sphere,
    Surface,
    Test,
)

__all__ = [
    "Block",
    "Cone",
    "Cylinder",
    "Flat",
    "Model",
    "Problem",
    "Sphere",
    "Surface",
    "Test",
    "estimate",
    "solve",
]


def __getattr__(name: str) -> object:
    """Load the solver on first use: numba and scikit-fem take a second to import."""
    if name == "solve":
        from study.forward.solve import solve

        return solve
    if name == "estimate":
        from study.forward.estimate import estimate

        return estimate
    raise AttributeError(f"module 'study.forward' has no attribute {name!r}")
