"""The shell of a self-contained page: everything in one file, every text from outside escaped, nothing fetched and nothing sent."""

import base64
import hashlib
import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from lmeasure import files

_PAGE = """<!doctype html>
<html lang="{language}">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem; color: #1a1a1a; }}
h1 {{ font-size: 1.6rem; }} h2 {{ font-size: 1.2rem; margin-top: 2rem; }} h3 {{ font-size: 1rem; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ padding: .2rem .8rem; text-align: right; border-bottom: 1px solid #ddd; }}
th:first-child, td:first-child {{ text-align: left; }}
.warning {{ background: #fff4d6; border-left: 4px solid #d99a00; padding: .4rem .8rem; margin: .4rem 0; }}
.scroll {{ overflow-x: auto; }}
.text th {{ text-align: left; }}
.text td {{ text-align: left; overflow-wrap: anywhere; white-space: pre-line; }}
</style>
</head>
<body>
<h1>{title}</h1>
{body}
</body>
</html>
"""


def text(value: object) -> str:
    """Text from outside, safe inside a page."""
    return html.escape(str(value))


def paragraph(value: object, kind: str = "") -> str:
    """A paragraph of plain text; kind is its CSS class."""
    return f'<p class="{kind}">{text(value)}</p>' if kind else f"<p>{text(value)}</p>"


def heading(value: object) -> str:
    """A section heading."""
    return f"<h2>{text(value)}</h2>"


def table(header: Sequence[object], rows: Iterable[Sequence[object]], kind: str = "") -> str:
    """A table of plain texts; kind is a CSS class besides."""
    head = "".join(f"<th>{text(c)}</th>" for c in header)
    body = "".join("<tr>" + "".join(f"<td>{text(c)}</td>" for c in row) + "</tr>" for row in rows)
    classes = f"scroll {kind}".strip()
    return f'<div class="{classes}"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


_SCRIPT = re.compile(r"<script\b[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE)


def policy(body: str) -> str:
    """The Content-Security-Policy of a page: only the very scripts that stand in it run, and nothing is fetched or sent.

    plotly compiles its drawing of space from text that it writes itself ('unsafe-eval'), which a script must be let in for first; it sets
    styles, keeps pictures as data and reads its own pictures back as blobs.
    """
    hashes = {
        base64.b64encode(hashlib.sha256(code.encode("utf-8", "backslashreplace")).digest()).decode() for code in _SCRIPT.findall(body)
    }
    scripts = " ".join(["'unsafe-eval'", *(f"'sha256-{value}'" for value in sorted(hashes))]) if hashes else "'none'"
    return (
        f"default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src 'none'; "
        "base-uri 'none'; form-action 'none'"
    )


def page(title: str, body: Iterable[str], language: str = "en") -> str:
    """The text of a page of ready HTML parts under an escaped title."""
    whole = "\n".join(body)
    return _PAGE.format(title=text(title), body=whole, language=language, policy=policy(whole))


def write_page(path: Path, title: str, body: Iterable[str]) -> None:
    """Write a page of ready HTML parts under an escaped title, whole or not at all."""
    files.write_text(path, page(title, body))
