"""Studies of parameters alone: a stranger's program or function, end to end through the verbs."""

import itertools
import json
import math
import os
import re
import subprocess
import sys
import tomllib

import numpy as np
import pandas as pd
import pytest

from study import api
from study.ground import errors
from tests.cli.small import study, success
from tests.pages import both_pages


def loads(text):
    """Design of a text."""
    return api.load_design(tomllib.loads(text))


HEAD = """
schema = 1
[study]
name = "spring"
question = "What decides the overshoot of a damped spring?"
[parameters]
mass = "2 kg"
stiffness = "800 N/m"
damping = "12 N s/m"
force = "50 N"
"""
FACTORS = """
[factors]
parameters.stiffness = ["800 N/m", "1.2 kN/m"]
parameters.damping = ["12 N s/m", "20 N s/m"]
"""
SOFT_OR_STIFF = FACTORS.partition("parameters.damping")[0]
RESPONSES = """
[[response]]
name = "peak"
unit = "mm"
practical = "1 mm"
[[response]]
name = "static"
unit = "mm"
"""
DECLARED = RESPONSES.replace('unit = "mm"\n', "")
PROGRAM = """
[forward]
model = "command"
argv = [["python", "spring.py"]]
files = { "input.txt" = "input.txt.j2", "spring.py" = "spring.py" }
values = { file = "out.json", names = { peak = "mm", static = { log = "x = (number) m" } } }
"""
TEMPLATE = "".join(
    f"{name} {{{{ parameters.{name} }}}}\n" for name in ("mass", "stiffness", "damping", "force")
)
CODE = """
import json, math
p = {k: float(v) for k, v in (line.split() for line in open("input.txt"))}
z = p["damping"] / (2 * math.sqrt(p["stiffness"] * p["mass"]))
x = p["force"] / p["stiffness"]
peak = x * (1 + math.exp(-math.pi * z / math.sqrt(1 - z * z)))
json.dump({"peak": {"value": peak, "unit": "m"}}, open("out.json", "w"))
print("x =", repr(x), "m")
"""
#: 10 thousand million rounds without a letter
WITHOUT_END = "{% for a in range(99999) %}{% for b in range(99999) %}{% endfor %}{% endfor %}"


def overshoot(stiffness, damping, mass=2.0, force=50.0):
    """Peak of the step response of a damped spring, mm."""
    z = damping / (2 * math.sqrt(stiffness * mass))
    return 1e3 * force / stiffness * (1 + math.exp(-math.pi * z / math.sqrt(1 - z * z)))


def spring(case):
    p = case.parameters
    return {
        "peak": overshoot(p.stiffness, p.damping, p.mass, p.force),
        "static": 1e3 * p["force"] / p["stiffness"],
    }


def run(design, folder, forward=spring, **more):
    """Run a study of a function, whose design is a text or its tables."""
    return api.run(
        loads(design) if isinstance(design, str) else design, forward=forward, version="1",
        jobs=1, results=folder / "results", **{"reports": None, **more},
    )  # fmt: skip


def run_program(design, folder, **more):
    return api.run(
        design, results=folder / "results", allow_commands=True, jobs=1, **{"reports": None, **more}
    )


def program(folder):
    (folder / "design.toml").write_text(HEAD + PROGRAM + FACTORS + DECLARED)
    (folder / "input.txt.j2").write_text(TEMPLATE)
    (folder / "spring.py").write_text(CODE)
    return folder / "design.toml"


def assert_effects(verdicts):
    """Each is the difference of the means of the two levels of its factor, by the formula."""
    (soft, damped), (stiff, more) = (
        [overshoot(k, d) for d in (12.0, 20.0)] for k in (800.0, 1200.0)
    )
    expected = {
        "parameters.stiffness": abs(soft + damped - stiff - more) / 2,
        "parameters.damping": abs(soft - damped + stiff - more) / 2,
    }
    effects = {v["factor"]: v["effect"] for v in verdicts if v["response"] == "peak"}
    assert {name: effects[name] for name in expected} == pytest.approx(expected, rel=1e-9)


def test_effects_of_a_function_are_those_of_the_formula(tmp_path):
    assert_effects(run(HEAD + FACTORS + RESPONSES, tmp_path).verdicts)


def test_effects_of_a_program_with_a_template_are_those_of_the_formula(tmp_path, monkeypatch):
    design = program(tmp_path)
    with pytest.raises(errors.RefusedError, match=r"python spring\.py"):
        api.run(design, results=tmp_path / "results", reports=None)
    monkeypatch.chdir(tmp_path)
    digest = api.plan(design).digest
    done = success("run", design.name, "--json", "--jobs", 1, f"--allow-commands={digest}")
    assert_effects(done.json["verdicts"])
    record = api.load(tmp_path / "results" / "spring").records[0]
    assert "stiffness 800" in record.extra["rendered"]["input.txt"]
    assert record.solver["program"]["steps"][0]["code"] == 0
    assert record.response("static") == pytest.approx(0.0625, rel=1e-12)
    again = api.plan(design, results=tmp_path / "results")
    assert (again.cases["done"], again.cases["missing"]) == (4, 0)
    first = (tmp_path / "reports" / "spring" / "spring.html").read_text()
    page = (tmp_path / "reports" / "spring" / "spring-details.html").read_text()
    assert "2 kg" in page
    assert "the numerical error of the program, which [converge] would show" in first
    assert "mesh, which was not tried" not in first + page
    text = page.lower().split("</style>")[-1].split("<script")[0]
    assert "calibrat" not in text.split("warnings")[0]


