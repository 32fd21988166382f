"""A damped spring under a sudden force, by the average acceleration method (Newmark 1959)."""

import json

with open("input.txt") as lines:
    given = {name: float(value) for name, value in (line.split() for line in lines)}
mass, stiffness, damping = given["mass"], given["stiffness"], given["damping"]
force, step = given["force"], given["step_ms"] / 1000

place, speed, acceleration, largest = 0.0, 0.0, force / mass, 0.0
before = (0.0, 0.0)
for _ in range(round(0.6 / step)):
    # unconditionally stable and of second order in the step
    predicted_place = place + step * speed + step**2 / 4 * acceleration
    predicted_speed = speed + step / 2 * acceleration
    acceleration = (force - damping * predicted_speed - stiffness * predicted_place) / (
        mass + step / 2 * damping + step**2 / 4 * stiffness
    )
    place = predicted_place + step**2 / 4 * acceleration
    speed = predicted_speed + step / 2 * acceleration
    if before[1] > 0 >= speed:
        # the turning point lies between two steps: a cubic through places and speeds finds it
        share = before[1] / (before[1] - speed)
        h00, h10 = 1 - 3 * share**2 + 2 * share**3, share - 2 * share**2 + share**3
        h01, h11 = 3 * share**2 - 2 * share**3, share**3 - share**2
        top = h00 * before[0] + h10 * step * before[1] + h01 * place + h11 * step * speed
        largest = max(largest, top)
    before = (place, speed)

with open("out.json", "w") as stream:
    json.dump({"overshoot": {"value": largest, "unit": "m"}}, stream)
print(f"at rest: {1000 * force / stiffness} mm")
