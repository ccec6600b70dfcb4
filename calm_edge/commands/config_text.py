"""Descriptions of the configuration's keys, and the configuration as commented TOML.

The descriptions are the docstrings of the sections in `config`: `[section]: what it is about.`,
then lines `key: what it does.` or `key, key: what both do.`
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from calm_edge.config import Config, ConfigError

WIDTH = 100


@dataclass(frozen=True, slots=True)
class Key:
    """A key: its default, the values it takes in words, and what it does.

    with_previous: described together with the key before it.
    """

    name: str
    default: Any
    values: str
    text: str
    with_previous: bool


@dataclass(frozen=True, slots=True)
class Section:
    """A section: what it is about, and its keys in order."""

    name: str
    text: str
    keys: tuple[Key, ...]


def sections() -> Iterator[Section]:
    """Yield the sections of the configuration."""
    defaults = Config()
    for field in dataclasses.fields(Config):
        default = getattr(defaults, field.name)
        kinds = get_type_hints(type(default))
        about, texts = _described(type(default))
        keys = []
        previous = ""
        for name, kind in kinds.items():
            text = texts.get(name, "")
            same = bool(text) and text == previous
            keys.append(Key(name, getattr(default, name), _values(kind), text, same))
            previous = text
        yield Section(field.name, about, tuple(keys))


def _described(section: type) -> tuple[str, dict[str, str]]:
    """What a section is about, and the text of each key, from its docstring."""
    name = "|".join(field.name for field in dataclasses.fields(section))
    parts = re.split(
        rf"^((?:{name})(?:, (?:{name}))*): ", inspect.getdoc(section) or "", flags=re.M
    )
    about = _sentence(parts[0].partition("]: ")[2])
    texts: dict[str, str] = {}
    for names, part in zip(parts[1::2], parts[2::2], strict=True):
        texts |= dict.fromkeys(names.split(", "), _sentence(part))
    return about, texts


def _sentence(text: str) -> str:
    """One paragraph that begins with a capital."""
    text = " ".join(text.split())
    return text[:1].upper() + text[1:]


def _values(kind: Any) -> str:
    """The values of a type, in words."""
    origin = get_origin(kind)
    if origin is Literal:
        return " or ".join(f'"{word}"' for word in get_args(kind))
    if origin is UnionType:
        return " or ".join(_values(each) for each in get_args(kind))
    if origin is tuple:
        return f"list of {_values(get_args(kind)[0])}s"
    if dataclasses.is_dataclass(kind):
        return "table"
    return {bool: "true or false", int: "whole number", float: "number", str: "text"}[kind]


def toml(value: Any) -> str:
    """A value as TOML on one line; raises ConfigError for text that is not Unicode."""
    import tomlkit

    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {toml(each)}' for key, each in value.items())}}}"
    if isinstance(value, str) and not value.isprintable():
        try:
            value.encode()
        except UnicodeEncodeError:
            raise ConfigError(f"{value!r}: not UTF-8 text; rename the file or device") from None
    return str(tomlkit.item(value).as_string())


def commented(config: Config, *, changed_only: bool = False) -> str:
    """The configuration as TOML with a comment for each key; a changed key states its default.

    changed_only: without keys that have their default. Raises ConfigError.
    """
    values = config.to_dict()
    blocks = []
    for section in sections():
        own = values[section.name]
        chosen = [key for key in section.keys if not changed_only or own[key.name] != key.default]
        if not chosen:
            continue
        parts = [[f"[{section.name}]"]]
        if not changed_only:
            parts[0] += _comment(section.text)
        for key in chosen:
            line = f"{key.name} = {toml(own[key.name])}"
            if own[key.name] != key.default:
                line += f"  # default: {toml(key.default)}"
            if key.with_previous and not changed_only:
                parts[-1].append(line)
            else:
                parts.append([*_comment(key.text), line])
        blocks.append(parts)
    gap = "\n" if changed_only else "\n\n"
    return "\n".join(gap.join("\n".join(part) for part in parts) + "\n" for parts in blocks)


def _comment(text: str) -> list[str]:
    return textwrap.wrap(
        text, WIDTH, initial_indent="# ", subsequent_indent="# ", break_long_words=False
    )
