"""Build the documentation site into build/docs and open it: python docs/build_site.py [--no-browser] [--out FOLDER]."""

import argparse
import sys
import tempfile
import webbrowser
from pathlib import Path

from sphinx.cmd.build import build_main

ROOT = Path(__file__).parents[1]


def build(out: Path) -> int:
    """Build the site anew; any warning is an error. Return the exit code of Sphinx."""
    with tempfile.TemporaryDirectory() as read:
        return build_main(["-q", "-E", "-W", "--keep-going", "-c", str(ROOT / "docs"), "-d", read, str(ROOT), str(out)])


def main(arguments: list[str]) -> int:
    """Build, say where the first page is, and open it where a person looks at a terminal."""
    parser = argparse.ArgumentParser(prog="run.py docs", description="Build the documentation and open it in your browser.")
    parser.add_argument("--no-browser", action="store_true", help="do not open a browser")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "docs", metavar="FOLDER", help="folder of the site")
    asked = parser.parse_args(arguments)
    out = asked.out.resolve()
    failed = build(out)
    if failed:
        return failed
    first = out / "index.html"
    print(f"documentation: {first}")
    if sys.stdout.isatty() and not asked.no_browser:
        webbrowser.open(first.as_uri())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
