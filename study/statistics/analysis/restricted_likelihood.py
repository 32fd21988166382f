"""Restricted likelihood of a linear mixed model, and Kenward and Roger's inference from it.

y = X beta + sum_i Z_i b_i + e with b_i ~ N(0, v_i I) and e ~ N(0, v_0 I); every Z_i holds the
levels of one random factor. With theta_i = sqrt(v_i / v_0) the likelihood needs the Cholesky
factor of Theta Z'Z Theta + I alone, which falls into one block for each set of rows that share
levels (Bates, Maechler, Bolker and Walker 2015, J. Statist. Softw. 67, 1). Rows that agree in all
levels enter as their mean and their scatter about it; a factor whose levels are these sets of
rows makes V diagonal there and adds no column.

References: Patterson and Thompson (1971), Biometrika 58, 545-554; Kenward and Roger (1997),
Biometrics 53, 983-997, whose numbering of equations is used here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from study.ground.arrays import Array, Flags, Ints
from study.ground.errors import RefusedError
from study.statistics.analysis.sums_of_squares import FRatioTest

#: Ratio of a variance to that of the residual at which derivatives are taken where it is zero:
#: far below every other rounding, and a square root of it is still a number.
_LEAST_RATIO = 1e-12
#: Relative step of the variances at which the search for the largest likelihood ends.
_CONVERGED = 1e-11
#: The same in a profile, where its square counts.
_CONVERGED_IN_PROFILE = 1e-6
_MOST_STEPS = 200
#: Share of a step below which no shorter one is tried.
_LEAST_SHARE = 1e-6
#: Gain in deviance that a step promises below which it is not looked for.
_LEAST_GAIN = 1e-5
#: Rounding of a step over the residual variance, for each unit of the largest ratio to that one.
_EPSILON = 1e-12
#: Levels of random factors that cross each other, directly or through others: a dense matrix of
#: so many takes 0.1 GB and seconds for each step.
MOST_CROSSED = 3000
#: Standard deviations beyond which no end of an interval is looked for: over the estimate, and
#: over that of all rows.
_SMALLEST = 1e-4
_LARGEST = 1e3
#: Part of the total variance below which a residual is rounding, so that no ratio to it exists.
_ROUNDING = 1e-13
#: Numbers that the products of blocks of several contrasts may take at once: 40 MB
_AT_ONCE = 5_000_000
#: Information on a ratio, relative to that of a balanced design, below which rows say nothing.
_UNINFORMED = 1e-9


class SingularError(ValueError):
    """The rows do not determine the variances; ``which`` is the index of a random factor."""

    def __init__(self, which: int) -> None:
        super().__init__("the rows do not determine the variances")
        self.which = which


@dataclass(frozen=True)
class _RowBatch:
    """Sets of rows that share no level, each with the same number of columns.

    Shapes: ``at`` columns of all sets in a row, viewed as (sets, size); ``entry`` their part of
    the flat list of entries of Z'Z.
    """

    at: slice
    entry: slice
    size: int

    def square(self, entries: Array) -> Array:
        """Entries as matrices, shape (sets, size, size)."""
        return np.asarray(entries[self.entry].reshape(-1, self.size, self.size))

    def rows(self, values: Array) -> Array:
        """Rows of the columns, shape (sets, size, ...)."""
        return np.asarray(values[self.at].reshape(-1, self.size, *values.shape[1:]))


@dataclass(frozen=True)
class _Crossed:
    """Columns of the random factors that share levels with no other set of rows, in batches."""

    #: shape (t, k); column of each of t factors in each of k groups of rows.
    columns: Ints
    #: shape (q,); factor of every column.
    factor: Ints
    batches: tuple[_RowBatch, ...]
    #: Entry of Z'Z that each pair of factors has in each group.
    position: Ints
    #: shape (k, q); ones.
    z: scipy.sparse.csr_array

    def gram(self, weight: Array) -> Array:
        """Entries of Z' diag(weight) Z."""
        pairs = len(self.columns) ** 2
        size = self.batches[-1].entry.stop if self.batches else 0
        entries = np.bincount(self.position, np.tile(weight, pairs), minlength=size)
        return np.asarray(entries, dtype=float)