@pytest.mark.parametrize(
    ("changed", "into", "said"),
    [
        ("{{ parameters.force", "{{ parameters.forse", "4: unknown name parameters.fors"),
        ("{{ parameters.mass", "{{ specimen.mass", "1: unknown name specimen"),
        ("{{ parameters.mass }}", "{% if %}", "1: is no template"),
        ("{{ parameters.mass }}", "{{ ''.__class__ }}", "1: cannot be rendered"),
        ("{{ parameters.mass }}", "{{ 'a' * 10**9 }}", "1: cannot be rendered"),
        ("{{ parameters.mass }}", "{{ '%0999999999d' % 1 }}", "1: cannot.*MemoryError"),
        ("{{ parameters.mass }}", WITHOUT_END, "1: cannot.*more than 0.5 s of computing"),
        ("{{ parameters.mass }}", "{% include 'more.j2' %}", "1: takes in another file"),
    ],
)
def test_a_template_that_is_wrong_is_told_by_the_plan(tmp_path, monkeypatch, changed, into, said):
    monkeypatch.setattr("study.external.answers._MOST_SECONDS", 0.5)
    design = program(tmp_path)
    path = tmp_path / "input.txt.j2"
    path.write_text(path.read_text().replace(changed, into))
    with pytest.raises(errors.InputError, match=r"input\.txt\.j2:" + said):
        api.plan(design)


def with_deeds(folder, deeds):
    """Run a program that does another thing in each case, by the number of the case."""
    design, code = program(folder), CODE.split("json.dump")[0]
    deed = f"parameters.deed = {list(range(len(deeds)))}\n"
    text = design.read_text().replace("[forward]", "deed = 0\n[forward]")
    design.write_text(text.replace(FACTORS, f"[factors]\n{deed}"))
    (folder / "input.txt.j2").write_text(f"{TEMPLATE}deed {{{{ parameters.deed }}}}\n")
    code += f"exec({deeds!r}[int(p['deed'])])\nprint('x =', x, 'm')\n"
    (folder / "spring.py").write_text(code)
    found = run_program(design, folder)
    return sorted(found.records, key=lambda record: int(record.levels["parameters.deed"]))


def test_a_program_without_an_answer_is_a_status_of_its_case(tmp_path):
    deeds = {
        'json.dump({"peak": {"value": peak, "unit": "m"}}, open("out.json", "w"))': "",
        'json.dump({"peak": "many"}, open("out.json", "w"))': "is no number",
        'json.dump({"peak": 1e999}, open("out.json", "w"))': "not a finite number|out.json",
        'json.dump({"peak": "1e400"}, open("out.json", "w"))': "not a finite number",
        'json.dump({"peak": "5 kg"}, open("out.json", "w"))': "is in kg",
        'json.dump({"peek": 5}, open("out.json", "w"))': "did you mean 'peek'",
        'open("out.json", "w").write("{}")': "no value 'peak'",
        # parsers of JSON keep the last of two values without a word
        """open("out.json", "w").write('{"peak": 1, "peak": 2}')""": "several values of 'peak'",
        'json.dump({"peak": 10**400}, open("out.json", "w"))': "peak of out.json: is beyond",
        "pass": "wrote no out.json",
        "raise SystemExit(3)": "return code 3",
        'open("out.json", "w").write("[")': "out.json",
    }
    good, *failed = with_deeds(tmp_path, list(deeds))
    assert good.converged
    for record, said in zip(failed, list(deeds.values())[1:], strict=True):
        assert not record.converged
        assert re.search(said, record.message), record.message
        assert record.solver["program"]["steps"]


def test_numbers_of_a_table_that_a_program_writes_are_read_whole(tmp_path, monkeypatch):
    tables = {
        "peak\n12.5\n": 12.5,
        "name,value\npeak,250\n": 250.0,
        "peak;x\n1.25e1 cm;2\n": 125.0,
        "peak,peak\n1,2\n": None,
    }
    monkeypatch.setitem(globals(), "PROGRAM", PROGRAM.replace("out.json", "out.csv"))
    deeds = [f"open('out.csv', 'w').write({table!r})" for table in tables]
    found = with_deeds(tmp_path, deeds)
    assert [record.value("peak") for record in found] == list(tables.values()), found


def test_a_report_agrees_with_its_records_whatever_run_wrote_it(tmp_path):
    """The order of keys in the file, and what the run warned of, are no difference of numbers."""
    design = program(tmp_path)
    # behind a table within the table
    design.write_text(design.read_text().replace("[factors]", 'seconds = "1 s"\n[factors]'))
    reports = tmp_path / "reports"
    places = {"results": tmp_path / "results", "reports": reports}
    first = run_program(design, tmp_path, reports=reports)
    assert api.verify("spring", **places).differences == []
    (tmp_path / "spring.py").write_text(CODE.replace("* (1 +", "* (2 +"))
    second = run_program(design, tmp_path, reports=reports)
    peaks = [float(found.table["peak"].sum()) for found in (first, second)]
    static = 1e3 * float(first.table["static"].sum())  # of m
    assert peaks[1] - peaks[0] == pytest.approx(static, rel=1e-9)
    assert any("come from another version of the program" in line for line in second.warnings)
    assert api.verify("spring", **places).differences == []


def test_why_says_what_no_manifest_holds(tmp_path):
    """A program edited after its run; a function, which the file alone does not give."""
    design = program(tmp_path)

    def use(made):
        case = made.records[0].case_id
        return api.explain(case, study=design, results=tmp_path / "results").use

    made = run_program(design, tmp_path)
    assert use(made) == "the study uses it"
    (tmp_path / "spring.py").write_text(CODE + "\n")
    other = "the study makes it of other inputs now: a program, a file beside it"
    assert use(made).startswith(other)
    design.write_text(HEAD + '[forward]\nmodel = "python"\n' + FACTORS + RESPONSES)
    made = api.run(
        design, forward=spring, version="1", jobs=1, reports=None, results=tmp_path / "results"
    )
    assert use(made) == "the study uses it"


