"""PDF through a browser that is already installed; nothing is downloaded."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from study.errors import Fault, InputError, StudyError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_SECONDS = 120


def browser() -> str:
    """Path of a Chromium-like browser.

    Raises
    ------
    InputError
        If none is on the path.
    """
    for name in BROWSERS:
        found = shutil.which(name)
        if found:
            return found
    raise InputError(
        Fault(
            "report format 'pdf'",
            "needs Chromium or Chrome, and none was found",
            "install it (Debian: apt-get install chromium), or open the HTML report and print it",
        )
    )


def print_page(page: Path, out: Path) -> None:
    """Print an HTML file to a PDF file.

    Raises
    ------
    InputError
        If no browser is installed.
    StudyError
        If the browser fails or takes longer than two minutes.
    """
    program = browser()
    with tempfile.TemporaryDirectory() as profile:
        command = [
            program,
            "--headless",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--no-pdf-header-footer",
            f"--user-data-dir={profile}",
            f"--print-to-pdf={out}",
        ]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")  # Chromium's sandbox refuses to run as root
        command.append(page.resolve().as_uri())
        try:
            done = subprocess.run(command, capture_output=True, timeout=_SECONDS, check=False)
        except subprocess.TimeoutExpired as error:
            raise StudyError(f"{program} did not print {page} within {_SECONDS} s") from error
    if done.returncode or not out.is_file():
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        raise StudyError(f"{program} could not print {page}: {last[0][:300]}")