def _crossed(codes: Sequence[Ints], groups: int) -> _Crossed:
    """Order the levels of some factors so that connected ones stand together."""
    if not codes:
        none = np.zeros((0, groups), dtype=np.int64)
        z = scipy.sparse.csr_array((groups, 0), dtype=float)
        return _Crossed(none, none[:, 0], (), none.ravel(), z)
    sizes = [int(code.max()) + 1 for code in codes]
    start = np.cumsum([0, *sizes])
    raw = np.array([code + s for code, s in zip(codes, start, strict=False)])
    q = int(start[-1])
    ones = np.ones(raw.size)
    rows = np.tile(np.arange(groups), len(codes))
    z = scipy.sparse.csr_array((ones, (rows, raw.ravel())), shape=(groups, q))
    label = scipy.sparse.csgraph.connected_components(z.T @ z, directed=False)[1]
    number = np.bincount(label)
    order = np.lexsort((np.arange(q), label, number[label]))
    rank = np.empty(q, dtype=np.int64)
    rank[order] = np.arange(q)
    size = number[label][order]
    # entries of the same label stand together: the first of them
    starts = np.flatnonzero(np.concatenate([[True], np.diff(label[order]) != 0]))
    first = np.repeat(starts, np.diff(np.append(starts, q)))
    batches, entry, offset = [], 0, np.zeros(q, dtype=np.int64)
    for s in np.unique(size):
        here = np.flatnonzero(size == s)
        offset[here] = entry + (np.arange(here.size) // s) * s * s
        batches.append(
            _RowBatch(slice(here[0], here[-1] + 1), slice(entry, entry + here.size * s), int(s))
        )
        entry += here.size * int(s)
    columns = rank[raw]
    inside = columns - first[columns]
    position = [
        offset[columns[i]] + inside[i] * size[columns[i]] + inside[j]
        for i in range(len(codes))
        for j in range(len(codes))
    ]
    factor = np.repeat(np.arange(len(codes)), sizes)[order]
    return _Crossed(columns, factor, tuple(batches), np.concatenate(position), z[:, order])


@dataclass(frozen=True)
class Moments:
    """First and second derivatives of the likelihood at some variances.

    Those after the variances v_i are taken after the ratios v_i / v_0 (the last: v_0 / v_0), so
    that all have one scale. Shapes: f, p, q of r fixed effects and m variances, the residual last.
    """

    deviance: float
    #: shape (r,); generalized least squares.
    beta: Array
    #: shape (r, r); covariance of ``beta`` over v_0.
    f: Array
    #: shape (m,); derivatives of the log likelihood.
    score: Array
    #: shape (m, r, r); X' V^-1 G_i V^-1 X.
    p: Array
    #: shape (m, m, r, r); X' V^-1 G_i V^-1 G_j V^-1 X.
    q: Array
    #: shape (m, m); expected.
    information: Array


@dataclass(frozen=True)
class Likelihood:
    """Restricted likelihood of some rows."""

    #: shape (n, r); orthonormal columns of the fixed effects.
    x: Array
    #: shape (n,); response.
    y: Array
    #: shape (n,); level of each random factor, from 0 without gaps.
    codes: tuple[Ints, ...]

    @cached_property
    def least_squares(self) -> Array:
        """Coefficients of ordinary least squares, shape (r,)."""
        first = self.x.T @ self.y
        return np.asarray(first + self.x.T @ (self.y - self.x @ first))

    @cached_property
    def _groups(self) -> tuple[Ints, Ints]:
        """Group of every row that has the same levels of all random factors; first row of each."""
        combined = np.zeros(self.y.size, dtype=np.int64)
        for code in self.codes:
            combined = combined * (int(code.max()) + 1) + code
            combined = np.unique(combined, return_inverse=True)[1]
        _, first, group = np.unique(combined, return_index=True, return_inverse=True)
        return group, first

    @cached_property
    def _means(self) -> tuple[Array, Array, Array]:
        """Number of rows and mean of [X, residual] of every group, and products within groups."""
        both = np.column_stack([self.x, self.y - self.x @ self.least_squares])
        group, first = self._groups
        number = np.bincount(group).astype(float)
        sums = scipy.sparse.csr_array((np.ones(group.size), (group, np.arange(group.size))))
        mean = (sums @ both) / number[:, None]
        within = both - mean[group]
        return number, mean, within.T @ within

    @cached_property
    def finest(self) -> int | None:
        """Random factor whose levels are the groups of rows: V is diagonal in it."""
        groups = self._groups[1].size
        sizes = [int(code.max()) + 1 for code in self.codes]
        return sizes.index(groups) if groups in sizes else None

    @cached_property
    def _others(self) -> tuple[int, ...]:
        return tuple(i for i in range(len(self.codes)) if i != self.finest)

    @cached_property
    def _z(self) -> _Crossed:
        first = self._groups[1]
        return _crossed([self.codes[i][first] for i in self._others], first.size)

    @property
    def crossed_levels(self) -> int:
        """Largest number of levels that cross each other, directly or through others."""
        return max((batch.size for batch in self._z.batches), default=0)

    @cached_property
    def scale(self) -> float:
        """Standard deviation of all rows about the fixed effects."""
        n, r = self.x.shape
        residual = self.y - self.x @ self.least_squares
        return float(np.sqrt(residual @ residual / max(n - r, 1)))

    def moments(self, v: Array) -> Moments:
        """Likelihood and its derivatives at variances ``v``, that of the residual last."""
        n, r = self.x.shape
        number, mean, t = self._means
        z, v0, m = self._z, float(v[-1]), len(self.codes)
        ratio = np.maximum(v[:-1] / v0, _LEAST_RATIO)
        fine = 0.0 if self.finest is None else float(ratio[self.finest])
        d = 1 + fine * number
        w = number / d
        theta = np.sqrt(ratio[list(self._others)])[z.factor] if z.factor.size else np.zeros(0)
        t = t + mean.T @ (w[:, None] * mean)
        u = theta[:, None] * (z.z.T @ (w[:, None] * mean))
        flat = [z.gram(w)]
        if self.finest is not None:
            flat += [z.gram(w**2), z.gram(w**3)]
        log_det = float(np.log(d).sum())
        trace, traces = np.zeros(m), np.zeros((m, m))
        hs: list[Array] = []
        ks: list[Array] = []
        right = u.copy()
        for batch in z.batches:
            scaled = batch.rows(theta)
            outer = scaled[:, :, None] * scaled[:, None, :]
            s = batch.square(flat[0]) * outer
            full = s + np.eye(batch.size)
            log_det += float(np.linalg.slogdet(full)[1].sum())
            h = np.asarray(np.linalg.inv(full), dtype=float)
            k = np.asarray(h @ s, dtype=float)
            hs.append(h)
            ks.append(k)
            here = h @ batch.rows(right)
            u[batch.at] = here.reshape(-1, r + 1)
            self._add_traces(batch, h, k, [batch.square(f) * outer for f in flat[1:]], fine,
                             trace, traces)  # fmt: skip
        t = t - right.T @ u
        if self.finest is not None:
            i = self.finest
            trace[i] += fine * float(w.sum())
            traces[i, i] += fine**2 * float((w**2).sum())
        f = np.linalg.inv(t[:r, :r])
        shift = f @ t[:r, r]
        rest = max(float(t[r, r] - t[:r, r] @ shift), 0.0)
        deviance = n * math.log(v0) + log_det + float(np.linalg.slogdet(t[:r, :r])[1])
        deviance += -r * math.log(v0) + rest / v0 + (n - r) * math.log(2 * math.pi)
        parts = self._parts(u, mean, theta, w, fine)
        p = np.zeros((m + 1, r, r))
        quadratic = np.zeros(m + 1)
        at_residual = np.append(-shift, 1.0)
        for i, part in enumerate(parts):
            p[i] = part[:, :r].T @ part[:, :r]
            quadratic[i] = float(np.sum((part @ at_residual) ** 2)) / v0
        q = self._q(parts, hs, ks, theta, w, fine)
        # v_0 V^-1 = 1 - sum_i v_i V^-1 G_i gives what the residual has from what the factors have
        p[m] = t[:r, :r] - p[:m].sum(axis=0)
        q[:m, m] = p[:m] - q[:m, :m].sum(axis=1)
        q[m, :m] = q[:m, m].transpose(0, 2, 1)
        q[m, m] = p[m] - q[m, :m].sum(axis=0)
        quadratic[m] = rest / v0 - quadratic[:m].sum()
        trace = np.append(trace, n - trace.sum())
        traces = np.pad(traces, (0, 1))
        traces[:m, m] = traces[m, :m] = trace[:m] - traces[:m, :m].sum(axis=1)
        traces[m, m] = trace[m] - traces[m, :m].sum()
        # equation 4 and its expectation, per ratio
        unit = np.append(ratio, 1.0)
        fp = f @ p
        score = -0.5 * (trace - np.einsum("ijj->i", fp) - quadratic) / unit
        information = traces - 2 * np.einsum("ab,ijba->ij", f, q)
        information += np.einsum("iab,jba->ij", fp, fp)
        information = 0.5 * information / np.outer(unit, unit)
        return Moments(
            deviance,
            self.least_squares + shift,
            f,
            score,
            p / unit[:, None, None],
            q / np.outer(unit, unit)[:, :, None, None],
            0.5 * (information + information.T),
        )

    def _add_traces(
        self, batch: _RowBatch, h: Array, k: Array, fine_grams: Sequence[Array], fine: float,
        trace: Array, traces: Array,
    ) -> None:  # fmt: skip
        """Add the traces of v_i V^-1 G_i and of their products that a batch holds."""
        others = np.array(self._others)
        of = batch.rows(np.eye(len(others))[self._z.factor])
        trace[others] += np.einsum("bii,bit->t", k, of)
        traces[np.ix_(others, others)] += (of.transpose(0, 2, 1) @ k**2 @ of).sum(axis=0)
        if self.finest is not None:
            i = self.finest
            second, third = fine_grams
            he = h @ second
            trace[i] -= fine * float(np.einsum("bii->", he))
            mixed = fine * np.einsum("bi,bit->t", np.einsum("bij,bji->bi", he, h), of)
            traces[i, others] += mixed
            traces[others, i] += mixed
            within = np.einsum("bij,bji->", he, he) - 2 * np.einsum("bij,bji->", h, third)
            traces[i, i] += fine**2 * float(within)

    def _parts(self, u: Array, mean: Array, theta: Array, w: Array, fine: float) -> list[Array]:
        """sqrt(v_i) Z_i' V^-1 [X, residual] of every random factor, times v_0."""
        z = self._z
        parts: list[Array] = [u[:0]] * len(self.codes)
        for t, i in enumerate(self._others):
            parts[i] = u[z.factor == t]
        if self.finest is not None:
            left = mean - z.z @ (theta[:, None] * u)
            parts[self.finest] = math.sqrt(fine) * w[:, None] * left
        return parts

    def _q(
        self, parts: Sequence[Array], hs: Sequence[Array], ks: Sequence[Array], theta: Array,
        w: Array, fine: float,
    ) -> Array:  # fmt: skip
        """v_i v_j X' V^-1 G_i V^-1 G_j V^-1 X, times v_0, of all pairs of random factors."""
        r, m, z = self.x.shape[1], len(self.codes), self._z

        def times(matrices: Sequence[Array], values: Array) -> Array:
            products = [
                (a @ b.rows(values)).reshape(-1, r)
                for a, b in zip(matrices, z.batches, strict=True)
            ]
            return np.concatenate(products) if products else values

        q = np.zeros((m + 1, m + 1, r, r))
        fixed = [part[:, :r] for part in parts]
        for t, j in enumerate(self._others):
            alone = np.zeros((z.factor.size, r))
            alone[z.factor == t] = fixed[j]
            product = times(ks, alone)
            for s, i in enumerate(self._others):
                q[i, j] = fixed[i].T @ product[z.factor == s]
            if self.finest is not None:
                i = self.finest
                spread = z.z @ (theta[:, None] * times(hs, alone))
                q[i, j] = math.sqrt(fine) * fixed[i].T @ (w[:, None] * spread)
                q[j, i] = q[i, j].T
        if self.finest is not None:
            i = self.finest
            weighted = w[:, None] * fixed[i]
            within = theta[:, None] * (z.z.T @ weighted)
            q[i, i] = fine * (weighted.T @ fixed[i] - within.T @ times(hs, within))
        return q

    def fit(
        self, held: tuple[int, float] | None = None, start: Array | None = None
    ) -> tuple[Array, Moments]:
        """Variances of least deviance by Fisher's scoring; one of them may be held."""
        m = len(self.codes) + 1
        v = np.full(m, self.scale**2 / m) if start is None else start.astype(float)
        free = np.ones(m, dtype=bool)
        end = _CONVERGED
        if held is not None:
            v[held[0]], free[held[0]], end = held[1], False, _CONVERGED_IN_PROFILE
        now = self.moments(v)
        for _ in range(_MOST_STEPS):
            step = self._step(v, now, free)
            rounding = _EPSILON * float(v.max()) / float(v[-1])
            # so near the maximum the deviance is rounding, and the score decides
            near = 2 * float(now.score @ step) < (_LEAST_GAIN + 10 * rounding) * v[-1]
            share = 1.0
            while True:
                trial = np.maximum(v + share * step, 0.0)
                if free[-1]:
                    trial[-1] = max(trial[-1], 0.1 * v[-1])
                then = self.moments(trial)
                if near or then.deviance <= now.deviance + 1e-9:
                    break
                share /= 2
                if share < _LEAST_SHARE:
                    raise RefusedError(
                        "no step of the variances of the mixed model lowers its deviance, although "
                        "its slope is not zero: name fewer random factors"
                    )
            if trial[-1] < _ROUNDING * self.scale**2:
                raise SingularError(m - 1)
            # a step that was halved is short wherever it is taken
            moved = np.abs(trial - v) / share
            v, now = trial, then
            if (moved <= max(end, rounding) * np.maximum(v, v[-1])).all():
                return v, now
        raise RefusedError(
            f"the variances of the mixed model have not settled in {_MOST_STEPS} steps"
        )

    @staticmethod
    def _step(v: Array, now: Moments, free: Flags) -> Array:
        """Step of the variances that are free and do not leave zero downward."""
        move = free & ((v > 0) | (now.score > 0))
        step = np.zeros(v.size)
        while move.any():
            part = np.ix_(move, move)
            step[:] = 0.0
            diagonal = np.diag(now.information[part])
            if not (diagonal > 0).all():  # what the rows say of it is rounding
                raise SingularError(int(np.flatnonzero(move)[np.argmin(diagonal)]))
            size = np.sqrt(diagonal)
            scaled = now.information[part] / np.outer(size, size)
            step[move] = np.linalg.lstsq(scaled, now.score[move] / size)[0] / size * v[-1]
            # a variance at zero that the joint step would make negative stays there
            out = move & (v == 0) & (step < 0)
            if not out.any():
                break
            move &= ~out
        return step

    def check(self) -> None:
        """Refuse random factors of which the rows say nothing, at equal variances."""
        m = len(self.codes) + 1
        information = self.moments(np.ones(m)).information
        diagonal = np.diag(information)
        for i in range(m):
            if diagonal[i] <= _UNINFORMED * diagonal.max():
                raise SingularError(i)
        size = np.sqrt(diagonal)
        values, vectors = np.linalg.eigh(information / np.outer(size, size))
        if values[0] <= _UNINFORMED:
            raise SingularError(int(np.argmax(np.abs(vectors[:-1, 0]))))


@dataclass(frozen=True)
class RestrictedFit:
    """A mixed model at its largest restricted likelihood."""

    likelihood: Likelihood
    #: shape (m,); variances of the random factors and, last, of the residual.
    v: Array
    moments: Moments

    @property
    def deviance(self) -> float:
        """-2 log restricted likelihood."""
        return self.moments.deviance

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the fixed effects by the estimated variances, shape (r, r)."""
        return np.asarray(self.moments.f * self.v[-1])

    @cached_property
    def _spread(self) -> Array:
        """Covariance of the variances over v_0^2, shape (m, m)."""
        return np.asarray(np.linalg.inv(self.moments.information))

    @cached_property
    def adjusted(self) -> Array:
        """Covariance that counts the error of the variances too (equation 5), shape (r, r)."""
        m = self.moments
        fp = m.f @ m.p
        inner = np.einsum("ij,ijab->ab", self._spread, m.q)
        inner -= np.einsum("ij,iab,jbc->ac", self._spread, m.p, fp, optimize=True)
        adjusted = m.f + 2 * m.f @ inner @ m.f
        return np.asarray(0.5 * (adjusted + adjusted.T) * self.v[-1])

    def estimate(self, rows: Array) -> tuple[Array, Array, Array]:
        """Estimate ``rows`` @ beta, rows (k, r): values, standard errors and their own df, (k,)."""
        m = self.moments
        lever = rows @ m.f
        plain = np.einsum("ka,ka->k", lever, rows)
        slope = np.einsum("ka,iab,kb->ki", lever, m.p, lever, optimize=True)
        below = np.einsum("ki,ij,kj->k", slope, self._spread, slope)
        df = np.divide(2 * plain**2, below, out=np.full(len(rows), np.nan), where=below > 0)
        square = np.einsum("ka,ab,kb->k", rows, self.adjusted, rows, optimize=True)
        return rows @ m.beta, np.sqrt(np.maximum(square, 0.0)), df

    def test(self, basis: Array) -> FRatioTest:
        """Scaled F test of the directions ``basis``, shape (r, l), against zero."""
        m = self.moments
        count = basis.shape[1]
        theta = basis @ np.linalg.inv(basis.T @ m.f @ basis) @ basis.T
        product = theta @ m.f @ m.p @ m.f
        a1 = float(np.einsum("iaa,ij,jbb->", product, self._spread, product, optimize=True))
        a2 = float(np.einsum("iab,ij,jba->", product, self._spread, product, optimize=True))
        scaling, df = _scaling(a1, a2, count)
        value = basis.T @ m.beta
        wald = float(value @ np.linalg.solve(basis.T @ self.adjusted @ basis, value)) / count
        return FRatioTest.of(scaling * wald, count, df)

    def interval(self, which: int, alpha: float) -> tuple[float, float]:
        """Interval of a standard deviation by the profile of the restricted likelihood."""
        limit = math.sqrt(float(scipy.special.chdtri(1, alpha)))
        best, scale = math.sqrt(self.v[which]), self.likelihood.scale
        latest = [self.v]

        def excess(sd: float) -> float:  # the root of the rise is nearly straight in log sd
            latest[0], at = self.likelihood.fit((which, sd**2), latest[0])
            return math.sqrt(max(at.deviance - self.deviance, 0.0)) - limit

        def crossing(outside: float, step: float, end: float) -> float:
            latest[0], inside = self.v, best
            while excess(outside) <= 0:
                if (outside - end) * (step - 1) >= 0:
                    return 0.0 if step < 1 else math.inf
                inside, outside = outside, step * outside
            return float(
                scipy.optimize.brentq(excess, min(inside, outside), max(inside, outside), rtol=1e-8)
            )

        high = crossing(1.5 * max(best, _SMALLEST * scale), 1.5, _LARGEST * scale)
        latest[0] = self.v
        if best == 0 or (which < self.v.size - 1 and excess(0.0) <= 0):
            return 0.0, high
        return crossing(best / 1.5, 1 / 1.5, _SMALLEST * best), high


def _scaling(a1: float, a2: float, count: int) -> tuple[float, float]:
    """Scaling of F and its denominator degrees of freedom (section 3 of the paper)."""
    if count == 1:  # then F is t squared, and the general formulas are 0 / 0 or this
        return 1.0, 2 / a2
    b = (a1 + 6 * a2) / (2 * count)
    g = ((count + 1) * a1 - (count + 4) * a2) / ((count + 2) * a2)
    below = 3 * count + 2 * (1 - g)
    c1, c2, c3 = g / below, (count - g) / below, (count + 2 - g) / below
    mean = 1 / (1 - a2 / count)
    variance = 2 / count * (1 + c1 * b) / ((1 - c2 * b) ** 2 * (1 - c3 * b))
    rho = variance / (2 * mean**2)
    df = 4 + (count + 2) / (count * rho - 1)
    return df / (mean * (df - 2)), df


def fit_restricted(x: Array, y: Array, codes: Sequence[Ints]) -> RestrictedFit:
    """Fit a mixed model of x (n, r) to y (n,) by restricted maximum likelihood."""
    likelihood = Likelihood(x, y, tuple(codes))
    likelihood.check()
    return RestrictedFit(likelihood, *likelihood.fit())


# -------------------------------------------------------------------------------------------------
# Variances that do not rest on the model's: by the scatter over blocks, or over single rows.


@dataclass(frozen=True)
class Sandwich:
    """Variances of combinations of fixed effects by their scatter over independent blocks."""

    fit: RestrictedFit
    block: Ints

    def errors(self, rows: Array) -> tuple[Array, Array]:
        """Find standard errors of ``rows`` @ beta, shape (m, r), and Satterthwaite's df."""
        parts, df = self.parts(rows)
        return np.sqrt(np.sum(parts**2, axis=0)), df

    def test(self, basis: Array) -> tuple[float, float]:
        """Epsilon and p of orthonormal directions, shape (r, l), by Box's approximation.

        Where blocks are complete these are the epsilon and p of Greenhouse and Geisser.
        """
        parts, df = self.parts(basis.T)
        value = basis.T @ self.fit.moments.beta
        covariance = parts.T @ parts
        trace = float(np.trace(covariance))
        if trace <= 0:
            return 1.0, 1.0
        df1 = trace**2 / float(np.sum(covariance**2))
        df2 = df1 * float(np.diag(covariance) @ df) / trace
        p = scipy.special.fdtrc(df1, df2, float(value @ value) / trace)
        return df1 / basis.shape[1], float(p)

    @cached_property
    def _blocks(self) -> list[tuple[Ints, Array, Array]]:
        """Rows (n_k,) of each block, CR2's weights (n_k, p), and these times the covariance."""
        x, phi, v = self.fit.likelihood.x, self.fit.covariance, self.fit.v
        weighted = []
        for k in range(int(self.block.max()) + 1):
            here = np.flatnonzero(self.block == k)
            cov = v[-1] * np.eye(here.size)
            for variance, code in zip(v, self.fit.likelihood.codes, strict=False):
                cov += variance * (code[here][:, None] == code[here])
            upper = np.linalg.cholesky(cov).T
            left = cov - x[here] @ phi @ x[here].T
            values, vectors = np.linalg.eigh(upper @ left @ upper.T)
            ok = values > 1e-9 * max(values.max(), 0.0)
            inverse = (vectors[:, ok] / np.sqrt(values[ok])) @ vectors[:, ok].T
            weight = upper.T @ (inverse @ (upper @ np.linalg.solve(cov, x[here])))
            weighted.append((here, weight, cov @ weight))
        return weighted

    def parts(self, rows: Array) -> tuple[Array, Array]:
        """Find what each block adds, squared, to the variances; and their degrees of freedom."""
        x, phi, blocks = self.fit.likelihood.x, self.fit.covariance, len(self._blocks)
        residual = self.fit.likelihood.y - x @ self.fit.moments.beta
        root = np.linalg.cholesky(phi)
        lever = phi @ rows.T
        parts = np.zeros((blocks, len(rows)))
        diagonal = np.zeros((blocks, len(rows)))
        inner = np.zeros((blocks, phi.shape[0], len(rows)))
        for k, (here, weight, spread) in enumerate(self._blocks):
            g = weight @ lever
            parts[k] = residual[here] @ g
            diagonal[k] = np.einsum("im,im->m", g, spread @ lever)
            inner[k] = root.T @ (x[here].T @ g)
        df = np.ones(len(rows))
        step = max(1, _AT_ONCE // blocks**2)
        for start in range(0, len(rows), step):
            part = inner[:, :, start : start + step]
            gram = -np.einsum("krm,lrm->mkl", part, part, optimize=True)
            at = np.arange(blocks)
            gram[:, at, at] += diagonal[:, start : start + step].T
            trace = np.einsum("mkk->m", gram)
            below = np.einsum("mkl,mkl->m", gram, gram)
            df[start : start + step] = trace**2 / np.maximum(below, 1e-300)
        return parts, np.maximum(df, 0.1)