def test_an_override_of_a_parameter_is_read_in_the_unit_of_the_file(tmp_path):
    """The program gets a number alone: of 0.1 kN beside 50 N it is 100."""
    design = program(tmp_path)
    text = design.read_text().replace("[parameters]", "[parameters]\nwet = true")
    design.write_text(text)
    plain, other = (
        api.load_design(design, overrides).treatments[0].cell.problem.parameters
        for overrides in ((), ("parameters.force=0.1 kN", "parameters.wet=false"))
    )
    assert (plain["force"], plain["wet"]) == (50, True)
    assert (other["force"], other["wet"]) == (pytest.approx(100, rel=1e-12), False)
    for override, said in {
        "parameters.wet=False": "is a text here and a flag",
        "parameters.force=5 mm": "not of the kind of N|must be a force",
        "parameters.force=100": "in no unit",
        "parameters.forse=1 N": "is no parameter of the file\n    did you mean 'force'",
    }.items():
        with pytest.raises(errors.InputError, match=said):
            api.load_design(design, (override,))


def test_a_plan_counts_the_refined_cases_of_a_program(tmp_path):
    """4 cells and 2 finer ones of each, of 3 s on one worker; twice as many with the budget."""
    design = program(tmp_path)
    text = design.read_text().replace("[factors]", 'seconds = "3 s"\n[factors]')
    design.write_text(text + '[converge]\nkey = "parameters.mass"\n')
    plan = api.plan(design, jobs=1)
    assert plan.program_calls == 12
    assert plan.predicted_seconds == pytest.approx(36, rel=0.02)
    ranges = '\n[factors]\nparameters.damping = { low = "12 N s/m", high = "20 N s/m" }\n'
    adaptive = '[design]\nkind = "adaptive"\nstart = 8\nbudget = 16\n'
    design.write_text(design.read_text().replace(FACTORS, ranges) + adaptive)
    plan = api.plan(design, jobs=1)
    assert plan.program_calls == 24
    assert plan.most_seconds == pytest.approx(144, rel=0.02)


@pytest.mark.parametrize(
    "name", ["class", "lambda", "true", "items", "get", "script", "keys", "h-1"]
)
def test_words_of_other_languages_are_names_of_parameters(tmp_path, name):
    (tmp_path / "a.j2").write_text(f'{{{{ parameters["{name}"] }}}} {{{{ parameters.scale_ }}}}')
    text = HEAD.replace("mass =", f'{name} = 7\nscale_ = "<b>"\nmass =') + PROGRAM
    (tmp_path / "spring.py").write_text("")
    text = text.replace('"input.txt.j2"', '"a.j2"') + FACTORS + DECLARED
    (tmp_path / "d.toml").write_text(text)
    assert api.plan(tmp_path / "d.toml").cases["total"] == 4


@pytest.mark.parametrize("other", ["3D", "axisymmetric"])
def test_words_that_begin_with_a_number_are_texts(tmp_path, other):
    """A space of "2D" is not two debye."""
    text = HEAD.replace("[parameters]", '[parameters]\nspace = "2D"')
    text += f'[factors]\nparameters.space = ["2D", "{other}"]\n'
    design = loads(text + RESPONSES)
    table = run(
        design, tmp_path, lambda c: spring(c) | {"peak": float(c["parameters"]["space"] == "2D")}
    ).table
    assert dict(zip(table["parameters.space"], table["peak"], strict=True)) == {"2D": 1, other: 0}


def test_cells_that_break_a_constraint_are_left_out_with_the_reason():
    rule = '[[constraint]]\nrule = "damping * damping < 0.48 * stiffness"\nwhy = "damped enough"\n'
    design = loads(HEAD + rule + FACTORS + RESPONSES)
    assert [(one.label, why) for one, why in design.excluded] == [
        ("800 N/m / 20 N s/m", "damped enough (damping * damping < 0.48 * stiffness)")
    ]
    assert len(design.treatments) == 3


def test_seeds_are_true_replicates(tmp_path):
    def noisy(case):
        import random

        p = case["parameters"]
        return {"peak": p["stiffness"] / 100 + random.Random(p["seed"]).gauss(0, 1), "static": 1.0}

    text = HEAD + 'seed = 1\n[replicates]\nkey = "parameters.seed"\nn = 6\n' + FACTORS + RESPONSES
    found = run(text, tmp_path, noisy)
    assert len(found.records) == 24
    assert found.table["peak"].nunique() == 24
    peak = next(one for one in found.analyses if one.name == "peak").result
    assert peak.error_term.source == "E0"
    assert peak.error_term.df == 20


def test_a_function_that_is_not_repeatable_is_told_with_both_answers(tmp_path):
    def drawn(case):

        return {"peak": float(int.from_bytes(os.urandom(4), "big")), "static": 1.0}

    presets = (
        '[presets.twin.a]\nparameters.mass = "2 kg"\n[presets.twin.b]\nparameters.mass = "2 kg"\n'
    )
    # records keep their factors in another order than the design
    factors = '[factors]\ntwin = ["a", "b"]\nparameters.damping = ["12 N s/m", "20 N s/m"]\n'
    found = run(HEAD + presets + factors + RESPONSES, tmp_path, drawn)
    told = [one for one in found.warnings if "different answers" in one]
    assert len(told) == 2
    assert all(record.case_id in "".join(told) for record in found.records)


