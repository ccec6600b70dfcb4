"""Change keys of a TOML config file while keeping comments and everything else."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

from calm_edge.config import ConfigError
from device.atomic_file import replace_text


def with_keys(text: str, section: str, values: Mapping[str, str]) -> str:
    """Set string values in `[section]` of a TOML text and return the new text.

    Raises ConfigError if the text is invalid, or if the values cannot be set without changing
    others.
    """
    try:
        before = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"not valid TOML: {error}") from None
    lines = text.splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        lines[-1] += "\n"
    header = re.compile(rf"\s*\[\s*{re.escape(section)}\s*\]\s*(#.*)?$")
    start = next((i for i, line in enumerate(lines) if header.match(line.rstrip("\n"))), None)
    if start is None:
        lines += (["\n"] if lines else []) + [f"[{section}]\n"]
        start = len(lines) - 1
    end = next(
        (i for i in range(start + 1, len(lines)) if lines[i].lstrip().startswith("[")), len(lines)
    )
    missing = []
    for key, value in values.items():
        # groups: key, value, and a comment to be kept
        pattern = re.compile(rf"""(\s*{re.escape(key)}\s*=\s*)("[^"]*"|'[^']*')(.*)$""", re.DOTALL)
        for i in range(start + 1, end):
            if found := pattern.match(lines[i]):
                lines[i] = found[1] + json.dumps(value) + found[3]
                break
        else:
            missing.append(f"{key} = {json.dumps(value)}\n")
    lines[start + 1 : start + 1] = missing
    changed = "".join(lines)
    try:
        after = tomllib.loads(changed)
    except tomllib.TOMLDecodeError:
        after = {}
    old = before.get(section, {})
    if not isinstance(old, dict) or after != before | {section: old | dict(values)}:
        raise ConfigError(f"[{section}] cannot be changed automatically; edit it by hand")
    return changed


def write_keys(path: Path, section: str, values: Mapping[str, str]) -> None:
    """Set string values in `[section]` of a file, atomically; raises ConfigError.

    A missing file is created.
    """
    try:
        text = path.read_text("utf-8-sig") if path.exists() else ""
        replace_text(path, with_keys(text, section, values))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not UTF-8 text; save it as UTF-8") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from None
