"""More, Garbow and Hillstrom (1981) least-squares problems, in the 53 runs of MINPACK's driver.

Numbers in brackets in the names below are the problem numbers of the paper.
"""

import numpy as np

BARD = np.array([
    .14, .18, .22, .25, .29, .32, .35, .39, .37, .58, .73, .96, 1.34, 2.10, 4.39,
])  # fmt: skip
KOWALIK_V = np.array([4, 2, 1, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625])
KOWALIK_Y = np.array([
    .1957, .1947, .1735, .16, .0844, .0627, .0456, .0342, .0323, .0235, .0246,
])  # fmt: skip
MEYER = np.array([
    34780, 28610, 23650, 19630, 16370, 13720, 11540, 9744, 8261, 7030, 6005, 5147, 4427, 3820,
    3307, 2872,
])  # fmt: skip
OSBORNE_1 = np.array([
    .844, .908, .932, .936, .925, .908, .881, .850, .818, .784, .751, .718, .685, .658, .628,
    .603, .580, .558, .538, .522, .506, .490, .478, .467, .457, .448, .438, .431, .424, .420,
    .414, .411, .406,
])  # fmt: skip
OSBORNE_2 = np.array([
    1.366, 1.191, 1.112, 1.013, .991, .885, .831, .847, .786, .725, .746, .679, .608, .655, .616,
    .606, .602, .626, .651, .724, .649, .649, .694, .644, .624, .661, .612, .558, .533, .495,
    .500, .423, .395, .375, .372, .391, .396, .405, .428, .429, .523, .562, .607, .653, .672,
    .708, .633, .668, .645, .632, .591, .559, .597, .625, .739, .710, .729, .720, .636, .581,
    .428, .292, .162, .098, .054,
])  # fmt: skip


def _linear_full_rank(x, m):
    head = x - 2 / m * x.sum() - 1
    return np.concatenate([head, np.full(m - x.size, 1.0) * (-2 / m * x.sum() - 1)])


def _linear_rank_one(x, m):
    return np.arange(1, m + 1) * (np.arange(1, x.size + 1) @ x) - 1


def _linear_rank_one_zeros(x, m):
    inner = np.arange(2, x.size) @ x[1:-1]
    rows = np.arange(0, m) * inner - 1
    rows[0] = rows[-1] = -1
    return rows


def _rosenbrock(x, m):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def _helical(x, m):
    branch = 0.5 if x[0].real < 0 else 0.0
    turn = np.arctan(x[1] / x[0]) / (2 * np.pi) + branch
    radius = np.sqrt(x[0] ** 2 + x[1] ** 2)
    return np.array([10 * (x[2] - 10 * turn), 10 * (radius - 1), x[2]])


def _powell_singular(x, m):
    return np.array([
        x[0] + 10 * x[1], np.sqrt(5) * (x[2] - x[3]), (x[1] - 2 * x[2]) ** 2,
        np.sqrt(10) * (x[0] - x[3]) ** 2,
    ])  # fmt: skip


def _freudenstein_roth(x, m):
    return np.array([
        -13 + x[0] + ((5 - x[1]) * x[1] - 2) * x[1], -29 + x[0] + ((x[1] + 1) * x[1] - 14) * x[1],
    ])  # fmt: skip


def _bard(x, m):
    u = np.arange(1, 16)
    v = 16 - u
    return BARD - (x[0] + u / (v * x[1] + np.minimum(u, v) * x[2]))


def _kowalik_osborne(x, m):
    v = KOWALIK_V
    return KOWALIK_Y - x[0] * (v**2 + v * x[1]) / (v**2 + v * x[2] + x[3])


def _meyer(x, m):
    return x[0] * np.exp(x[1] / (45 + 5 * np.arange(1, 17) + x[2])) - MEYER


def _watson(x, m):
    t = np.arange(1, 30)[:, None] / 29
    j = np.arange(x.size)
    powers = t**j
    slope = (powers[:, :-1] * j[1:]) @ x[1:]
    return np.concatenate([slope - (powers @ x) ** 2 - 1, [x[0], x[1] - x[0] ** 2 - 1]])


def _box(x, m):
    t = np.arange(1, m + 1) / 10
    return np.exp(-t * x[0]) - np.exp(-t * x[1]) - x[2] * (np.exp(-t) - np.exp(-10 * t))


def _jennrich_sampson(x, m):
    i = np.arange(1, m + 1)
    return 2 + 2 * i - np.exp(i * x[0]) - np.exp(i * x[1])


def _brown_dennis(x, m):
    t = np.arange(1, m + 1) / 5
    return (x[0] + t * x[1] - np.exp(t)) ** 2 + (x[2] + x[3] * np.sin(t) - np.cos(t)) ** 2


def _chebyquad(x, m):
    old, new, rows = np.ones_like(x), 2 * x - 1, []
    for i in range(1, m + 1):
        integral = 0.0 if i % 2 else -1 / (i**2 - 1)
        rows.append(new.mean() - integral)
        old, new = new, 2 * (2 * x - 1) * new - old
    return np.array(rows)


def _brown_almost_linear(x, m):
    return np.concatenate([x[:-1] + x.sum() - (x.size + 1), [np.prod(x) - 1]])


def _osborne_1(x, m):
    t = 10 * np.arange(33)
    return OSBORNE_1 - (x[0] + x[1] * np.exp(-t * x[3]) + x[2] * np.exp(-t * x[4]))


