"""Places in a results folder, none of which a link leads out of it."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from study.ground.errors import StoreError
from study.record.document import ManifestDocument

ID = re.compile(r"[a-z0-9][a-z0-9-]{0,79}")
#: where a link in a results folder must not lead
OUTSIDE = "the results folder; remove it"


def own_folder(root: Path, name: str) -> Path:
    """Folder of a study or a report below the one that the user named; it is not made."""
    outside = f"{root}, where nothing is written; remove the link, or name another folder"
    return inside(root, Path(name).parts, outside)


def inside(root: Path, below: Sequence[str], outside: str) -> Path:
    """Place below a folder; refuse one that a link leads out of it."""
    places, nested = [], str(root)
    for part in below:
        nested = os.path.join(nested, part)
        places.append(nested)
    path = Path(nested)
    if not any(map(os.path.islink, places)):
        return path
    try:
        is_inside = path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise StoreError(f"{path}: cannot be used ({error})") from error
    if not is_inside:
        raise StoreError(f"{path}: a link leads outside {outside}")
    return path


def is_same(first: ManifestDocument | None, second: ManifestDocument) -> bool:
    """Whether two runs compute and ask the same."""
    if first is None:
        return False
    return all(first.get(key) == second.get(key) for key in ("cases", "design"))
