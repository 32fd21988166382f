"""The page: complete, in order, self-contained, and safe with hostile names."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest

from study import analyze
from study.record.record import Record
from study.reporting.content import analysis_content, methods, sentences, tables
from study.reporting.content.blocks import Figure
from study.reporting.content.report_facts import cells, comparable, facts
from study.reporting.content.sentences import folded
from study.reporting.figures import effect_figures
from study.reporting.figures.axes import data_alone
from study.reporting.output import study_page
from study.reporting.output.page import page_names, policy_hash, printed, table_script
from study.reporting.output.study_page import prepare
from study.reporting.results.study_result import (
    Check,
    RefinedSize,
    ReportData,
    ResponseAnalysis,
)
from study.statistics.analysis.simple_effects import MATTERS
from tests.reporting.example import (
    FACTORS,
    ReadPage,
    build,
    faults_of,
    undrawn,
    with_failures,
    words_of,
)

FIRST = ["answer", "effects", "curves", "card", "recommendation"]
SECTIONS = (
    "answer study checks numerics error r-relative-rms-force-error r-mu0 assumptions curves "
    "constants failures cost methods provenance glossary"
)

CORPUS = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "=cmd|' /C calc'!A0",
    "'); import os",
    "../../x",
    r"$\frac{a}{b}$",
    "\u202egnp.exe",
    "a\x00b",
    "x" * 10_000,
    "{{ 7 * 7 }}",
    "</style><b>",
    "]]>",
    "&lt;b&gt;",
    "javascript:alert(1)",
]


def only_our_script(html):
    """Whether the page has one script, the shipped one, and its policy allows no other."""
    script = table_script()
    policy = f"script-src '{policy_hash(script)}';"
    return re.findall(r"<script.*?</script>", html, re.S | re.I) == [
        f"<script>{script}</script>"
    ] and (policy in html and html.lower().count("<script") == 1)


def is_local(link):
    """Whether a link leads to one of the two pages, or to a file in the folder of their data."""
    return bool(re.fullmatch(r"#[\w-]+|[a-z0-9-]+-data/[a-z0-9.-]+|[a-z0-9-]+\.html", link))


def test_a_second_script_would_be_found(html):
    assert only_our_script(html)
    assert not only_our_script(html.replace("</main>", "<script>alert(1)</script></main>"))
    assert not only_our_script(html.replace("LONG = 12", "LONG = 13"))
    assert not is_local("javascript:alert(1)")


def test_an_unfinished_study_says_so_at_the_top(data, html):
    assert "Unfinished study" not in html
    few = data.table.iloc[: len(data.table) // 2]
    half = replace(data, table=few, analyses=(), curves=())
    page = undrawn(half)
    # 288 cases: 4 x 2 x 2 x 2 cells of 9 phantoms
    assert "144 of 288 cases have ended" in page
    assert page.index("Unfinished study") < page.index('id="answer"')


def test_sections_stand_in_the_order_of_the_design(first, second):
    assert re.findall(r'<section id="([^"]+)"', first) == FIRST
    assert " ".join(re.findall(r'<section id="([^"]+)"', second)) == SECTIONS


@pytest.mark.parametrize("which", [0, 1])
def test_page_is_self_contained_and_small(both, which):
    html = both[which]
    page = ReadPage(html)
    assert faults_of(html) == []
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert (f"#{tables.CELL}1" in page.links) is bool(which)
    assert not page.tags & {"link", "img", "iframe", "object", "embed", "image"}
    assert only_our_script(html)
    assert all(is_local(link) for link in page.links)
    assert not [name for name in page.attributes if name.startswith("on")]
    assert "default-src 'none'" in html
    assert "@import" not in html
    # only namespaces may look like an address
    addresses = set(re.findall(r"https?://[^\s\"'<]+", html))
    assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    assert len(html.encode()) < 3_000_000


def test_faults_of_a_page_are_found(first):
    mended = (
        ("</section>", ""), ('<html lang="en">', "<html>"), ("<h2>", "<h4>"), ("</h2>", "</h4>"),
        ("<header>", '<header><img src="//far.org/a.png">'), ("<p ", '<p id="card" '),
        (' aria-label="Drawing', ' title="Drawing'), ("<h1>", "<h1></h1><h1>"),
    )  # fmt: skip
    for before, after in mended:
        assert faults_of(first.replace(before, after)), before


def test_no_number_is_longer_than_a_reader_can_use(html):
    body = re.sub(
        r"<svg.*?</svg>|<style>.*?</style>|<dl class=\"facts mono\">.*?</dl>", "", html, flags=re.S
    )
    text = " ".join(ReadPage(body).text)
    digits = [re.sub(r"[.]", "", n).lstrip("0") for n in re.findall(r"\d+\.\d+", text)]
    assert max(map(len, digits)) <= 5
    assert not re.search(r"\bnan\b|\binf\b|\bNone\b(?!: all)", text)


def test_same_data_give_the_same_bytes(contents, both):
    assert contents.html() == both


def test_every_figure_is_drawn_and_says_its_finding(contents):
    figures = [b for page in (contents.first, contents.second) for b in page.flat
               if isinstance(b, Figure)]  # fmt: skip
    assert not any(figure.missing for figure in figures)
    assert all(figure.caption and figure.data is not None for figure in figures)
    assert len(figures) == len(contents.figures) == 15


def test_the_first_page_is_short_and_leads_to_the_second(first, second):
    assert len(words_of(first).split()) <= 700
    answer = first.partition('<section id="answer"')[2].partition("</section>")[0]
    said = words_of(f"<p {answer}")
    assert 1 <= len(re.findall(r"[.?!](?=\s|$)", said)) <= 5
    assert first.count("<figure") == 2  # effects, and curves against data
    assert 'href="ecoflex-compression-details.html"' in first
    assert 'href="ecoflex-compression.html"' in second


def test_a_claim_that_hangs_on_one_block_says_so_in_the_answer(data):
    analyzed = facts(data)[0]
    fragile = tuple(
        replace(e, lost_without=("EF10_1",)) if e.verdict == MATTERS else e for e in analyzed.terms
    )
    (line, *_) = sentences.answer(data, [replace(analyzed, terms=fragile)], is_short=True)
    assert "between extremes; not so if phantom EF10_1 is left out" in line


def test_the_answer_has_five_sentences_at_most():
    lines = study_page.in_few(["A. B.", "", "C. D. E. F.", "G.", "H. I."])
    assert lines == ("A.", "B.", "G.", "H. I.")
    assert study_page.in_few(["A. B. C. D. E. F."]) == ("A.", "B. C. D. E.")


def test_the_card_says_what_each_check_means(data):
    checks = analysis_content.all_checks(data, facts(data))
    card = study_page.report_card(checks, replace(data, warnings=("one",), data_notes=()))
    groups = [group[0] for group in analysis_content.by_name(checks)]
    idle = [check for check in groups if check.outcome == "not applicable"]
    assert [(check.name, check.consequence) for check in idle] == [
        ("Equal spread of the cells", "")
    ]
    outcomes = [check.outcome for check in groups if check not in idle]
    assert [outcome for outcome, _, _ in card.lines] == [*outcomes, "note"]
    assert all(meaning.endswith(".") and name for _, name, meaning in card.lines)
    meanings = {name: meaning for _, name, meaning in card.lines}
    passed = meanings["Residuals as from a normal distribution"]
    assert passed == "The p-values may be read as they are."


def test_a_broken_figure_is_named_and_the_others_are_the_same_to_the_byte(
    monkeypatch, data, contents
):
    def broken(*_args):
        raise RuntimeError("the <pen> broke")

    title, points, _, caption = effect_figures.PLOTS["interactions"]
    monkeypatch.setitem(effect_figures.PLOTS, "interactions", (title, points, broken, caption))
    made = prepare(replace(data, analyses=data.analyses[:1], curves=()))
    page = printed(*made.html())
    assert page.count("Figure missing.") == 1
    assert "Interactions: relative RMS force error could not be drawn" in page
    assert "the &lt;pen&gt; broke" in page
    assert 'id="provenance"' in page
    stem = "relative-rms-force-error-"
    first = {n: f.svg for n, f in contents.figures.items() if n.startswith(stem)}
    again = {n: f.svg for n, f in made.figures.items() if n.startswith(stem)}
    assert again == first | {f"{stem}interactions": ""}


def test_assumed_inputs_are_labelled(html):
    assert re.search(r"test\.interface <span class=\"flag\">assumed</span>", html)


def test_an_error_is_that_of_what_was_refined(data):
    page = undrawn(replace(data, refinement=RefinedSize("time step", "time step (ms)")))
    assert "How far the answer still depends on the time step." in page
    assert "Effects resolved by the time step" in page
    assert not re.search("mesh error|[Ff]iner mesh would", page)


def test_the_methods_name_the_error_in_words_and_no_way_to_call_a_program(data):
    named = methods.paragraph(
        replace(data, inputs={"forward.argv": "[['python', 'spring.py']]"}), ()
    )
    assert "argv" not in named
    assert "Fixed inputs" not in named


def test_failures_are_listed_and_a_refused_response_still_makes_a_report(data):
    refused = ResponseAnalysis("mu0", "kPa", refused="copies pose as replicates")
    page = undrawn(replace(with_failures(data), analyses=(refused,), curves=()))
    for words in (
        "3 cases of 288", "Failure map", "the step could not be halved further",
        "Not analyzed. copies pose as replicates", "No response could be analyzed",
    ):  # fmt: skip
        assert words in page


def test_a_design_without_a_response_is_told_so(data):
    page = undrawn(replace(data, analyses=(), curves=(), surfaces=()))
    assert "The design names no [[response]], so nothing was analyzed" in page
    assert "the warnings say why" not in page
    assert "A [[response]] in the design." in page


def test_checks_of_several_responses_stand_together(contents, data):
    rows = contents.tables["checks"].rows
    names = [row[0] for row in rows]
    assert all(names.count(name) == 1 for name in names if name)
    first, second = rows[names.index("Equal spread of the cells") :][:2]
    assert {first[2], second[2]} == {f.title for f in facts(data)}
    assert second[0] == ""


def test_levels_stand_in_the_order_of_the_design(data):
    for found in facts(data):
        for effect in found.effects:
            assert effect.levels == data.factors[effect.term]
            named = dict(zip(effect.levels, effect.mean, strict=True))
            per_level = data.table.groupby(effect.term)[found.name].mean()
            if not found.ratio:
                assert named == pytest.approx(per_level.to_dict(), rel=1e-9)


def test_u_num_is_a_letter_with_a_subscript(html):
    text = re.sub(r"<style>.*?</style>", "", html, flags=re.S)
    assert "u_num" not in text
    assert "u<sub>num</sub>" in text
    assert "U, the bound of the numerical error, is the same for every factor" in text


def test_a_huge_f_is_only_said_to_be_so(data):
    found = facts(data)[1]
    assert found.result is not None
    rows = tuple(replace(row, f=7.6e9) if row.term == "plates" else row for row in found.rows)
    result = replace(found.result, anova=replace(found.result.anova, rows=rows))
    table = tables.anova(replace(found, result=result), data)
    assert "> 10,000" in next(row for row in table.rows if row[0] == "plates")
    assert table.note.startswith("F > 10,000: the effect is nearly the same in every phantom")


def test_cells_are_compared_over_the_blocks_they_share(data):
    data = with_failures(data)
    name = "relative_rms_force_error"
    failed = set(data.table.loc[data.table[name].isna(), "block"])
    shared = comparable(data, name)
    assert set(shared["block"]) == set(data.blocks) - failed
    frame = cells(data, name)
    assert len(frame) == 32
    assert (frame["n"] == len(data.blocks) - len(failed)).all()


def test_warnings_that_differ_in_names_and_numbers_are_one_line(data):
    found = [
        ("error", "material: 1 of 3 degrees of freedom are not estimable"),
        ("error", "model.space: 1 of 1 degrees of freedom are not estimable"),
        ("modulus", "material: 1 of 3 degrees of freedom are not estimable"),
        ("error", "rows: 3 are missing"),
        ("modulus", "rows: 4 are missing"),
    ]
    assert folded(found, data) == (
        "Error and modulus: material and space: 1 of 3 degrees of freedom are not estimable.",
        "Error: rows: 3 are missing.",
        "Modulus: rows: 4 are missing.",
    )


def test_smallest_possible_report():
    table = pd.DataFrame(
        {"case_id": ["a", "b"], "f": ["x", "y"], "status": "converged", "y": [1.0, 2.0]}
    )
    data = ReportData("tiny", "", {"f": ("x", "y")}, table, analyses=(ResponseAnalysis("y", "N"),))
    assert "tiny" in undrawn(data)


def hostile(data, evil):
    """The example with a hostile text in every place where a user may write."""
    from study.statistics.analysis.anova import anova

    keep = data.table["material"].isin(FACTORS["material"][:2])
    keep &= data.table["model.space"] == "axisymmetric"
    table = data.table[keep].rename(columns={"plates": evil})
    table = table.assign(
        material=table["material"].replace("neo-hookean", evil),
        block=table["block"].replace("EF10_1", evil + "1"),
    )
    factors = {"material": (evil, "mooney-rivlin"), evil: FACTORS["plates"]}
    options = {"block": "block", "records": True, "exact": False, "tolerance": 1e-7}
    try:
        result = anova(table, "mu0", list(factors), practical="1 kPa", **options)
    except Exception:  # whatever the analysis makes of such names, the page must be safe
        result = None
    curves = tuple(
        replace(pair, block=evil, levels={"material": evil, evil: pair.levels["plates"]})
        for pair in data.curves[:4]
    )
    return replace(
        data,
        **dict.fromkeys(("name", "question", "block", "citation", "design_text"), evil),
        **dict.fromkeys(("inputs", "assumed", "provenance"), {evil: evil}),
        **dict.fromkeys(("blocks", "commands", "data_notes", "warnings"), (evil,)),
        **dict.fromkeys(("controls", "fits", "numerical"), ()),
        factors=factors,
        table=table,
        curves=curves,
        analyses=(ResponseAnalysis("mu0", evil, result, 1.0, title=evil, better="lower"),),
        exclusions=((evil, evil),),
        checks=(Check(evil, "fail", evil, evil),),
        failures=(Record(evil, evil, {"material": evil}, evil, "failed", evil),),
    )


#: several languages in one name; the others stand alone in the long verification
ALL_IN_ONE = ("=1|<script>alert(1)</script>$\\frac{a}$", *CORPUS[6:10])
SLOW_CORPUS = [pytest.param(x, marks=[pytest.mark.slow, pytest.mark.verify]) for x in CORPUS]
DRAWN = pytest.param(True, marks=[pytest.mark.slow, pytest.mark.verify])


@pytest.mark.parametrize("drawn", [False, DRAWN])
@pytest.mark.parametrize("evil", [*ALL_IN_ONE, *SLOW_CORPUS])
def test_hostile_names_are_shown_and_never_run(data, evil, drawn):
    page = (build if drawn else undrawn)(hostile(data, evil))
    seen = ReadPage(page)
    assert not seen.tags & {"img", "iframe", "link"}
    assert only_our_script(page)
    assert not [name for name in seen.attributes if name.startswith("on")]
    assert all(is_local(link) for link in seen.links)
    assert not re.search("[\x00-\x08\u202a-\u202e]", page)
    shown = re.sub("[\x00\u202e]", "\ufffd", evil)
    assert shown in "".join(seen.text)
    assert "Figure missing" not in page


# Tables whose blocks do not hold every cell, and tables that leave doubts.


def halves():
    """A 2 x 2 x 2 factorial in six blocks of four, as field trials lay it: A x B x C is lost."""
    rng = np.random.default_rng(8)
    rows = [
        (f"b{plot}", a, b, c, 50 + 6 * a - 4 * c + rng.normal(0, 2))
        for plot in range(6)
        for a, b, c in product((0, 1), repeat=3)
        if (a + b + c) % 2 == plot % 2
    ]
    return pd.DataFrame(rows, columns=["field", "A", "B", "C", "yield"])


def test_a_table_whose_blocks_hold_half_of_the_cells(tmp_path):
    """Nothing is missing, every figure is drawn, and the methods name the model that was fitted."""
    analyze(halves(), "yield", ["A", "B", "C"], block="field", practical="2").report(tmp_path)
    first, details = ((tmp_path / name).read_text("utf-8") for name in page_names("table-yield"))
    assert (faults_of(first), faults_of(details)) == ([], [])
    assert len(words_of(first).split()) <= 700
    assert "Unfinished study" not in first
    assert "How does yield depend on A, B and C?" in first
    assert "Figure missing" not in details
    means = pd.read_csv(tmp_path / "table-yield-data" / "figure-yield-means.csv")
    assert (means["low"] < means["mean"]).all()
    assert (means["mean"] < means["high"]).all()
    assert len(pd.read_csv(tmp_path / "table-yield-data" / "figure-yield-cells.csv")) == 24
    text = words_of(details)
    methods = text.partition("Methods, to paste")[2].partition("Provenance")[0]
    assert "mixed model by REML (Kenward and Roger)" in methods
    assert "gave 8 cells, not all of them in each of 6 fields" in methods
    assert "Greenhouse" not in methods
    assert "No p of this page rests on them" not in text
    pairs = words_of(details.partition('id="pairs"')[2].partition('id="residuals"')[0])
    assert "Intervals hold for all pairs of a factor together." in pairs
    assert "adjusted p" not in pairs


def first_page(folder, table, response, *factors, **how):
    """Words of the first page of an analysis."""
    with data_alone():
        analyze(table, response, list(factors), **how).report(folder)
    return words_of((folder / f"table-{response.lower()}.html").read_text("utf-8"))


def test_more_rows_would_narrow_what_a_table_leaves_open(tmp_path):
    rng = np.random.default_rng(2)
    table = pd.DataFrame({"wool": list("AB") * 6, "breaks": rng.normal(30, 5, 12)})
    page = first_page(tmp_path, table, "breaks", "wool", practical="2")
    assert "these data cannot show whether wool matters" in page
    assert "More rows would narrow the interval of wool." in page


def test_a_claim_goes_no_further_than_the_cells_that_were_measured(tmp_path):
    """Foam was never measured between oiled plates: of all settings nothing can be said."""
    rng = np.random.default_rng(5)
    rows = [
        (batch, gel, plate, 20 + 3 * (gel == "stiff") + rng.normal(0, 0.1))
        for batch, gel, plate in product("ABCDEF", ("soft", "stiff", "foam"), ("glued", "oiled"))
        if (gel, plate) != ("foam", "oiled")
    ]
    table = pd.DataFrame(rows, columns=["batch", "gel", "plate", "E"])
    page = first_page(tmp_path, table, "E", "gel", "plate", block="batch", practical="1")
    assert "that of plate (where all its levels were measured) makes no practical" in page
    assert "at every setting of the others that was measured it makes no practical" in page