def _osborne_2(x, m):
    t = np.arange(65) / 10
    peaks = sum(x[k] * np.exp(-((t - x[k + 7]) ** 2) * x[k + 4]) for k in (1, 2, 3))
    return OSBORNE_2 - (x[0] * np.exp(-t * x[4]) + peaks)


# Kowalik-Osborne's 1.594352e-3 is not in the paper: a minimum on a branch with poles between
# the data, certified by its Hessian (smallest eigenvalue 6.8e-4, gradient 1e-11).
#: name, function, m, start, number of starts (x1, x10, x100), known minima of the sum of squares
PROBLEMS = [
    ("linear, full rank [32]", _linear_full_rank, 10, np.ones(5), 1, (5,)),
    ("linear, full rank [32]", _linear_full_rank, 50, np.ones(5), 1, (45,)),
    ("linear, rank 1 [33]", _linear_rank_one, 10, np.ones(5), 1, (90 / 42,)),
    ("linear, rank 1 [33]", _linear_rank_one, 50, np.ones(5), 1, (2450 / 202,)),
    ("linear, rank 1, zeros [34]", _linear_rank_one_zeros, 10, np.ones(5), 1, (124 / 34,)),
    ("linear, rank 1, zeros [34]", _linear_rank_one_zeros, 50, np.ones(5), 1, (2644 / 194,)),
    ("Rosenbrock [1]", _rosenbrock, 2, [-1.2, 1], 3, (0,)),
    ("helical valley [7]", _helical, 3, [-1, 0, 0], 3, (0,)),
    ("Powell singular [13]", _powell_singular, 4, [3, -1, 0, 1], 3, (0,)),
    ("Freudenstein-Roth [2]", _freudenstein_roth, 2, [0.5, -2], 3, (0, 48.98425)),
    ("Bard [8]", _bard, 15, [1, 1, 1], 3, (8.214877e-3, 17.42869)),
    ("Kowalik-Osborne [15]", _kowalik_osborne, 11, [0.25, 0.39, 0.415, 0.39], 3,
     (3.075056e-4, 1.027346e-3, 1.594352e-3)),
    ("Meyer [10]", _meyer, 16, [0.02, 4000, 250], 2, (87.94586,)),
    ("Watson 6 [20]", _watson, 31, np.zeros(6), 3, (2.287670e-3,)),
    ("Watson 9 [20]", _watson, 31, np.zeros(9), 3, (1.399760e-6,)),
    ("Watson 12 [20]", _watson, 31, np.zeros(12), 3, (4.722381e-10,)),
    ("Box 3D [12]", _box, 10, [0, 10, 20], 1, (0, 0.07558874)),
    ("Jennrich-Sampson [6]", _jennrich_sampson, 10, [0.3, 0.4], 1, (124.3622, 259.5802)),
    ("Brown-Dennis [16]", _brown_dennis, 20, [25, 5, -5, -1], 3, (85822.20,)),
    ("Chebyquad 1 [35]", _chebyquad, 8, [0.5], 3, (3.557894, 3.550391)),
    ("Chebyquad 8 [35]", _chebyquad, 8, np.arange(1, 9) / 9, 1, (3.516874e-3,)),
    ("Chebyquad 9 [35]", _chebyquad, 9, np.arange(1, 10) / 10, 1, (0,)),
    ("Chebyquad 10 [35]", _chebyquad, 10, np.arange(1, 11) / 11, 1, (6.503955e-3, 4.772714e-3)),
    ("Brown almost linear 10 [27]", _brown_almost_linear, 10, np.full(10, 0.5), 3, (0, 1)),
    ("Brown almost linear 30 [27]", _brown_almost_linear, 30, np.full(30, 0.5), 1, (0, 1)),
    ("Brown almost linear 40 [27]", _brown_almost_linear, 40, np.full(40, 0.5), 1, (0, 1)),
    ("Osborne 1 [17]", _osborne_1, 33, [0.5, 1.5, -1, 0.01, 0.02], 1, (5.464895e-5,)),
    ("Osborne 2 [19]", _osborne_2, 65,
     [1.3, 0.65, 0.65, 0.7, 0.6, 3, 5, 7, 2, 4.5, 5.5], 1, (4.013774e-2, 1.789813)),
]  # fmt: skip


def runs():
    """MINPACK's 53 runs: name, function of x, start, known minima."""
    listed = []
    for name, function, m, start, starts, minima in PROBLEMS:
        for factor in (1.0, 10.0, 100.0)[:starts]:
            first = np.asarray(start, float)
            # a start at the origin cannot be stretched: MINPACK puts the factor itself
            first = (
                np.full(first.size, factor) if factor > 1 and not first.any() else first * factor
            )
            listed.append((f"{name} x{factor:g}", _with_jacobian(function, m), first, minima))
    return listed


def _with_jacobian(function, m):
    def both(x):
        residual = function(x, m)
        columns = [function(x + 1e-30j * unit, m).imag / 1e-30 for unit in np.eye(x.size)]
        return residual, np.array(columns).T

    return both


def minimum_reached(sum_of_squares, minima):
    """Whether a sum of squares is one of the known minima, to four digits."""
    return any(
        abs(sum_of_squares - known) <= 1e-4 * known if known else sum_of_squares < 1e-12
        for known in minima
    )
