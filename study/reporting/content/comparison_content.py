"""Words and tables that compare two studies, for the page and the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from study.reporting.content.content_table import Table, over_numerical, size, size_interval
from study.reporting.content.numbers import MISSING, level, p_value
from study.reporting.content.report_facts import Facts
from study.reporting.content.text import clean, count, listing, name_of, sentence, term_name
from study.reporting.results import study_answers
from study.reporting.results.study_answers import Beside, Change, Conclusion, Found, OnlyInOne
from study.reporting.results.study_result import ResponseAnalysis
from study.statistics.analysis.anova_table import Effect
from study.statistics.analysis.simple_effects import CANNOT_TELL, MATTERS

Labels = Mapping[str, str] | None

#: letters of a value that a table of changes shows
LONGEST = 70


def response_of(row: Conclusion, labels: Labels = None) -> str:
    """Readable name of the response of a conclusion."""
    return name_of(row.response, labels)


def summary(comparison: Beside, labels: Labels = None) -> tuple[str, ...]:
    """Say which conclusions hold: how many, then response by response."""
    mains = [row for row in comparison.conclusions if row.is_main]
    lines = [_count(mains, comparison)] if mains else []
    for rows in _by_response(comparison.conclusions).values():
        lines.append(_of_response(rows, comparison, labels))
    return tuple(text for text in lines if text)


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


def _of_response(rows: Sequence[Conclusion], comparison: Beside, labels: Labels) -> str:
    """One response: what matters in both, what does not, what differs, what is open."""
    mains = [row for row in rows if row.is_main or _strong(row)]
    groups = {
        kind: [row for row in mains if row.conclusion.startswith(kind)]
        for kind in (
            study_answers.MATTERS,
            study_answers.NO_DIFFERENCE,
            study_answers.DIFFERS,
        )
    }
    both = _both(groups[study_answers.MATTERS], groups[study_answers.NO_DIFFERENCE], labels)
    parts = [f"under both: {both}"] if both else []
    for row in groups[study_answers.DIFFERS]:
        parts.append(f"{_term(row, labels)} differs: {_how(row, comparison)}")
    parts += [f"{_term(row, labels)}: {_how(row, comparison)}"
              for row in mains if row.conclusion == study_answers.ONE_CANNOT_TELL]  # fmt: skip
    never = [_term(row, labels) for row in mains if row.conclusion == study_answers.NONE_CAN_TELL]
    if never:
        parts.append(f"neither study can show whether {listing(never, 'or')} matters")
    text = f"for the {response_of(rows[0], labels)}, {'; '.join(parts)}" if parts else ""
    return sentence(f"{text}{_interactions(rows, labels)}") if text else ""


def _interactions(rows: Sequence[Conclusion], labels: Labels) -> str:
    """Say of the interactions that no sentence names how many agree."""
    quiet = [row for row in rows if not row.is_main and not _strong(row)]
    if not quiet:
        return ""
    small = sum(row.conclusion == study_answers.NO_DIFFERENCE for row in quiet)
    if small == len(quiet):
        return (
            f"; no interaction matters in either ({small} compared)"
            if small > 1
            else (f"; the interaction {_term(quiet[0], labels)} does not matter in either")
        )
    if not small:
        single = f"the interaction {_term(quiet[0], labels)}"
        which = single if len(quiet) == 1 else f"any of {count(len(quiet), 'other interaction')}"
        return f"; whether {which} matters cannot be told in one or both"
    return (
        f"; of {count(len(quiet), 'interaction')} that matter in neither, "
        f"{small} make{'s' * (small == 1)} no practical difference in both and the rest cannot be "
        "told in one or both"
    )


def _strong(row: Conclusion) -> bool:
    """Whether an interaction deserves a sentence: it matters in one, or the studies differ."""
    return not row.is_main and any(conclusion.verdict == MATTERS for conclusion in row.found)


def _both(matter: Sequence[Conclusion], small: Sequence[Conclusion], labels: Labels) -> str:
    parts = [f"{_term(row, labels)} matters ({_sizes(row)}{_lead(row)})" for row in matter]
    if small:
        named = listing([f"{_term(row, labels)} ({_sizes(row)})" for row in small])
        no = "does not" if len(small) == 1 else "do not"
        none = f"make{'s' * (len(small) == 1)} no practical difference"
        parts.append(f"{named} {no if matter else none}")
    return ", ".join(parts)


def _term(row: Conclusion, labels: Labels) -> str:
    return term_name(row.term, labels)


def _sizes(row: Conclusion) -> str:
    first, second = (effect_of(row, conclusion) for conclusion in row.found)
    facts = facts_of(row)
    return f"{size(first, facts)} and {size(second, facts)}"


def _lead(row: Conclusion) -> str:
    """Say which level leads in both, or that a tie leaves it open."""
    if not row.is_main or not row.found[0].best:
        return ""
    best = [clean(conclusion.best) for conclusion in row.found]
    if best[0] == best[1]:
        return f", {row.end} with {best[0]} in both"
    return f", {row.end} with {best[0]} and {best[1]}, which lie within what matters"


def _how(row: Conclusion, comparison: Beside) -> str:
    """Verdict and size under each study."""
    facts = facts_of(row)
    parts = []
    for name, side in zip(comparison.names, row.found, strict=True):
        number = size(effect_of(row, side), facts)
        number = "" if number == MISSING else number
        lead = f"{row.end} with {clean(side.best)}" if row.same_best is False else ""
        why = clean(side.why) if side.verdict == CANNOT_TELL else ""
        details = ", ".join(part for part in (number, lead, why) if part)
        parts.append(f"{side.verdict} under {clean(name)}{f' ({details})' if details else ''}")
    return ", ".join(parts)


def effect_of(row: Conclusion, conclusion: Found) -> Effect:
    """Effect of one study, as the words of a report want it."""
    low, high = conclusion.low, conclusion.high
    ends = None if low is None or high is None else (low, high)
    return Effect(
        row.term, (), (), ends, conclusion.effect, conclusion.verdict,
        "ratio" if row.ratio else "difference", practical=conclusion.practical, p=conclusion.p,
        u_num=conclusion.u_num, effect_over_u_num=conclusion.over_u_num, why=conclusion.why,
    )  # fmt: skip


def facts_of(row: Conclusion) -> Facts:
    """Response of a conclusion: its title and unit."""
    unit = clean(row.unit)
    return Facts(ResponseAnalysis(row.response, unit), response_of(row), unit)


def answer_lines(comparison: Beside | None, labels: Labels = None) -> tuple[str, ...]:
    """Lines for the answer box: which conclusions hold beside the other study, which do not."""
    if comparison is None:
        return ()
    mains = [row for row in comparison.conclusions if row.is_main]
    other = clean(comparison.names[1])
    held = _named([row for row in mains if row.holds is True], labels)
    broken = _named([row for row in mains if row.holds is False], labels)
    open_ones = _named([row for row in mains if row.holds is None], labels)
    parts = [f"these conclusions hold beside {other}: {held}"] if held else []
    parts += [f"these do not: {broken}" if held else f"beside {other} these do not hold: {broken}"
              ] if broken else []  # fmt: skip
    parts += [f"whether these hold cannot be told: {open_ones}"] if open_ones else []
    return (" ".join(sentence(part) for part in parts),) if parts else ()


def _named(rows: Iterable[Conclusion], labels: Labels) -> str:
    """Terms with their verdicts, response by response."""
    texts = []
    for group in _by_response(rows).values():
        matter = [_term(r, labels) for r in group if r.conclusion == study_answers.MATTERS]
        small = [_term(r, labels) for r in group if r.conclusion == study_answers.NO_DIFFERENCE]
        rest = [_term(r, labels) for r in group if r.holds is not True]
        parts = [f"{listing(matter)} matter{'s' * (len(matter) == 1)}"] if matter else []
        parts += [f"{listing(small)} make{'s' * (len(small) == 1)} no practical difference"
                  ] if small else []  # fmt: skip
        parts += [listing(rest)] if rest else []
        texts.append(f"for the {response_of(group[0], labels)}, {' and '.join(parts)}")
    return "; ".join(texts)


def _by_response(rows: Iterable[Conclusion]) -> dict[str, list[Conclusion]]:
    by_response: dict[str, list[Conclusion]] = {}
    for row in rows:
        by_response.setdefault(row.response, []).append(row)
    return by_response


def changes(comparison: Beside) -> Table:
    """Return the inputs that differ, the first thing to read."""
    rows = tuple(
        (clean(c.key, LONGEST), *(clean(_absent(c) if v is None else v, LONGEST) for v in c.values))
        for c in comparison.changes
    )
    raw = tuple(
        {"kind": c.kind, "input": c.key, "first": c.values[0], "second": c.values[1]}
        for c in comparison.changes
    )
    return Table("changes", ("input", *map(clean, comparison.names)), rows, 3, raw=raw)


def _absent(change: Change) -> str:
    return "not set" if change.kind in ("design", "truth") else "none"


def only_lines(comparison: Beside, labels: Labels = None) -> tuple[str, ...]:
    """Name what only one study has, so that nothing is dropped in silence."""
    groups: dict[tuple[int, str], list[OnlyInOne]] = {}
    for item in comparison.only:
        groups.setdefault((item.study, item.what), []).append(item)
    return tuple(
        sentence(
            f"only in {clean(comparison.names[study])}: {what}{'s' * (len(items) > 1)} "
            + ", ".join(_only(item, labels) for item in items)
        )
        for (study, what), items in groups.items()
    )


def _only(item: OnlyInOne, labels: Labels) -> str:
    name = clean(item.name) if item.what == "level" else term_name(item.name, labels)
    return f"{name} ({clean(item.why, 200)})" if item.why else name


def shown(rows: Iterable[Conclusion]) -> list[Conclusion]:
    """Rows of the short table: factors, and interactions that matter in one of the studies."""
    return [row for row in rows if row.is_main or _strong(row)]


def quiet_line(rows: Iterable[Conclusion], labels: Labels = None) -> str:
    """Name the interactions that the short table leaves out, by what is known of them."""
    groups: dict[str, list[str]] = {}
    for row in rows:
        if not row.is_main and not _strong(row):
            groups.setdefault(row.conclusion, []).append(_term(row, labels))
    named = ((kind.replace(":", ","), names) for kind, names in groups.items())
    return " ".join(sentence(f"{kind}: {', '.join(names)}") for kind, names in named)


def quiet_lines(comparison: Beside, labels: Labels = None) -> tuple[tuple[str, str], ...]:
    """Response and what is known of the interactions that its table leaves out."""
    groups = _by_response(comparison.conclusions).values()
    lines = [(response_of(rows[0], labels), quiet_line(rows, labels)) for rows in groups]
    return tuple((title, line) for title, line in lines if line)


def short(row: Conclusion) -> str:
    """Conclusion without what the verdicts beside it say."""
    return row.conclusion.partition(":")[0]


def table(comparison: Beside, labels: Labels = None) -> Table:
    """Two rows a term, one for each study; grouped by response."""
    rows, raw = [], []
    for group in _by_response(comparison.conclusions).values():
        for row in shown(group):
            rows += list(_lines(row, comparison, labels))
        raw += [line for row in group for line in _raw(row, comparison)]
    first, other = map(level, comparison.alphas)
    ends = f"{first} interval" if first == other else f"interval ({first}; {other})"
    columns = ("response", "factor", "in both", "study", "verdict", "largest difference",
               ends, "effect / u_num", "p", "leading level")  # fmt: skip
    return Table("beside", columns, tuple(rows), 5, 1, raw=tuple(raw), grouped=True)


def _lines(row: Conclusion, comparison: Beside, labels: Labels) -> Iterator[tuple[str, ...]]:
    facts = facts_of(row)
    for name, side in zip(comparison.names, row.found, strict=True):
        effect = effect_of(row, side)
        yield (
            response_of(row, labels),
            _term(row, labels),
            short(row),
            clean(name),
            side.verdict if side.verdict else CANNOT_TELL,
            size(effect, facts),
            size_interval(effect, facts),
            over_numerical(effect),
            p_value(side.p),
            f"{clean(side.best)} ({row.end})" if side.best and side.verdict == MATTERS else MISSING,
        )


def _raw(row: Conclusion, comparison: Beside) -> Iterator[dict[str, object]]:
    for name, side in zip(comparison.names, row.found, strict=True):
        yield {
            "response": row.response,
            "factor": row.term,
            "conclusion": row.conclusion,
            "study": name,
            "verdict": side.verdict,
            "effect": side.effect,
            "low": side.low,
            "high": side.high,
            "practical": side.practical,
            "u_num": side.u_num,
            "effect_over_u_num": side.over_u_num,
            "p": side.p,
            "end": row.end,
            "best": side.best,
            "scale": "ratio" if row.ratio else "difference",
        }