def test_answers_of_a_function_are_in_the_unit_of_their_response(tmp_path):
    def answered(case):
        static = {"value": case.parameters.stiffness, "unit": "m"}
        return {"peak": "5 cm", "static": static, "note": "coarse", "spare": math.nan}

    for record in run(HEAD + FACTORS + RESPONSES, tmp_path, answered).records:
        stiffness = 800.0 if record.levels["parameters.stiffness"] == "800 N/m" else 1200.0
        assert (record.value("peak"), record.value("static")) == (50.0, 1000 * stiffness)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (SystemExit(3), "SystemExit: 3"),
        (ValueError("half \ud83d"), "ValueError: half ?"),
        (MemoryError("of mine"), "MemoryError: of mine"),
    ],
)
def test_a_function_that_ends_fails_its_case_alone(tmp_path, error, said):
    def ends(case):
        if case.parameters.stiffness > 1000:
            raise error
        return spring(case)

    records = run(HEAD + SOFT_OR_STIFF + RESPONSES, tmp_path, ends).records
    assert {record.status: record.message for record in records} == {
        "converged": "",
        "failed": said,
    }


def test_a_curve_of_a_function_has_the_responses_of_a_curve(tmp_path):
    def curve(case):
        import numpy as np

        d = np.linspace(0.1, 2.0, 20)
        return {"displacement_mm": d, "force_N": case.parameters.stiffness / 1000 * d}

    responses = (
        '[[response]]\nname = "work"\n[[response]]\nname = "force_at"\ndisplacement = "1 mm"\n'
    )
    found = run(HEAD + FACTORS + responses, tmp_path, curve)
    for record in found.records:
        stiffness = 0.8 if record.levels["parameters.stiffness"] == "800 N/m" else 1.2
        assert record.response("force_at_1_mm") == pytest.approx(stiffness)
        assert record.response("work") == pytest.approx(0.5 * stiffness * 4)


def test_a_curve_alone_has_no_number_of_unknowns(tmp_path):
    line = {"displacement_mm": [1.0, 2.0], "force_N": [1.0, 2.0]}
    responses = '[[response]]\nname = "dofs"\n'
    records = run(HEAD + SOFT_OR_STIFF + responses, tmp_path, lambda case: line).records
    said = "there is no dofs among the answers (it gives a curve alone)"
    assert {record.message for record in records} == {said}


def refined(folder, solver, parameters, factors):
    """Study of a solver of second order in its step h."""
    tables = {
        "study": {"name": "second-order"}, "parameters": parameters, "factors": factors,
        "converge": {"key": "parameters.h", "formal_order": 2},
        "response": [{"name": "y", "practical": 0.5}],
    }  # fmt: skip
    return run(tables, folder, solver)


# where 95 % hold, fewer than 52 of 60 do in 0.3 %; of 200, 190 is the bar itself
@pytest.mark.parametrize(
    ("rows", "bar"),
    [(6, 52), pytest.param(20, 190, marks=[pytest.mark.slow, pytest.mark.verify])],
)
def test_a_bound_covers_the_error_of_a_solver_of_second_order(tmp_path, rows, bar):
    """Random parameter sets, of each of which the error is known; 95 % is the bar."""

    def coefficients(i, j):
        import random

        draw = random.Random(f"{i}-{j}")
        return draw.uniform(1, 10), draw.uniform(-3, 3), draw.uniform(-1.5, 1.5)

    def solver(case):
        p = case["parameters"]
        exact, second, third = coefficients(p["i"], p["j"])
        return {"y": exact + second * p["h"] ** 2 + third * p["h"] ** 3}

    factors = {"parameters.i": list(range(rows)), "parameters.j": list(range(10))}
    found = refined(tmp_path, solver, {"i": 1, "j": 1, "h": 0.5}, factors)
    covered = [
        abs(row.value - coefficients(*map(int, row.levels.values()))[0]) <= row.u_num
        for row in found.numerical
    ]
    assert len(covered) == 10 * rows
    # its report speaks of the step that was refined, and of no mesh
    api.report(found.folder, reports=tmp_path / "reports")
    page = both_pages(tmp_path / "reports" / "second-order" / "second-order.html")
    assert "How far the answer still depends on the h." in page
    assert "mesh error" not in page
    assert sum(covered) >= bar
    effect = next(v for v in found.verdicts if v["factor"] == "parameters.i")
    assert effect["u_num"] > 0


def test_the_series_of_a_solver_without_a_formal_order_can_be_read(tmp_path):
    """``study converge NAME`` ended with a traceback; an order of 2 shows in 1 + 2, 8, 32 h^2."""
    tables = {
        "study": {"name": "no-order"}, "parameters": {"a": 1.0, "h": 0.4},
        "factors": {"parameters.a": [1.0, 3.0]}, "converge": {"key": "parameters.h"},
        "response": [{"name": "y", "practical": 0.5}],
    }  # fmt: skip

    def solver(case):
        return {"y": case["parameters"]["a"] + case["parameters"]["h"] ** 2}

    run(tables, tmp_path, solver)
    found = api.converge("no-order", results=tmp_path / "results")
    words = " ".join(getattr(block, "words", "") for block in found.blocks())
    assert "no formal order: give [converge] formal_order" in words
    assert "observed order 2" in words


