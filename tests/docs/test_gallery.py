"""The gallery: every shipped file says how it is run, and what is shown is what it answers."""

import json
import shlex
import shutil
import struct
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from study.cli.app import app
from study.reporting.output import write

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
DESIGNS = sorted((ROOT / "designs").glob("*.toml"))


@pytest.fixture(scope="module")
def pictures():
    sys.path.insert(0, str(DOCS))
    try:
        import gallery_pictures

        yield gallery_pictures
    finally:
        sys.path.remove(str(DOCS))


@pytest.fixture(scope="module")
def reference(pictures):
    import reference

    return reference


@pytest.mark.parametrize("design", DESIGNS, ids=lambda path: path.stem)
def test_every_shipped_file_names_commands_that_exist(pictures, design):
    found = pictures.commands(design.read_text(encoding="utf-8"))
    assert found, f"{design.name} does not say how it is run: a line `#   study ...` in its head"
    verbs = get_command(app).commands
    for command in found:
        words = shlex.split(command)
        assert words[1] in verbs, command
        for file in (word for word in words if word.startswith("designs/")):
            assert (ROOT / file).is_file(), command


def test_pictures_are_small_and_their_answers_are_said(pictures, reference):
    answers = json.loads((DOCS / "gallery" / "answers.json").read_text(encoding="utf-8"))
    assert set(answers) == set(pictures.SHOWN)
    page = reference.gallery(ROOT / "designs")
    for name, file in pictures.SHOWN.items():
        data = file.read_bytes()
        assert struct.unpack(">II", data[16:24]) == pictures.SIZE
        assert len(data) < 150_000
        assert f"]({file.relative_to(DOCS)})" in page
        assert answers[name]["answer"] in page
    assert "- `model.space`: axisymmetric, 3d" in page
    assert "- `specimen.height`: 15 mm to 35 mm" in page
    assert "<a href" not in page  # a fresh clone has no reports to lead to


def test_reports_are_gathered_and_led_to(reference, tmp_path):
    for folder, text in (("kept", "old"), ("own", "new")):
        page = tmp_path / folder / "noise" / "noise.html"
        page.parent.mkdir(parents=True)
        page.write_text(text)
    (tmp_path / "own" / "noise" / "noise-data").mkdir()
    (tmp_path / "own" / "not-shipped").mkdir()
    (tmp_path / "own" / "not-shipped" / "not-shipped.html").write_text("")
    series = tmp_path / "kept" / "flat-punch" / "flat-punch-convergence.html"
    series.parent.mkdir()
    series.write_text("")
    site = tmp_path / "site"
    folders = (tmp_path / "kept", tmp_path / "own", tmp_path / "missing")
    found = reference.gather(ROOT / "designs", folders, site)
    expected = ["studies/flat-punch/flat-punch-convergence.html", "studies/noise/noise.html"]
    assert sorted(found) == expected
    assert (site / found[found.index(expected[1])]).read_text() == "new"
    assert (site / "studies" / "noise" / "noise-data").is_dir()
    assert f'<a href="{expected[0]}">' in reference.gallery(ROOT / "designs", found)


@pytest.mark.slow
@pytest.mark.skipif(
    not any(map(shutil.which, write.BROWSERS)), reason="no Chromium or Chrome is installed"
)
def test_a_shown_study_still_gives_the_answer_beside_its_picture(pictures, tmp_path):
    kept = json.loads((DOCS / "gallery" / "answers.json").read_text(encoding="utf-8"))
    assert pictures.run(["noise"], tmp_path) == {"noise": kept["noise"]}
    page = pictures.report("noise", tmp_path / "reports")
    assert page is not None
    out = tmp_path / "noise.png"
    pictures.picture(page, out)
    assert out.read_bytes().startswith(b"\x89PNG")
