"""Write configuration.md, the reference of all keys: `.venv/bin/python docs/configuration.py`.

The text is that of `calm-edge config`: the docstrings of `calm_edge/config.py`.
"""

from __future__ import annotations

from pathlib import Path

from calm_edge.commands.config_text import sections, toml

HEAD = """\
# Configuration

Every key has a default; an unknown key is an error. `calm-edge config` prints the configuration
that `record` would use with the same options, with these descriptions; `--changed` only what
differs from the defaults, and `calm-edge config REC` that of a recording. What it prints can be
used as a file:

```
calm-edge config --spacing-m 0.52 --set backbone.kit_file=kits/car.json --changed > kit.toml
calm-edge record --config kit.toml --out drives/monday
```

A key is set in the file under its section, or with `--set SECTION.KEY=VALUE`, which overrides the
file.

This page is written by `docs/configuration.py`.
"""


def page() -> str:
    """The page as Markdown."""
    parts = [HEAD]
    for section in sections():
        rows = ["| key | default | values | effect |", "|---|---|---|---|"]
        for key in section.keys:
            text = key.text.replace("|", "\\|")
            effect = "the same" if key.with_previous else text
            rows.append(f"| `{key.name}` | `{toml(key.default)}` | {key.values} | {effect} |")
        parts.append(f"## [{section.name}]\n\n{section.text}\n\n" + "\n".join(rows) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    (Path(__file__).parent / "configuration.md").write_text(page(), "utf-8")