def test_the_step_as_a_factor_is_a_series_of_its_own(tmp_path):
    def solver(case):
        p = case["parameters"]
        return {"y": p["a"] * (1 + p["h"] ** 2)}

    factors = {"parameters.a": [1.0, 3.0], "parameters.h": [0.4, 0.2, 0.1]}
    found = refined(tmp_path, solver, {"a": 1.0, "h": 0.5}, factors)
    assert len(found.records) == 6
    assert {row.behaviour for row in found.numerical} == {"monotone"}
    for row in found.numerical:
        exact = float(row.levels["parameters.a"])
        assert abs(row.value - exact) <= row.u_num < 0.2


def test_a_range_has_a_surface_and_is_asked_in_its_own_unit(tmp_path):
    ranges = """
[factors]
parameters.stiffness = { low = "800 N/m", high = "1600 N/m" }
parameters.damping = { low = "6 N s/m", high = "20 N s/m" }
[design]
kind = "latin-hypercube"
runs = 16
[uncertainty]
parameters.stiffness = "30 N/m"
"""
    text = HEAD.replace('"800 N/m"', '"1200 N/m"') + ranges + RESPONSES
    found = run(text, tmp_path)
    assert [one.refused for one in found.surfaces] == ["", ""]
    at = {"parameters.stiffness": "1.1 kN/m", "parameters.damping": "12 N s/m"}
    told = api.predict(found.folder, at, response="peak")[0]
    assert told.value == pytest.approx(overshoot(1100.0, 12.0), rel=0.02)
    with pytest.raises(errors.RefusedError, match="--no-confirm"):
        api.optimize(found, minimize="peak")
    (best,) = api.optimize(found, minimize="peak", confirming=False)
    stiffness, damping = (best.settings[name] for name in at)
    assert (stiffness > 1500, damping > 17) == (True, True)
    assert best.value == pytest.approx(overshoot(stiffness, damping), rel=0.02)


SCATTERING = """
schema = 1
[study]
name = "scattering"
[parameters]
a = 1.0
b = 0.5
seed = 1
[replicates]
key = "parameters.seed"
n = 12
[factors]
parameters.a = { low = 0.0, high = 2.0 }
parameters.b = { low = 0.0, high = 1.0 }
"""


def test_an_adaptive_design_stops_at_the_q2_that_its_report_shows(tmp_path):
    """Of replicates the first alone counted, and of levels each alone: .95 where .99 was read."""

    def scattered(case):
        import random

        p = case.parameters
        return {"y": math.sin(2 * p.a) + p.b + random.Random(int(p.seed)).gauss(0, 0.15)}

    def at_levels(case):
        p = case.parameters
        factor = {"one": 1.0, "two": 1.1}[p.kind]
        return {"y": factor * math.sin(3 * p.a) * (1 + p.b**2)}

    adaptive = """
[design]
kind = "adaptive"
start = 12
budget = 20
[[response]]
name = "y"
practical = 0.2
"""
    levels = SCATTERING.partition("[replicates]")[0].replace("seed = 1", 'kind = "one"')
    levels += "[factors]" + SCATTERING.partition("[factors]")[2]
    levels += 'parameters.kind = ["one", "two"]'
    for text, function in ((SCATTERING, scattered), (levels, at_levels)):
        found = run(text + adaptive, tmp_path / function.__name__, function)
        shown = min(surface.surface.model.q2 for surface in found.surfaces)
        assert found.adaptive[-1]["q2"]["y"] == pytest.approx(shown, rel=1e-9)
        assert "at least 0.95" in found.adaptive[-1]["stopped"]


def test_an_inversion_takes_the_mean_of_replicates(tmp_path):
    """Forces scatter by .12 of themselves: the first of twelve runs alone predicted nothing."""

    def force(case):
        import random

        p = case.parameters
        scatter = 1 + random.Random(int(p.seed)).uniform(-0.2, 0.2)
        d = np.array([0.5, 1.0, 1.5, 2.0])
        stiffness = (1 + p.a) * scatter
        return {"displacement_mm": d, "force_N": stiffness * d * (1 + 0.5 * p.b * d)}

    design = """
[design]
kind = "latin-hypercube"
runs = 24
[[response]]
name = "peak_force"
"""
    text = SCATTERING.replace("n = 12", "n = 20") + design
    found = run(text, tmp_path, force)
    d = np.array([0.5, 1.0, 1.5, 2.0])
    measured = pd.DataFrame({"displacement_mm": d, "force_N": 2.2 * d * (1 + 0.2 * d)})
    measured.to_csv(tmp_path / "m.csv", index=False)
    answer = api.invert(found.folder, tmp_path / "m.csv", confirming=False)
    best = {item.name.removeprefix("parameters."): item.best for item in answer.inputs}
    assert best == pytest.approx({"a": 1.2, "b": 0.4}, rel=0.1)


def test_a_product_that_a_curve_determines_is_that_of_the_powers_that_are_written(tmp_path):
    """The force goes with c r^2: 0.0082 * 20.7^2 = 3.514; it was told as 3.47 within .7 %."""
    strain = np.linspace(0.05, 0.5, 10)
    shape = np.pi * ((1 - strain) ** -2 - (1 - strain))

    def force(case):
        p = case.parameters
        return {
            "displacement_mm": 20 * strain,
            "force_N": p.c * p.r**2 * shape * (1 + p.a * strain),
        }

    text = """
schema = 1
[study]
name = "product"
[parameters]
c = 0.007
r = 20.0
a = 0.2
[factors]
parameters.c = { low = 0.004, high = 0.012 }
parameters.r = { low = 18.0, high = 22.0 }
parameters.a = { low = 0.0, high = 0.6 }
[design]
kind = "latin-hypercube"
runs = 30
seed = 1
[[response]]
name = "peak_force"
"""
    found = run(text, tmp_path, force)
    noisy = 0.0082 * 20.7**2 * shape * (1 + 0.35 * strain)
    noisy += np.random.default_rng(0).normal(0, 0.1, strain.size)
    measured = pd.DataFrame({"displacement_mm": 20 * strain, "force_N": noisy})
    measured.to_csv(tmp_path / "m.csv", index=False)
    answer = api.invert(found.folder, tmp_path / "m.csv", confirming=False)
    (product,) = answer.combinations
    assert product.words == "parameters.c * parameters.r^2"
    assert abs(np.log(product.value / 3.5136)) < np.log(product.ratio) < 0.03
    told = [member["parameters.c"] * member["parameters.r"] ** 2 for member in answer.members]
    assert np.abs(np.log(np.array(told) / product.value)).max() <= np.log(product.ratio) + 1e-9


