"""Change keys of a TOML config file while keeping comments and everything else."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calm_edge.config import ConfigError
from device.atomic_file import replace_text

Sections = Mapping[str, Mapping[str, Any]]


def with_keys(text: str, sections: Sections) -> str:
    """Set `sections[section][key]` in a TOML text and return the new text.

    Raises ConfigError if the text is invalid, or if the values cannot be set without changing
    others.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        before = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"not valid TOML: {error}") from None
    wanted = dict(before)
    for section, values in sections.items():
        present = before.get(section, {})
        if not isinstance(present, dict):
            raise ConfigError(f"{section}: expected a table of keys")
        wanted[section] = present | dict(values)
    try:
        document = tomlkit.parse(text)
        for section, values in sections.items():
            document.setdefault(section, tomlkit.table()).update(values)
        changed = tomlkit.dumps(document)
        after = tomllib.loads(changed)
    except (TOMLKitError, tomllib.TOMLDecodeError, ValueError):
        after = {}
    if after != wanted:
        names = ", ".join(f"[{section}]" for section in sections)
        raise ConfigError(f"{names} cannot be changed automatically; edit it by hand")
    return changed


def write_keys(path: Path, sections: Sections) -> None:
    """Set keys of sections of a file, atomically; raises ConfigError.

    A missing file is created.
    """
    try:
        text = path.read_text("utf-8-sig") if path.exists() else ""
        replace_text(path, with_keys(text, sections))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not UTF-8 text; save it as UTF-8") from None
    except UnicodeEncodeError:
        raise ConfigError(f"{path}: a value is not UTF-8 text; rename the file or device") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from None
