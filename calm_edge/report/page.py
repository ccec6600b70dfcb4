"""HTML and style shared by all report pages: self-contained, no external resources."""

from __future__ import annotations

import html
from collections.abc import Sequence

_STYLE = """
:root{color-scheme:light}*{box-sizing:border-box}
body{margin:0;background:#f5f6f8;color:#1f2933;font:16px/1.55 system-ui,-apple-system,"Segoe UI",
Roboto,sans-serif}
main{max-width:1120px;margin:0 auto;padding:40px 24px 80px}
h1{font-size:30px;margin:0 0 4px;letter-spacing:-.01em}h2{font-size:20px;margin:0 0 4px}
p.lead,p.note{color:#52606d;margin:0 0 18px}
section{background:#fff;border:1px solid #e3e7eb;border-radius:12px;padding:22px 24px;margin:22px 0}
section{overflow-x:auto}
img,svg{display:block;width:100%;height:auto;border-radius:6px}img+img{margin-top:12px}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
td{padding:7px 10px;border-bottom:1px solid #eef1f4;vertical-align:top}
td:first-child{color:#52606d}.pairs td:first-child{width:42%}
th{padding:7px 10px;text-align:left;font-weight:600;border-bottom:2px solid #e3e7eb}
.bad{color:#b42318}.good{color:#19734a}code{background:#eef1f4;border-radius:4px;padding:1px 5px;
font-size:14px}tr:last-child td{border-bottom:0}
ul{margin:8px 0 0;padding-left:22px}.warn{background:#fff8e6;border-color:#f2dca6}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(170px,1fr));gap:14px;margin:22px 0}
.card{background:#fff;border:1px solid #e3e7eb;border-radius:12px;padding:14px 18px}
.card b{display:block;font-size:24px;font-weight:650}.card span{color:#52606d;font-size:14px}
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
