"""Words and tables that compare two studies, for the page and the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

from study.ground.arrays import gathered
from study.reporting.content.blocks import Block, Folded, Points, Sentence, Table
from study.reporting.content.effect_words import (
    MATTERS_AT_SETTINGS,
    change,
    numerical,
    size,
    size_interval,
    sole_setting,
)
from study.reporting.content.report_facts import Facts
from study.reporting.content.text import (
    MISSING,
    clean,
    count,
    level,
    name_of,
    p_value,
    sentence,
    term_name,
)
from study.reporting.results import study_answers
from study.reporting.results.study_answers import Beside, Change, Conclusion
from study.statistics.analysis.anova_table import Effect
from study.statistics.analysis.simple_effects import CANNOT_TELL, MATTERS

Labels = Mapping[str, str] | None

#: letters of a value that a table of changes shows
LONGEST = 70
#: changed inputs that a page shows without being asked
FEW_CHANGES = 8


def beside_blocks(comparison: Beside, labels: Labels = None) -> Iterator[Block]:
    """Say what was changed, what holds, then the numbers of both studies."""
    changed = changes(comparison)
    if changed.rows:
        summary = f"What was changed: {count(len(changed.rows), 'input')}"
        yield Folded(summary, (changed,), is_open=len(changed.rows) <= FEW_CHANGES)
    else:
        yield Sentence("Nothing was changed: design, measurements and code are the same.")
    yield Points([*conclusion_lines(comparison, labels), *map(sentence, comparison.warnings)])
    yield table(comparison, labels)
    groups = gathered((row.response, row) for row in comparison.conclusions).values()
    for rows in groups:
        if line := quiet_line(rows, labels):
            yield Sentence(f"{sentence(name_of(rows[0].response, labels))} {line}", kind="note")


def conclusion_lines(comparison: Beside, labels: Labels = None) -> tuple[str, ...]:
    """Say what holds in both studies, and what only one of them has."""
    return (*summary(comparison, labels), *only_lines(comparison, labels))


def summary(comparison: Beside, labels: Labels = None) -> tuple[str, ...]:
    """Count the conclusions that hold, and say of those that do not what each study says."""
    shown = [row for row in comparison.conclusions if row.is_main or _strong(row)]
    mains = [row for row in shown if row.is_main]
    lines = [_count(mains, comparison)] if mains else []
    lines += [
        sentence(
            f"{term_name(row.term, labels)}, for the {name_of(row.response, labels)}: "
            f"{_how(row, comparison)}"
        )
        for row in shown
        if row.conclusion.startswith((study_answers.DIFFERS, study_answers.ONE_CANNOT_TELL))
    ]
    return tuple(lines)


def _count(rows: Sequence[Conclusion], comparison: Beside) -> str:
    held = sum(row.holds is True for row in rows)
    broken = sum(row.holds is False for row in rows)
    open_ones = len(rows) - held - broken
    first, second = (clean(name) for name in comparison.names)
    total = count(len(rows), "conclusion")
    text = f"of {total} about single factors, {held} hold{'s' * (held == 1)} under both"
    text += f" {first} and {second}"
    parts = [f"{broken} differ{'s' * (broken == 1)}"] if broken else []
    parts += [f"{open_ones} cannot be told in one or both"] if open_ones else []
    return sentence("; ".join([text, *parts]))


def _strong(row: Conclusion) -> bool:
    """Whether an interaction deserves a sentence: it matters in one, or the studies differ."""
    return not row.is_main and any(effect.strength == MATTERS for effect in row.effects)


def _how(row: Conclusion, comparison: Beside) -> str:
    facts = facts_of(row)
    parts = []
    for _, name, effect, best in _sides([row], comparison):
        number = change(effect, facts).removeprefix(MISSING)
        lead = f"{row.end} with {clean(best)}" if row.same_best is False else ""
        why = clean(effect.why) if effect.strength == CANNOT_TELL else ""
        details = ", ".join(part for part in (number, lead, why) if part)
        parts.append(f"{effect.strength} under {clean(name)}{f' ({details})' if details else ''}")
    return ", ".join(parts)


def facts_of(row: Conclusion) -> Facts:
    """Response of a conclusion: its title and unit."""
    return Facts(row.response, clean(row.unit), title=name_of(row.response))


def changes(comparison: Beside) -> Table:
    """Return the inputs that differ, the first thing to read."""
    return Table.of(
        "changes",
        comparison.changes,
        {
            "input": lambda c: clean(c.key, LONGEST),
            clean(comparison.names[0]): lambda c: clean(_value(c, 0), LONGEST),
            clean(comparison.names[1]): lambda c: clean(_value(c, 1), LONGEST),
        },
        left=3,
        raw=lambda c: {"kind": c.kind, "input": c.key, "first": c.values[0], "second": c.values[1]},
    )


def _value(change: Change, study: int) -> str:
    value = change.values[study]
    if value is not None:
        return value
    return "not set" if change.kind in ("design", "truth") else "none"


def only_lines(comparison: Beside, labels: Labels = None) -> tuple[str, ...]:
    """Name what only one study has, so that nothing is dropped in silence."""
    groups = gathered(((item.study, item.what), item) for item in comparison.only)
    return tuple(
        sentence(
            f"only in {clean(study)}: {what}{'s' * (len(items) > 1)} "
            + ", ".join(
                (clean(item.name) if what == "level" else term_name(item.name, labels))
                + (f" ({clean(item.why, 200)})" if item.why else "")
                for item in items
            )
        )
        for (study, what), items in groups.items()
    )


def quiet_line(rows: Iterable[Conclusion], labels: Labels = None) -> str:
    """Name the interactions that the short table leaves out, by what is known of them."""
    quiet = (row for row in rows if not row.is_main and not _strong(row))
    groups = gathered((row.conclusion, term_name(row.term, labels)) for row in quiet)
    named = ((kind.replace(":", ","), names) for kind, names in groups.items())
    return " ".join(sentence(f"{kind}: {', '.join(names)}") for kind, names in named)


Side = tuple[Conclusion, str, Effect, str]


def _sides(rows: Iterable[Conclusion], comparison: Beside) -> Iterator[Side]:
    """Give every conclusion twice: with the name, the effect and the leading level of a study."""
    for row in rows:
        for name, effect, best in zip(comparison.names, row.effects, row.best, strict=True):
            yield row, name, effect, best


def table(comparison: Beside, labels: Labels = None) -> Table:
    """Two rows a term, named in the first, one for each study; grouped by response."""
    groups = gathered((row.response, row) for row in comparison.conclusions).values()
    first, other = map(level, comparison.alphas)
    columns: dict[str, Callable[[Side], str]] = {
        "response": lambda of: name_of(of[0].response, labels),
        "factor": lambda of: term_name(of[0].term, labels),
        "in both": lambda of: of[0].conclusion.partition(":")[0],
        "study": lambda of: clean(of[1]),
        "verdict": lambda of: (
            MATTERS_AT_SETTINGS if sole_setting(of[2]) else of[2].strength or CANNOT_TELL
        ),
        "largest difference": lambda of: size(of[2], facts_of(of[0])),
        f"{first} interval" if first == other else f"interval ({first}; {other})": lambda of: (
            size_interval(of[2], facts_of(of[0]))
        ),
        "U": lambda of: numerical(of[2], facts_of(of[0])),
        "p": lambda of: p_value(of[2].p),
        "leading level": lambda of: (
            f"{clean(of[3])} ({of[0].end})" if of[3] and of[2].strength == MATTERS else MISSING
        ),
    }
    every = list(_sides(chain.from_iterable(groups), comparison))
    # the short table has the factors, and interactions that matter in one of the studies
    main = [of for of in every if of[0].is_main or _strong(of[0])]
    whole = Table.of("beside", main, columns, left=5, tail=1, grouped=True)
    rows = tuple((row[0], "", "", *row[3:]) if k % 2 else row for k, row in enumerate(whole.rows))
    # columns that hold dashes alone are left out: a terminal is narrow
    held = [k for k in range(len(columns)) if any(row[k] != MISSING for row in rows) or not rows]
    return replace(
        whole,
        columns=tuple(whole.columns[k] for k in held),
        rows=tuple(tuple(row[k] for k in held) for row in rows),
        tail=int(len(columns) - 1 in held),
        raw=tuple(map(_raw, every)),
    )


def _raw(of: Side) -> dict[str, object]:
    row, name, effect, best = of
    return {
        "response": row.response, "factor": row.term, "conclusion": row.conclusion, "study": name,
        "verdict": effect.strength, "effect": effect.range, "low": effect.low, "high": effect.high,
        "practical": effect.practical, "u_num": effect.u_num,
        "effect_over_u_num": effect.effect_over_u_num, "p": effect.p, "end": row.end, "best": best,
        "scale": row.scale,
    }  # fmt: skip
