"""The documentation site: it builds without a warning, and what it tells to do works.

A block ``console`` holds commands after ``$`` and lines that they print; ``python`` is run;
``toml`` and ``text`` whose first line is a comment with a file name are that file.
"""

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import study
from study.cli.app import run
from tests.house import declared

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TUTORIALS = ("tutorial-virtual", "tutorial-csv", "other-code", "your-own-solver")
NAMED = re.compile(r"# ([\w.-]+\.(?:toml|csv|j2|py))\n")


def blocks(page):
    return BLOCK.findall((DOCS / f"{page}.md").read_text(encoding="utf-8"))


def run_console(text):
    """Run every command of a block and look for the lines below it; return their number."""
    parts = re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]
    for part in parts:
        command, *expected = part.strip().splitlines()
        program, *arguments = shlex.split(command)
        assert program == "study", f"only study is run, got {command!r}"
        out = io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
            code = run(arguments)
        assert code == 0, f"{command!r} exits with {code}"
        for line in expected:
            assert line in out.getvalue(), f"{command!r} does not print {line!r}"
    return len(parts)


def run_python(text, names):
    """Run a block and compare what it prints with what its comments say."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(text, "a snippet", "exec"), names)
    for promised in re.findall(r"# prints (.+)", text):
        assert promised in out.getvalue(), f"prints {out.getvalue()!r}, not {promised!r}"


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS)
def test_every_snippet_of_a_tutorial_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    ran = 0
    for language, text in blocks(page):
        if language == "console":
            ran += run_console(text)
        elif language == "python":
            run_python(text, names)
            ran += 1
        else:
            name = NAMED.match(text)
            assert name, f"a block {language!r} names no file in its first line"
            body = text if language == "toml" else text[name.end() :]
            (tmp_path / name[1]).write_text(body, encoding="utf-8")
    assert ran >= 2


@pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx: apt-get install calculix-ccx")
def test_the_template_for_calculix_gives_the_force_of_the_built_in_elements(tmp_path):
    """Bonded plates: first order in h, extrapolated from two meshes (0.18 % off at most)."""
    for language, text in blocks("your-own-solver"):
        name = NAMED.match(text)
        if name and name[1] in ("gel.toml", "gel.inp.j2", "read.py"):
            body = text if language == "toml" else text[name.end() :]
            (tmp_path / name[1]).write_text(body, encoding="utf-8")
    sizes = 'parameters.h = ["1.25 mm", "0.8333333333 mm"]'
    design = tmp_path / "gel.toml"
    design.write_text(
        design.read_text().replace('parameters.C10 = ["0.01 MPa", "0.02 MPa"]', sizes)
    )
    table = study.run(
        design, results=tmp_path / "results", reports=None, allow_commands=True, refine=False
    ).table
    forces = table.pivot(index="parameters.bulk_modulus", columns="parameters.h", values="force")
    limit = 3 * forces["0.8333333333 mm"] - 2 * forces["1.25 mm"]
    built_in = [2.32576, 2.44891]  # quadrilaterals of 0.625 mm: `finite_element.solve`
    np.testing.assert_allclose(limit[["0.2 MPa", "0.8 MPa"]], built_in, rtol=2e-3)


def test_a_command_that_prints_something_else_is_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_console("$ study new a.toml\n") == 1
    with pytest.raises(AssertionError, match="does not print"):
        run_console("$ study new b.toml\nno such words\n")
    with pytest.raises(AssertionError, match="not '3'"):
        run_python("print(2)  # prints 3", {})
    with pytest.raises(AssertionError, match="exits with 2"):
        run_console("$ study plan missing.toml\n")


def test_every_page_stands_in_a_table_of_contents():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    made = {"design-file", "python", "gallery", "cookbook"}
    pages = {path.stem for path in DOCS.glob("*.md")} | made
    listed = {line for line in index.splitlines() if re.fullmatch(r"[\w-]+", line)}
    assert pages - {"index"} == listed & (pages | listed)


def test_the_reference_names_every_key_that_a_file_can_have():
    sys.path.insert(0, str(DOCS))
    try:
        import reference
    finally:
        sys.path.remove(str(DOCS))
    from study.simulation import problem_file

    text = reference.design_file()
    for key in ("specimen.radius", "test.interface", "model.mesh_size", "measurements.zero"):
        assert problem_file.may_vary(key)
        assert f"| `{key.split('.')[1]}` |" in text
    for header in ("[material]", "[markers]", "[forward]", "[[constraint]]", "[virtual]"):
        assert f"## `{header}`" in text
    values = [line.split(" | ")[2] for line in text.splitlines() if line.startswith("| `")]
    assert not [value for value in values if re.match("must|may|needs|unknown", value)]
    assert '| `shape` |  | `"cylinder"` | `"cylinder"` |' in text
    assert "study.solve" in reference.python()
    shipped = {path.stem for path in (ROOT / "designs").glob("*.toml")}
    assert shipped == set(re.findall(r"^## (.+)$", reference.gallery(ROOT / "designs"), re.M))


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    assert "furo" not in declared(ROOT)  # the package itself runs without it
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "docs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for page in ("index", "theory", "design-file", "python", "gallery", "cookbook", "contributing"):
        text = (tmp_path / f"{page}.html").read_text(encoding="utf-8")
        # formulas and everything else come with the page
        assert not re.search(r"""(src|href)="https?://[^"]+[.](js|css|woff2?)\b""", text)
    assert 'aria-label="\\mathbf{F}"' in (tmp_path / "theory.html").read_text(encoding="utf-8")
