"""Input files of a stranger's program, rendered by Jinja2 in a sandbox over the resolved case."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from study.ground.errors import Fault, InputError, nearest

if TYPE_CHECKING:
    from jinja2 import Environment, Template

#: characters of a rendered file, and of a text that a template repeats
MOST_RENDERED = 20_000_000
_MOST_REPEATED = 100_000
_NEAR = "\t"


class Names:
    """A table as templates see it: its keys alone, whatever words they are."""

    __slots__ = ("_table", "_title")

    def __init__(self, title: str, table: Mapping[str, object]) -> None:
        self._title, self._table = title, table

    def __getitem__(self, key: object) -> object:
        """Value of a key; a table within it likewise."""
        value = self._table[str(key)]
        return Names(f"{self._title}.{key}", value) if isinstance(value, Mapping) else value

    def __contains__(self, key: object) -> bool:
        return key in self._table

    def __iter__(self) -> Iterator[str]:
        return iter(self._table)

    def __len__(self) -> int:
        return len(self._table)


@functools.cache
def _sandbox() -> Environment:
    """Sandbox that names what is unknown, and whose products stay small."""
    # loaded where a template is: most studies have none
    from jinja2 import StrictUndefined
    from jinja2.exceptions import SecurityError
    from jinja2.sandbox import ImmutableSandboxedEnvironment
    from jinja2.utils import missing

    class Unknown(StrictUndefined):
        """A name that is not there, and what is near to it."""

        __slots__ = ()

        @property
        def _undefined_message(self) -> str:
            name, owner = str(self._undefined_name), self._undefined_obj
            if isinstance(owner, Names):
                near = nearest(name, owner)
                return f"unknown name {owner._title}.{name}{_NEAR}{near}"
            return f"unknown name {name}" if owner is missing else super()._undefined_message

    class Sandbox(ImmutableSandboxedEnvironment):
        """Sandbox that does not repeat texts and lists without end."""

        intercepted_binops = frozenset(["*", "**"])

        def call_binop(self, context: object, operator: str, left: object, right: object) -> object:
            """Multiply and raise numbers."""
            sizes = [len(one) for one in (left, right) if isinstance(one, str | list | tuple)]
            counts = [one for one in (left, right) if isinstance(one, int | float)]
            large = operator == "**" and any(abs(one) > 1000 for one in counts)
            if large or (sizes and counts and max(sizes) * max(counts) > _MOST_REPEATED):
                raise SecurityError("makes a text or a number of more than 100,000 digits")
            return self.binop_table[operator](left, right)

    return Sandbox(undefined=Unknown, keep_trailing_newline=True, autoescape=False)


@functools.lru_cache(maxsize=256)
def _template(text: str) -> Template:
    return _sandbox().from_string(text)


def rendered(text: str, context: Mapping[str, object], source: str) -> str:
    """Text of a template over a case; an unknown name is an :class:`InputError` with its line."""
    from jinja2.exceptions import (
        SecurityError,
        TemplateError,
        TemplateSyntaxError,
        UndefinedError,
    )

    names = {k: Names(k, v) if isinstance(v, Mapping) else v for k, v in context.items()}
    size, parts = 0, []
    try:
        for part in _template(text).generate(**names):
            size += len(part)
            if size > MOST_RENDERED:
                raise SecurityError(f"renders more than {MOST_RENDERED / 1e6:g} MB")
            parts.append(part)
    except TemplateSyntaxError as error:
        rule = f"is no template: {error.message}"
        raise InputError(Fault(f"{source}:{error.lineno}", rule, "mend the braces there")) from None
    except UndefinedError as error:
        rule, _, near = str(error).partition(_NEAR)
        top = rule.removeprefix("unknown name ")
        mend = near or (nearest(top, context) if top != rule else "")
        raise InputError(Fault(f"{source}:{_line(error)}", rule, mend)) from None
    except (TemplateError, ArithmeticError, TypeError, ValueError, LookupError) as error:
        where = f"{source}:{_line(error)}"
        rule = f"cannot be rendered: {type(error).__name__}: {str(error)[:200]}"
        raise InputError(Fault(where, rule, "see what the template does there")) from None
    return "".join(parts)


def _line(error: BaseException) -> int:
    """Line of a template in which an error arose."""
    trace, line = error.__traceback__, 1
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == "<template>":
            line = trace.tb_lineno
        trace = trace.tb_next
    return line
