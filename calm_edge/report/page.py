"""HTML and style shared by all report pages: self-contained, no external resources."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

_STYLE = """
:root{color-scheme:light dark;--paper:#f5f6f8;--card:#fff;--line:#e3e7eb;--soft:#eef1f4;
--ink:#1f2933;--muted:#52606d;--grid:#e3e7eb;--good:#19734a;--bad:#b42318;--warn:#fff8e6;
--warn-line:#f2dca6;--estimate:#0b6bcb;--truth:#d9822b;--assistant:#a03d8f}
@media (prefers-color-scheme:dark){:root{--paper:#14181d;--card:#1c2229;--line:#2c343d;
--soft:#262d35;--ink:#e6eaee;--muted:#9aa6b2;--grid:#2c343d;--good:#5cc795;--bad:#ff8a7a;
--warn:#33290f;--warn-line:#5e4d1c;--estimate:#5aa9f5;--truth:#f0a860;--assistant:#d98ac9}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.55 system-ui,-apple-system,
"Segoe UI",Roboto,sans-serif}
main{max-width:1120px;margin:0 auto;padding:40px 24px 80px}
h1{font-size:30px;margin:0 0 4px;letter-spacing:-.01em}h2{font-size:20px;margin:0 0 4px}
p.lead,p.note{color:var(--muted);margin:0 0 18px}p.account{font-size:19px;margin:0 0 6px}
a{color:var(--estimate)}td,th{overflow-wrap:break-word}td a{overflow-wrap:anywhere}
.narrow{display:none}
svg+svg,div+.wide,div+.narrow{margin-top:12px}
.scale{display:flex;align-items:flex-end;gap:10px;margin-top:10px;font-size:14px}
.scale i{height:10px;border:2px solid var(--ink);border-top:0}
.two{display:grid;grid-template-columns:1fr 1fr;gap:12px;margin-bottom:18px}
.two img+img{margin-top:0}.two:last-child{margin-bottom:0}
section{background:var(--card);border:1px solid var(--line);border-radius:12px;padding:22px 24px;
margin:22px 0;overflow-x:auto}
img,svg{display:block;width:100%;height:auto;border-radius:6px}img+img{margin-top:12px}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
td{padding:7px 10px;border-bottom:1px solid var(--soft);vertical-align:top}
td:first-child{color:var(--muted)}.pairs td:first-child{width:42%}
.stages td:first-child{width:24%}.stages td.number{width:12%;white-space:nowrap}
.bar{height:14px;margin-top:5px;min-width:1px;border-radius:3px;background:var(--estimate)}
th{padding:7px 10px;text-align:left;font-weight:600;border-bottom:2px solid var(--line)}
.bad{color:var(--bad)}.good{color:var(--good)}code{background:var(--soft);border-radius:4px;
padding:1px 5px;font-size:14px}tr:last-child td{border-bottom:0}
ul{margin:8px 0 0;padding-left:22px}.warn{background:var(--warn);border-color:var(--warn-line)}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(170px,1fr));gap:14px;margin:22px 0}
.card{background:var(--card);border:1px solid var(--line);border-radius:12px;padding:14px 18px}
.card b{display:block;font-size:24px;font-weight:650}.card span{color:var(--muted);font-size:14px}
@media (max-width:640px){main{padding:20px 12px 60px}section{padding:16px 12px;margin:14px 0}
h1{font-size:24px;overflow-wrap:anywhere}p.account{font-size:17px}.wide{display:none}
.narrow{display:block}.two{grid-template-columns:1fr}.cards{grid-template-columns:1fr 1fr;gap:10px}
.card b{font-size:20px}td,th{padding:7px 5px}.stages td:first-child{width:34%}}
"""


def section(title: str, note: str, body: str, kind: str = "") -> str:
    """A framed section of the page. body: HTML; title and note: plain text, escaped here."""
    lead = f'<p class="note">{html.escape(note)}</p>' if note else ""
    return f'<section class="{kind}"><h2>{html.escape(title)}</h2>{lead}{body}</section>'


def whole(title: str, parts: Sequence[str]) -> str:
    """Complete HTML document with the given title. parts: HTML."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body><main>{''.join(parts)}</main></body></html>\n"
    )


def write(path: Path, text: str) -> None:
    """Write a page as UTF-8, replacing an earlier one at once."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8", errors="replace")
    part.replace(path)
