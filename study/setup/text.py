"""Texts of a study file: words to choose from, names, paths; each refused with its rule."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping
from pathlib import PurePosixPath, PureWindowsPath

from study.errors import nearest
from study.setup.quantity import shown
from study.setup.section import Bad, Reads

MAX_NAME = 80
MAX_TEXT = 4000

#: categories of Unicode that a reader cannot see, or that steer a terminal
INVISIBLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def quoted(key: str) -> str:
    """Key, quoted and cut where it is not a plain word.

    Parameters
    ----------
    key : str
        As written in a file; cut to 80 characters, with non-ASCII characters escaped.
    """
    plain = key.isascii() and len(key) <= MAX_NAME and key.replace("-", "_").isidentifier()
    return key if plain else ascii(key[:MAX_NAME])


def choice(*names: str, synonyms: Mapping[str, str] | None = None) -> Callable[[object], str]:
    """Reader of one of several words; a synonym becomes the word it stands for.

    Parameters
    ----------
    *names : str
        Words that are allowed.
    synonyms : mapping of str to str, optional
        Further allowed words, each with the word that it stands for.

    Returns
    -------
    callable
        Raw value to one of ``names``; raises :class:`Bad` for anything else.
    """
    words = {name: name for name in names} | dict(synonyms or {})

    def read(value: object) -> str:
        if not isinstance(value, str):
            raise Bad(f"must be a text, got {shown(value)}", nearest("", words))
        if value not in words:
            raise Bad(f"unknown value {shown(value)}", nearest(value[:MAX_NAME], words))
        return words[value]

    return read


def word(*names: str, synonyms: Mapping[str, str] | None = None, mend: str = "") -> Reads:
    """Declare one of several words, the same in a file and in Python; see :func:`choice`.

    Parameters
    ----------
    *names : str
        Words that are allowed.
    synonyms : mapping of str to str, optional
        Further allowed words, each with the word that it stands for.
    mend : str
        What to write where the key is missing; a key that has it must stand in a file.
    """
    read = choice(*names, synonyms=synonyms)
    return Reads(read, mend=mend, given=read)


def flag(value: object) -> bool:
    """Read true or false.

    Parameters
    ----------
    value
        Raw value.

    Raises
    ------
    Bad
        If it is no boolean; 0, 1 and texts are none.
    """
    if not isinstance(value, bool):
        raise Bad(f"must be true or false, got {shown(value)}")
    return value


def text(value: object) -> str:
    """Read a text without control characters.

    Parameters
    ----------
    value
        Raw value; new lines and tabs may stand in it, blanks around it are removed.

    Raises
    ------
    Bad
        If it is no text, has more than 4000 characters, or holds one that cannot be seen.
    """
    if not isinstance(value, str):
        raise Bad(f"must be a text, got {shown(value)}", "put it in quotes")
    if len(value) > MAX_TEXT:
        raise Bad(f"has {len(value)} characters, the limit is {MAX_TEXT}")
    if any(unicodedata.category(c) in INVISIBLE and c not in "\n\t" for c in value):
        raise Bad("holds control characters")
    return value.strip()


def name(value: object) -> str:
    """Read a name that may stand in a table, a page or a CSV file.

    A leading ``=``, ``+``, ``-`` or ``@`` is a formula for a spreadsheet (CWE-1236), and no
    quoting survives its next save.

    Parameters
    ----------
    value
        Raw value; blanks around it are removed.

    Raises
    ------
    Bad
        If it is no text, is empty, has more than 80 characters, holds one that cannot be seen, or
        begins like a formula.
    """
    if not isinstance(value, str):
        raise Bad(f"must be a text, got {shown(value)}", "put it in quotes")
    stripped = value.strip()
    if not stripped:
        raise Bad("is empty")
    if len(stripped) > MAX_NAME:
        raise Bad(f"has {len(stripped)} characters, the limit is {MAX_NAME}")
    if any(unicodedata.category(c) in INVISIBLE for c in value):
        raise Bad(f"holds characters that cannot be seen: {ascii(value)}")
    if stripped[0] in "=+-@":
        rule = f"must not begin with {stripped[0]!r}, which a spreadsheet takes for a formula"
        raise Bad(f"{rule}, got {shown(value)}")
    return stripped


def slug(value: object) -> str:
    """Read a name that is also a folder's: letters, digits, dash, underscore, dot.

    Parameters
    ----------
    value
        Raw value.

    Raises
    ------
    Bad
        If it is no :func:`name`, holds other characters, or begins or ends with a dot.
    """
    plain = name(value)
    if not re.fullmatch(r"[A-Za-z0-9._-]*[A-Za-z0-9_-]", plain):
        raise Bad(f"may have letters, digits, - _ and . (not last) only, got {shown(value)}")
    if plain[0] == ".":
        raise Bad(f"must not begin with a dot, got {shown(value)}")
    return plain


def names(value: object) -> tuple[str, ...]:
    """Read a list of names, without those that repeat.

    Parameters
    ----------
    value
        Raw value: a list of at most 100 names, or one name alone.

    Raises
    ------
    Bad
        If there are more, or one is no :func:`name`.
    """
    items = value if isinstance(value, list) else [value]
    if len(items) > 100:
        raise Bad(f"lists {len(items)} names, the limit is 100")
    return tuple(dict.fromkeys(name(item) for item in items))


def texts(what: str, example: str) -> Callable[[object], tuple[str, ...]]:
    """Reader of a list of texts.

    Parameters
    ----------
    what : str
        What the texts are, in the plural, for the message.
    example : str
        One such text, for the message.

    Returns
    -------
    callable
        Raw list to a tuple of str; raises :class:`Bad` for anything else, one text alone included.
    """

    def read(value: object) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
            raise Bad(f"must be a list of {what}, got {shown(value)}", f'for example ["{example}"]')
        return tuple(value)

    return read


def relative_path(value: object) -> str:
    """Read a path below the data root.

    Parameters
    ----------
    value
        Raw value.

    Raises
    ------
    Bad
        If it is no text, is blank or absolute, begins with ``~``, climbs with ``..``, has more than
        500 characters, or holds one that cannot be seen.
    """
    if not isinstance(value, str) or not value.strip():
        raise Bad(f"must be a path, got {shown(value)}")
    mend = "write it relative to the data root (--data DIR)"
    if any(unicodedata.category(c) in INVISIBLE for c in value) or len(value) > 500:
        raise Bad("is too long or holds characters that cannot be seen", mend)
    if value.startswith(("/", "\\", "~")) or PureWindowsPath(value).drive:
        raise Bad(f"must be relative, got {shown(value)}", mend)
    if ".." in PurePosixPath(value.replace("\\", "/")).parts:
        raise Bad(f"must not climb with '..', got {shown(value)}", mend)
    return value
