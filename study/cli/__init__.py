"""The command line: parse, call, print. Everything heavy is imported by the verb that needs it."""

from __future__ import annotations

from study.cli.app import app, main

__all__ = ["app", "main"]
