"""Run the quick studies that ship and photograph the first screen of their reports: `make gallery`.

Work and reports stay in `docs/_gallery/`, where the documentation site finds the reports; pictures
and `answers.json` are kept in `docs/gallery/`. What is finished there is not computed again.
"""

from __future__ import annotations

import html
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from PIL import Image

from study.reporting.output.write import browser

HERE = Path(__file__).parent
WORK = HERE / "_gallery"
KEPT = HERE / "gallery"
# Studies of virtual specimens alone that take a few minutes, with their pictures. The demo's is
# also the picture of the README.
SHOWN = {
    "demo": HERE / "report.png",
    "noise": KEPT / "noise.png",
    "same-specimen": KEPT / "same-specimen.png",
    "flat-punch": KEPT / "flat-punch.png",
}
SIZE = (1200, 985)
# Colours of a page's picture: letters stay smooth, and the file is a third of the full one.
COLOURS = 200
LEAST_SECONDS = 5
COMMAND = re.compile(r"^#   (study .+)$", re.MULTILINE)
ANSWER = re.compile(r'<section id="answer"[^>]*>\s*<h2>Answer</h2>\s*<p[^>]*>(.*?)</p>', re.DOTALL)


def commands(text: str) -> list[str]:
    """Return the commands that the head of a study file names."""
    head = text.partition("\nschema = ")[0]
    return [found.strip() for found in COMMAND.findall(head + "\n")]


def wanted(text: str) -> list[str]:
    """Return the commands that lead to the report: the first is enough where it does all."""
    found = commands(text)
    return found[:1] if found[:1] == ["study demo"] else found


def run(names: Iterable[str] = tuple(SHOWN), work: Path = WORK) -> dict[str, dict[str, str]]:
    """Run shipped studies as their heads say, and return what they answer.

    Parameters
    ----------
    names : iterable of str
        Names of files in `designs/`, without their ending.
    work : Path
        Folder in which they are run; it gets `designs/`, `results/` and `reports/`.

    Returns
    -------
    dict
        For each name the first sentences of its answer.
    """
    work.mkdir(parents=True, exist_ok=True)
    shutil.copytree(HERE.parent / "designs", work / "designs", dirs_exist_ok=True)
    answers = {}
    for name in names:
        for command in wanted((work / f"designs/{name}.toml").read_text(encoding="utf-8")):
            _run(command, work)
        answers[name] = {"answer": answer(report(name, work / "reports"))}
    return answers


def _run(command: str, work: Path) -> None:
    """Run one command of a study file; measurements that are there already are kept."""
    words = shlex.split(command)[1:]
    design = Path(words[-1]).stem
    if words[0] == "virtual" and list((work / "measurements").glob(f"{design}*")):
        return
    environment = os.environ | {"PYTHONPATH": str(HERE.parent)}
    began = time.monotonic()
    subprocess.run([sys.executable, "-m", "study", *words], cwd=work, env=environment, check=True,
                   stdout=subprocess.DEVNULL)  # fmt: skip
    seconds = time.monotonic() - began
    if seconds > LEAST_SECONDS:
        print(f"{command}: {seconds:.0f} s", flush=True)


def report(name: str, reports: Path) -> Path | None:
    """Return the page of a study in a folder of reports, if there is one."""
    pages = [reports / name / f"{name}{ending}.html" for ending in ("", "-convergence")]
    return next((page for page in pages if page.is_file()), None)


def answer(page: Path | None) -> str:
    """Return the first sentences of a report's answer, as plain text."""
    found = None if page is None else ANSWER.search(page.read_text(encoding="utf-8"))
    if found is None:
        raise SystemExit(f"{page} has no answer")
    return html.unescape(re.sub(r"<[^>]+>", "", found[1])).strip()


def picture(page: Path, out: Path) -> None:
    """Photograph the first screen of a page, in few colours."""
    with tempfile.TemporaryDirectory() as folder:
        full = Path(folder) / "full.png"
        command = [browser(), "--headless", "--disable-gpu", "--no-first-run", "--hide-scrollbars"]
        command += [f"--user-data-dir={folder}/profile", f"--screenshot={full}"]
        command += [f"--window-size={SIZE[0]},{SIZE[1]}", "--force-color-profile=srgb"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")  # Chromium's sandbox refuses to run as root
        subprocess.run([*command, page.resolve().as_uri()], check=True, capture_output=True)
        with Image.open(full) as image:
            screen = image.convert("RGB").crop((0, 0, *SIZE))
        few = screen.quantize(COLOURS, Image.Quantize.FASTOCTREE)
        few.save(out, optimize=True)


def main() -> None:
    """Run, photograph and keep."""
    KEPT.mkdir(exist_ok=True)
    answers = run()
    for name, out in SHOWN.items():
        page = report(name, WORK / "reports")
        assert page is not None
        picture(page, out)
    text = json.dumps(answers, indent=1, ensure_ascii=False)
    (KEPT / "answers.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
