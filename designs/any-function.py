"""A Python function of your own as the simulation of a study: a damped spring in closed form.

    python designs/any-function.py

The function gets a case, whose ``parameters`` are numbers in the units of the study, and returns
named numbers, each a response. Give another ``version`` when it changes: it is part of every key.
"""

import math

import study

DESIGN = {
    "study": {
        "name": "any-function",
        "question": "What decides how far a damped spring overshoots?",
    },
    "parameters": {"mass": "2 kg", "stiffness": "800 N/m", "damping": "12 N s/m", "force": "50 N"},
    "factors": {
        "parameters.stiffness": ["800 N/m", "1.2 kN/m"],
        "parameters.damping": ["6 N s/m", "12 N s/m", "20 N s/m"],
    },
    "response": [{"name": "overshoot", "unit": "mm", "practical": "1 mm"}],
}


def spring(case):
    """Largest place of the spring after the force has begun, mm."""
    p = case.parameters
    ratio = p.damping / (2 * math.sqrt(p.stiffness * p.mass))
    rest = 1000 * p.force / p.stiffness
    return {"overshoot": rest * (1 + math.exp(-math.pi * ratio / math.sqrt(1 - ratio**2)))}


if __name__ == "__main__":
    found = study.run(DESIGN, forward=spring, version="1")
    print(found.to_frame())
    print(found.report)