@pytest.mark.parametrize(
    ("written", "into", "said"),
    [
        ('files = { "input.txt" = "input.txt.j2", "spring.py" = "spring.py" }',
         'files = "spring.py"', "must be a table of names and files, or a list"),
        ('file = "out.json"', 'file = "=1+1"', "takes for a formula"),
    ],
)  # fmt: skip
def test_files_of_a_program_that_cannot_be_are_told(written, into, said):
    with pytest.raises(errors.InputError, match=said):
        loads(HEAD + PROGRAM.replace(written, into) + FACTORS + DECLARED)


def test_trajectories_screen_a_function_as_its_derivatives_say(tmp_path):
    """Mu of a straight line is its coefficient; of Ishigami's, all three are SALib's."""
    from SALib.analyze import morris

    def solver(case):
        p = case["parameters"]
        bent = math.sin(p["a"]) + 7 * math.sin(p["b"]) ** 2 + 0.1 * p["c"] ** 4 * math.sin(p["a"])
        return {"line": 3 * p["a"] - 5 * p["b"] + 0.5 * p["c"], "bent": bent}

    # records keep their factors in another order than the design
    names, low, high = ("c", "a", "b"), -3.5, 3.5
    tables = {
        "schema": 1, "study": {"name": "screened", "seed": 3},
        "parameters": dict.fromkeys(names, 1.0),
        "factors": {f"parameters.{name}": {"low": low, "high": high} for name in names},
        "design": {"kind": "morris", "trajectories": 8, "levels": 8},
        "response": [{"name": "line", "practical": 0.5}, {"name": "bent"}],
    }  # fmt: skip
    found = run(tables, tmp_path, solver, reports=tmp_path / "reports")
    line, bent = (one.to_json()["screened"] for one in found.surfaces)
    assert [row["factor"] for row in line] == [f"parameters.{name}" for name in "bac"]
    for row, slope in zip(line, (-5, 3, 0.5), strict=True):
        whole = slope * (high - low)
        assert row["effects"] == 8
        assert [row["mu"], row["mu_star"]] == pytest.approx([whole, abs(whole)], rel=1e-12)
        assert row["sigma"] == pytest.approx(0, abs=1e-11)
    of_run = {tuple(r.levels[f.name] for f in found.design.factors): r.value("bent")
              for r in found.records}  # fmt: skip
    paths = [tuple(treatment.levels.values()) for treatment in found.design.treatments]
    problem = {"num_vars": 3, "names": list(names), "bounds": [[low, high]] * 3}
    settings, values = np.array(paths, dtype=float), np.array([of_run[run] for run in paths])
    of_salib = morris.analyze(problem, settings, values, num_levels=8)
    for row in bent:
        place = names.index(row["factor"][-1])
        expected = [of_salib[key][place] for key in ("mu", "mu_star", "sigma")]
        assert [row["mu"], row["mu_star"], row["sigma"]] == pytest.approx(expected, rel=1e-12)
    assert {row["verdict"] for row in found.verdicts} <= {None, "cannot tell"}
    text = study("report", found.folder, "--reports", tmp_path / "reports").out
    assert "screens, and is no verdict" in text
    assert "Elementary effects: change" in both_pages(tmp_path / "reports/screened/screened.html")


RUNS = """
element,mesh,batch,peak_force,ok
linear,coarse,S1,10.9,
linear,coarse,S2,11.8,
linear,fine,S1,10.3,
linear,fine,S2,11.1,
quadratic,coarse,S1,10.2,
quadratic,coarse,S2,11.0,
quadratic,fine,S1,10.1,
quadratic,fine,S2,,diverged
"""


def imported(folder, factors, responses, **more):
    return api.import_runs(folder / "runs.csv", factors, responses, results=folder / "r", **more)


def test_runs_of_elsewhere_become_a_study(tmp_path):
    (tmp_path / "runs.csv").write_text(RUNS.lstrip())
    asked = "element,mesh", "peak_force=N"
    found = imported(tmp_path, *asked, failed="ok", block="batch")
    assert (found.total, found.failed) == (8, 1)
    assert sorted(set(found.table["batch" if "batch" in found.table else "block"])) == ["S1", "S2"]
    assert [r.message for r in found.records if not r.converged] == [
        "as the column ok says: diverged"
    ]
    again = api.report(found.folder, reports=tmp_path / "reports")
    assert again.report.is_file()
    assert api.verify("runs", results=tmp_path / "r", reports=tmp_path / "reports").agrees
    # nobody said which difference matters: an effect has its size and p, and no verdict
    text = study("report", found.folder, "--reports", tmp_path / "reports").out
    assert "No smallest difference that matters was given, so no factor has a verdict" in text
    (row,) = [line for line in text.splitlines() if line.startswith("mesh")]
    assert row.split()[1] == "\N{EN DASH}"
    assert "cannot show" not in text
    assert "cannot tell" not in text
    copies = imported(tmp_path, *asked, failed="ok", practical="peak_force=2 N", name="copies")
    assert copies.analyses[0].result.error_term.source == "E0"
    assert {v["practical"] for v in copies.verdicts} == {2.0}


