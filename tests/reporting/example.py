"""A synthetic report with the shape of the real study: plausible numbers, made up."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from itertools import product

import numpy as np
import pandas as pd

from study.ground.curve import Curve
from study.record.record import Record
from study.reporting.figures.axes import data_alone
from study.reporting.output.page import printed
from study.reporting.output.study_page import prepare
from study.reporting.results.study_result import (
    Check,
    CurvePair,
    FittedConstant,
    ReportData,
    ResponseAnalysis,
)
from study.statistics.analysis.anova import anova
from study.statistics.convergence.grid_convergence import NumericalUncertainty

FACTORS = {
    "material": ("neo-hookean", "mooney-rivlin", "reduced-polynomial-2", "reduced-polynomial-3"),
    "plates": ("frictionless", "bonded"),
    "model.space": ("axisymmetric", "3d"),
    "model.element_order": ("linear", "quadratic"),
}
BLOCKS = tuple(f"EF10_{i}" for i in range(1, 10))
#: error of each material in %, and by how much it bends its curves
MATERIALS = {
    "neo-hookean": (6.9, -0.09),
    "mooney-rivlin": (5.2, 0.03),
    "reduced-polynomial-2": (5.3, 0.02),
    "reduced-polynomial-3": (5.0, -0.01),
}


def undrawn(data):
    """Both pages in one document without their drawings, which take most of the time."""
    with data_alone():
        return build(data)


def example():
    """Build the whole thing."""
    table = make_table()
    options = {"block": "block", "records": True, "tolerance": 1e-7}
    names, error = list(FACTORS), "relative_rms_force_error"
    of_error = anova(table, error, names, practical="0.5 pp", u_num=0.04, **options)
    options |= {"transform": "log", "practical": "10 % of mean"}
    of_modulus = anova(table, "mu0", names, u_num=0.12, **options)
    kinds = (
        ResponseAnalysis(error, "%", of_error, practical=0.5, better="lower"),
        ResponseAnalysis("mu0", "kPa", of_modulus, 0.1, relative=True, transform="log"),
    )
    unstable = "Mooney-Rivlin is unstable beyond a stretch of 1.9 for 2 of 9 phantoms."
    apart = "Under bonded plates the mean error differs by 0.031 pp between the spaces."
    return ReportData(
        name="ecoflex-compression",
        question="Do energy, plate condition, modelling space or element order change the "
        "predicted force, or the identified modulus?",
        factors=FACTORS,
        table=table,
        analyses=kinds,
        block="phantom",
        blocks=BLOCKS,
        inputs={"specimen": "cylinder, radius 25 mm, height 30 mm", "poisson ratio": "0.4995"},
        assumed={"test.interface": "bonded or frictionless: the plates were not described"},
        citation="Dawood et al. 2026, CC BY 4.0",
        curves=make_curves(),
        fits=make_fits(),
        numerical=make_numerical(),
        checks=(
            Check("Cases finished", "pass", "144 of 144 cases converged."),
            Check(
                "Material stability", "caution", unstable, "Do not use these constants in tension."
            ),
        ),
        controls=(
            Check("3D equals axisymmetric", "pass", apart, "More would be a meshing error."),
        ),
        timings={"plan": 1.2, "calibrate": 1830.0, "solve": 660.0, "analyze": 8.0, "report": 11.0},
        provenance={"Python": "3.11.2", "seed": "2011", "design sha256": "0a" * 32},
        commands=("study run designs/ecoflex-compression.toml --data measurements --jobs 2",),
        data_notes=("EF10_3: 2 rows with equal displacement averaged.",),
        design_text='schema = 1\n\n[study]\nname = "ecoflex-compression"\nseed = 2011\n',
    )


def cells():
    return [dict(zip(FACTORS, levels, strict=True)) for levels in product(*FACTORS.values())]


def make_table():
    rng = np.random.default_rng(5)
    shift = {block: rng.normal(0, 1.1) for block in BLOCKS}
    stiff = {block: float(np.exp(rng.normal(0, 0.22))) for block in BLOCKS}
    own = {
        (b, m, p): rng.normal(0, 0.45)
        for b in BLOCKS
        for m in FACTORS["material"]
        for p in FACTORS["plates"]
    }
    rows = []
    for cell, block in product(cells(), BLOCKS):
        bonded = cell["plates"] == "bonded"
        coarse = 0.03 * (cell["model.space"] == "3d")
        coarse += 0.05 * (cell["model.element_order"] == "linear")
        mesh = bonded * rng.normal(1, 0.6) * coarse
        noise = own[block, cell["material"], cell["plates"]]
        error = MATERIALS[cell["material"]][0] + 0.25 * bonded + mesh + shift[block] + noise
        mu0 = 21.0 * stiff[block] * (0.73 if bonded else 1.0) * np.exp(0.03 * noise)
        mu0 *= 1 + 0.9 * MATERIALS[cell["material"]][1] + 0.02 * mesh
        seconds = 0.02 if not bonded else 4.0 * (9 if cell["model.space"] == "3d" else 1)
        seconds *= 3.1 if bonded and cell["model.element_order"] == "quadratic" else 1
        seconds *= float(np.exp(rng.normal(0, 0.2)))
        case = (f"{len(rows):016x}", block, *cell.values(), "converged")
        rows.append((*case, abs(error), mu0, seconds, 900))
    answers = ("status", "relative_rms_force_error", "mu0", "seconds", "dofs")
    return pd.DataFrame(rows, columns=["case_id", "block", *FACTORS, *answers])


def make_curves():
    rng = np.random.default_rng(7)
    d = np.linspace(0.3, 6.0, 200)
    pairs = []
    for block in BLOCKS:
        k = 9.0 * np.exp(rng.normal(0, 0.22))
        force = k * d * (1 + 0.035 * d)
        measured = Curve(d, force + rng.normal(0, 0.15, d.size))
        for cell in cells():
            bend = 1 + MATERIALS[cell["material"]][1] * (d / 3 - 1) + 0.02 * rng.normal()
            wiggle = 1 + 0.01 * (cell["plates"] == "bonded")
            predicted = Curve(d[::20], (force * bend * wiggle)[::20])
            pairs.append(CurvePair(cell, block, measured, predicted, "B", scatter_N=0.02 * force))
    return tuple(pairs)


def make_fits():
    constants = {
        "neo-hookean": ("C10",),
        "mooney-rivlin": ("C10", "C01"),
        "reduced-polynomial-2": ("C10", "C20"),
        "reduced-polynomial-3": ("C10", "C20", "C30"),
    }
    rng = np.random.default_rng(9)
    rows = []
    for material, plates, block in product(constants, FACTORS["plates"], BLOCKS):
        for i, constant in enumerate(constants[material]):
            value = [10.0, 1.2, 0.3][i] * float(np.exp(rng.normal(0, 0.2)))
            error = value * [0.004, 0.05, 0.4][i]
            fine = material != "mooney-rivlin"
            of = ({"material": material, "plates": plates}, block, constant, value, "kPa", error)
            ends = (value - 1.96 * error, value + 1.96 * error)
            why = "" if fine else "C10 and C01 are correlated at -0.9996"
            rows.append(FittedConstant(*of, *ends, fine, why, specimen="A"))
    return tuple(rows)


def make_numerical():
    how = ("two meshes", "EF10_4, mesh refined by 1.5")
    rows = []
    for space, order in product(FACTORS["model.space"], FACTORS["model.element_order"]):
        levels = {"model.space": space, "model.element_order": order}
        u = 0.04 if order == "linear" else 0.004
        error = ("relative_rms_force_error", 5.31, u, "%")
        rows += [NumericalUncertainty(levels, *error, *how),
                 NumericalUncertainty(levels, "mu0", 20.4, 3 * u, "kPa", *how)]  # fmt: skip
    return tuple(rows)


def unreplicated():
    """A 2x2x2x2 factorial run once: material and its interaction with plates are real."""
    rng = np.random.default_rng(3)
    names = ("material", "plates", "space", "order")
    rows = []
    for levels in product(("lo", "hi"), repeat=4):
        a, b, *_ = (level == "hi" for level in levels)
        y = 10 + 2 * a + 1.5 * (a and b) + 0.2 * rng.normal()
        case = {"case_id": str(len(rows)), "status": "converged", "y": y}
        rows.append({**dict(zip(names, levels, strict=True)), **case})
    table = pd.DataFrame(rows)
    result = anova(table, "y", list(names), practical=0.5)
    response = ResponseAnalysis("y", "N", result, 0.5, better="lower")
    return ReportData("once", "", dict.fromkeys(names, ("lo", "hi")), table, analyses=(response,))


def with_failures(data):
    """The same study with three failed cases in two cells."""
    table = data.table.copy()
    failed = table.index[[5, 40, 41]]
    table.loc[failed, "status"] = ["not-converged", "timeout", "timeout"]
    table.loc[failed, ["relative_rms_force_error", "mu0"]] = np.nan
    why = "stopped at 4.2 mm: the step could not be halved further"
    failures = tuple(
        Record(row.case_id, data.name, levels, row.block, row.status, why)
        for row, levels in zip(
            table.loc[failed].itertuples(),
            table.loc[failed, list(FACTORS)].to_dict("records"),
            strict=True,
        )
    )
    return replace(data, table=table, failures=failures)


def build(data):
    """Both pages of a report in one document."""
    return printed(*prepare(data).html())


def words_of(page):
    """Text of a page without its style, script and drawings."""
    read = re.sub(r"<(style|script|svg)\b.*?</\1>", " ", page, flags=re.S)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", read)))


#: elements without an end
_VOID = {"meta", "link", "br", "hr", "img", "input", "wbr"}


class ReadPage(HTMLParser):
    """Tags, attributes, links and text of a page; what a browser would mend in silence, and what
    a reader who does not see would miss."""

    def __init__(self, page):
        super().__init__()
        self.open: list[str] = []
        self.levels: list[int] = []
        self.ids: list[str] = []
        self.found: list[str] = []
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.links: list[str] = []
        self.text: list[str] = []
        self.feed(page)

    def handle_data(self, data):
        self.text.append(data)

    def handle_starttag(self, tag, attrs):
        have = dict(attrs)
        self.tags.add(tag)
        self.attributes |= set(have)
        self.links += [have[key] or "" for key in ("href", "src", "xlink:href") if key in have]
        if tag not in _VOID:
            self.open.append(tag)
        if re.fullmatch("h[1-6]", tag):
            self.levels.append(int(tag[1]))
        if have.get("role") in ("region", "group") and not have.get("aria-label"):
            self.found.append(f"{tag} without a name")
        if tag == "html" and not have.get("lang"):
            self.found.append("no language")
        if tag == "img" and "alt" not in have:
            self.found.append("picture without words")
        if tag == "th" and "scope" not in have:
            self.found.append("head of a table without scope")
        if "id" in have:
            self.ids.append(str(have["id"]))

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.found.append(f"</{tag}> ends nothing")


def faults_of(page):
    """Elements that are not closed, names used twice, headings that skip a level, requests."""
    seen = ReadPage(page)
    requests = [f"request of {link}" for link in seen.links if re.match(r"(https?:)?//", link)]
    steps = zip([0, *seen.levels], seen.levels, strict=False)
    skipped = [f"h{then} below h{now}" for now, then in steps if then > now + 1]
    twice = [f"two of {name}" for name in set(seen.ids) if seen.ids.count(name) > 1]
    titles = [] if seen.levels.count(1) == 1 else [f"{seen.levels.count(1)} titles"]
    unclosed = [f"{tag} is left open" for tag in seen.open]
    return [*seen.found, *requests, *unclosed, *skipped, *twice, *titles]