def test_runs_made_elsewhere_are_neither_confirmed_here_nor_replaced_by_a_run(tmp_path):
    every = itertools.product((1, 2, 3, 4, 5), (20, 40, 60))
    rows = "".join(f"{v},{t},{10 + 2 * v - 0.02 * t + 0.1 * v * v}\n" for v, t in every)
    (tmp_path / "runs.csv").write_text(f"speed,temp,peak\n{rows}")
    made = imported(tmp_path, (), "peak=N", numeric="speed,temp")
    with pytest.raises(errors.RefusedError, match="its runs were made elsewhere") as refused:
        api.optimize(made.folder, maximize="peak")
    assert "Python function" not in str(refused.value)
    before = sorted(path.name for path in (made.folder / "cases").iterdir())
    success("new", tmp_path / "runs.toml")
    design = (tmp_path / "runs.toml").read_text().replace("my-study", "runs")
    (tmp_path / "runs.toml").write_text(design)
    api.virtual(tmp_path, source=tmp_path / "runs.toml")
    with pytest.raises(errors.InputError, match="holds runs that were imported"):
        api.run(tmp_path / "runs.toml", data=tmp_path, results=tmp_path / "r")
    assert sorted(path.name for path in (made.folder / "cases").iterdir()) == before
    with pytest.raises(errors.InputError, match=r"is a table, not the file of a design"):
        api.plan(tmp_path / "runs.csv")


def test_factors_of_elsewhere_that_are_numbers_stay_numbers_in_their_order(tmp_path):
    every = itertools.product((10, 2.5, 20), ("soft", "stiff"), (0, 0.1))
    rows = "".join(f"{h},{gel},{h + len(gel) + more}\n" for h, gel, more in every)
    (tmp_path / "runs.csv").write_text(f"height,gel,peak\n{rows}")
    # a response without unit has a plain number as what matters
    made = imported(tmp_path, "height,gel", "peak", practical="peak=0.5")
    assert {v["practical"] for v in made.verdicts} == {0.5}
    height, gel = made.design.factors
    assert height.labels == ("2.5", "10", "20")
    assert [level.settings["parameters.factor_1"] for level in height.levels] == [2.5, 10.0, 20.0]
    assert gel.labels == ("soft", "stiff")
    opened = api.load("runs", results=tmp_path / "r")
    assert len(opened.table) == 12
    assert opened.answers
    assert set(opened.effects["factor"]) >= {"height", "gel"}
    assert "Analysis of Variance: peak" in study("analyze", opened.folder).out


def _sampled_runs(folder, levels=("soft", "stiff")):
    """Write 30 runs of a plane at settings of a sample, and return its closed form."""
    rng = np.random.default_rng(11)
    speed, temp = rng.uniform(1, 5, 30), rng.uniform(20, 80, 30)

    def peak(speed, temp, gel):
        return 3 * speed + 0.1 * temp + 2 * (gel == levels[-1])

    rows = [f"{s:.4f},{t:.3f},{levels[k % len(levels)]}" for k, (s, t) in
            enumerate(zip(speed, temp, strict=True))]  # fmt: skip
    values = [peak(*map(float, row.split(",")[:2]), row.split(",")[2]) for row in rows]
    values[4] = ""
    table = "\n".join(f"{row},{value}" for row, value in zip(rows, values, strict=True))
    (folder / "runs.csv").write_text(f"speed,temp,gel,peak\n{table}\n")
    return peak


def test_runs_of_elsewhere_that_sample_ranges_predict_and_optimize(tmp_path):
    peak = _sampled_runs(tmp_path)
    made = imported(tmp_path, "gel", "peak=N", numeric="speed,temp", practical="peak=1 N")
    assert (made.total, made.failed) == (30, 1)
    at = {"speed": 3.2, "temp": 44.0, "gel": "stiff"}
    (seen,) = api.predict(made.folder, at)
    assert seen.value == pytest.approx(peak(**at), abs=0.05)
    assert seen.low <= peak(**at) <= seen.high
    best = api.optimize(made, minimize="peak", confirming=False)
    (lowest,) = best
    rows = pd.read_csv(tmp_path / "runs.csv").dropna().query("gel == 'soft'")
    assert lowest.settings["gel"] == "soft"
    # the surface of a label ends where its runs end
    corner = peak(rows["speed"].min(), rows["temp"].min(), "soft")
    assert lowest.value == pytest.approx(corner, abs=0.05)


@pytest.mark.parametrize(
    ("changed", "into", "numeric", "said"),
    [
        ("peak", "a peak", "speed", "peak"),
        ("soft", "", "speed", "is empty"),
        ("soft,", "soft,many", "speed", "must be a finite number"),
        ("speed", "speed", "speed=1..4", "takes no range"),
        ("speed", "speed", "sped", "speed"),
        ("speed", "speed", "gel", "must be a finite number"),
        ("\n", ",3\n", "temp log,3", "is empty"),
    ],
)
def test_columns_of_elsewhere_that_are_wrong_are_told(tmp_path, changed, into, numeric, said):
    _sampled_runs(tmp_path)
    path = tmp_path / "runs.csv"
    path.write_text(path.read_text().replace(changed, into))
    with pytest.raises(errors.InputError, match=said):
        imported(tmp_path, "gel" * (numeric != "gel"), "peak", numeric=numeric)


def test_numbers_of_elsewhere_are_asked_for_as_what_they_are(tmp_path):
    """A name in both lists was told to have wrong letters; a surface, to need another design."""
    _sampled_runs(tmp_path)
    with pytest.raises(errors.InputError, match="stands in --numeric alone"):
        imported(tmp_path, "gel,speed", "peak", numeric="speed")
    listed = imported(tmp_path, "gel", "peak")
    with pytest.raises(errors.InputError, match="import the table again with --numeric"):
        api.predict(listed.folder, {"parameters.speed": 2.0})


def test_imported_runs_as_an_instrument_exports_them(tmp_path):
    """Units below the header are those that are declared; an undeclared comma is one fault."""
    path = tmp_path / "runs.csv"
    rows = [f"{gel};{peak},5" for gel, peak in zip("AABB", (1, 2, 4, 5), strict=True)]
    path.write_text("\n".join(["gel;peak", ";[kN]", *rows]))
    assert imported(tmp_path, "gel", "peak=kN", decimal=",").total == 4
    with pytest.raises(errors.InputError, match="the table says kN, but N is declared"):
        imported(tmp_path, "gel", "peak=N", decimal=",")
    with pytest.raises(errors.InputError) as fault:
        imported(tmp_path, "gel", "peak=kN", decimal=".")
    (one,) = fault.value.faults
    assert "holds a decimal comma ('1,5')" in one.rule
    assert one.mend == "write --decimal ,"
    path.write_text(path.read_text().replace("kN", "N/mm2"))
    for unit in ("N/mm^2", "MPa"):
        assert imported(tmp_path, "gel", f"peak={unit}", decimal=",").total == 4


def test_units_in_the_names_of_columns_are_those_of_responses(tmp_path):
    rows = [f"{tip},{gel},{tip + 2 * (gel == 'stiff') + copy / 10}"
            for tip in (1, 2, 3) for gel in ("soft", "stiff") for copy in (0, 1)]  # fmt: skip
    names = "tip radius (mm),gel,peak force [N]"
    (tmp_path / "runs.csv").write_text("\n".join([names, *rows]))
    asked = {"numeric": "tip radius (mm) log"}
    made = imported(tmp_path, "gel", "peak force [N]", practical="peak force [N]=0.5 N", **asked)
    (response,) = made.design.responses
    assert (response.name, response.unit) == ("peak_force", "N")
    assert [f.name for f in made.design.factors] == ["gel", "parameters.tip_radius_mm"]
    assert sorted(made.table["peak_force"]) == sorted(float(row.rpartition(",")[2]) for row in rows)
    assert imported(tmp_path, "gel", "peak force [N]=N", **asked).total == made.total
    with pytest.raises(errors.InputError, match="the table says N, but kN is declared"):
        imported(tmp_path, "gel", "peak force [N]=kN", **asked)


def test_listed_cells_take_settings_of_ranges(tmp_path):
    _sampled_runs(tmp_path)
    design = {
        "study": {"name": "listed"}, "forward": {"model": "python"}, "parameters": {"d": "1 mm"},
        "factors": {"parameters.d": {"low": "1 mm", "high": "2 mm"}},
        "design": {"kind": "listed", "treatments": [{"parameters.d": "1.7321 mm"},
                                                    {"parameters.d": "1 mm"}]},
        "response": [{"name": "y", "unit": "N"}],
    }  # fmt: skip
    (factor,) = api.load_design(design).factors
    assert factor.labels == ("1 mm", "1.7321 mm")
    for wrong in ("2.1 mm", "1.2 m", 1.2):
        design["design"]["treatments"][0]["parameters.d"] = wrong
        with pytest.raises(errors.InputError, match="design.treatments"):
            api.load_design(design)


LARGEST = """
import itertools, json, resource, study

def of(case):
    p = case.parameters
    last_digits = int(7919 * p.a + 104729 * p.b + 1299709 * p.c + 15485863 * p.d) % 1009
    return {"y": 10 * p.a + 2 * (p.c - 4.5) * (p.d - 4.5) + 1e-5 * last_digits}

DESIGN = {
    "study": {"name": "largest", "question": "Which factor matters?"},
    "parameters": dict.fromkeys("abcd", 1.0),
    "factors": {f"parameters.{name}": [float(i) for i in range(1, 9)] for name in "abcd"},
    "response": [{"name": "y", "unit": "mm", "practical": "1 mm"}],
}
result = study.run(DESIGN, forward=of, version="1").analyses[0].result
peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
effects = {e.term.replace("parameters.", ""): e for e in result.effects}
print(json.dumps([peak_mb, {t: [e.verdict, e.of_components, e.range] for t, e in effects.items()}]))
"""


@pytest.mark.slow
def test_the_largest_factorial_is_analyzed_in_a_bounded_memory(tmp_path):
    """4 factors of 8 levels, 4,096 cells without repeats: pairs of cells once took 256 GiB."""
    run = subprocess.run([sys.executable, "-c", LARGEST], cwd=tmp_path, check=True,
                         capture_output=True, text=True)  # fmt: skip
    peak_mb, effects = json.loads(run.stdout.splitlines()[-1])
    assert peak_mb < 1500
    verdicts = {term: verdict for term, (verdict, _, _) in effects.items() if ":" not in term}
    assert verdicts == {"a": "matters", "b": "no practical difference"} | dict.fromkeys(
        "cd", "matters"
    )
    assert effects["a"][2] == pytest.approx(70.0, abs=0.01)
    matter = {t for t, (_, pure, _) in effects.items() if ":" in t and pure == "matters"}
    assert matter == {"c:d"}
    assert effects["c:d"][2] == pytest.approx(49.0, abs=0.01)
