"""Pictures of every page of the product, and what a machine finds wrong with them, in headless Chromium.

    python benchmarks/page_pictures.py FOLDER [--pages WORD ...] [--languages en,ru] [--widths 390,1400,2560] [--dark] [--paper] [--screen]

Every kind of report, the page of the demo, of each kind of file that `lmeasure inspect` knows, of a batch, and every page of the workbench
over the demo's files. FOLDER keeps KIND-LANGUAGE-WIDTH.png (-dark.png), with --screen cut at the first screen, and with --paper the sheets
of an A4 print. Printed for each page: how many screens it has at 1400 px, what `tests/helpers/look.js` and axe-core find, and words of
English in a Russian page.
"""

import argparse
import base64
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pypdfium2

TESTS = Path(__file__).resolve().parents[1] / "tests"
sys.path[:0] = [str(TESTS / part) for part in ("helpers", "oracles", "acquisition", "procedures", "rig", "sensors", "workbench")]

from access import faults  # noqa: E402
from bench import served  # noqa: E402
from browser import LOOK, Page, opened  # noqa: E402
from clicks import entered, press, visit  # noqa: E402
from pages import PAGES, TRUTH  # noqa: E402
from test_by_clicks import PAGES as WORKBENCH  # noqa: E402

HEIGHTS = {390: 844, 1400: 900, 2560: 1440}
OF_DEMO = (
    "/trajectory/trajectory.parquet", "/look/robot/certificate", "/look/run", "/start/run", "/run/certify", "/run/zone", "/run/simulate",
    "/look/zone.nc", "/look/calibration",
)  # fmt: skip
INSPECTED = {
    "run": "run", "counts": "run/pass1.csv", "trajectory": "trajectory.parquet", "zone": "zone.nc", "certificate": "robot/certificate",
    "calibration": "calibration", "identification": "robot/identified", "rig": "run/rig.toml", "robot": "robot/robot.toml",
    "program": "robot/program.toml", "campaign": "campaign",
}  # fmt: skip
READY = "[...document.querySelectorAll('.js-plotly-plot')].every(e => e._fullLayout)"
ENGLISH = re.compile(r"\b(?:the|of|and|is|are|with|without|not|for|to|in|by|from|at|on|was|has|have|this|that)\b")
WORDS = """(() => { const out = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) { const e = walker.currentNode.parentElement;
    if (!e.closest('script,style,code,pre,[lang=en]')) out.push(walker.currentNode.data.trim()); }
  return out.filter(t => t); })()"""


def reports(out: Path, language: str, wanted: "Selection") -> Iterator[tuple[str, Path]]:
    """Yield the kind and file of each report, and of the demo's page and those of its files where one of them is wanted."""
    for kind, write in PAGES.items():
        if wanted(kind):
            yield kind, write(out / kind, language)
    if wanted("demo"):
        yield "demo", demo(language) / "demo.html"
    for kind, path in INSPECTED.items():
        if wanted(f"inspect-{kind}"):
            page = out / f"inspect-{kind}.html"
            lmeasure("inspect", demo(language) / path, "--out", page, "--no-browser", "--language", language)
            yield f"inspect-{kind}", page
    if wanted("batch"):
        runs = [shutil.copytree(TRUTH / name, out / name) for name in ("cell-run", "cell-run-16-bit")]
        lmeasure("batch", "reconstruct", *runs, "--out", out / "store", "--language", language)
        yield "batch", next((out / "store").glob("*.html"))


class Selection:
    """Whether a page is wanted by its name."""

    def __init__(self, words: list[str]) -> None:
        self.words = words

    def __call__(self, kind: str) -> bool:
        return not self.words or any(word in kind for word in self.words)


def demo(language: str) -> Path:
    """Return the folder of the demo in a language, made at first."""
    folder = Path(tempfile.gettempdir()) / f"lmeasure-pages-{language}"
    if not (folder / "demo.html").exists():
        lmeasure("demo", "--out", folder, "--no-browser", "-f", language=language)
    return folder


def lmeasure(*words: object, language: str = "en") -> None:
    """Run a command of lmeasure, quietly."""
    code = {"en": "en_GB.UTF-8", "ru": "ru_RU.UTF-8"}[language]
    environment = {"LANG": code, "LC_ALL": code, "PATH": "/usr/bin:/bin", "HOME": str(Path.home())}
    command = [sys.executable, "-m", "lmeasure", *map(str, words)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    if done.returncode:
        sys.exit(f"lmeasure {' '.join(map(str, words))}: {done.stdout}{done.stderr}")


def look(page: Page, name: str, language: str, options: argparse.Namespace) -> None:
    """Take the pictures of a page that is open, and print what is wrong with it."""
    wrong: list[object] = []
    for width in options.widths:
        height = HEIGHTS.get(width, width * 9 // 16)
        page.resize(width, height)
        page.wait(READY)
        wrong += [f"{width}: {text}" for text in page.evaluate(LOOK)]
        if width == 1400:
            screens = page.evaluate("document.documentElement.scrollHeight") / height
            wrong += [f"{screens:.1f} screens"] if screens > 4.0 else []
        for scheme in ("light", "dark") if options.dark else ("light",):
            page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
            page.resize(width, height)
            clip = {"clip": {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}} if options.screen else {}
            picture = page.call("Page.captureScreenshot", format="png", captureBeyondViewport=True, **clip)["data"]
            end = "-dark" if scheme == "dark" else ""
            (options.folder / f"{name}-{language}-{width}{end}.png").write_bytes(base64.b64decode(picture))
            wrong += [f"{scheme}: {rule} {elements}" for rule, elements in faults(page)]
        page.call("Emulation.setEmulatedMedia", features=[])
    if language == "ru":
        wrong += [f"in English: {text[:100]!r}" for text in page.evaluate(WORDS) if len(ENGLISH.findall(text)) > 1]
    if options.paper:
        document = pypdfium2.PdfDocument(page.printed())
        for number, sheet in enumerate(document, 1):
            sheet.render(scale=1.0).to_pil().save(options.folder / f"{name}-{language}-sheet{number}.png")
        document.close()
    print(f"{name} {language}: {len(wrong)} findings", *map(str, [*wrong, *page.errors]), sep="\n    ", flush=True)


def main() -> None:
    """Take the pictures, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pages", nargs="*", default=[], help="words that a page's name has; all pages without it")
    parser.add_argument("--languages", default="en,ru", type=lambda text: text.split(","))
    parser.add_argument("--widths", default="390,1400,2560", type=lambda text: [int(word) for word in text.split(",")])
    for name in ("dark", "paper", "screen"):
        parser.add_argument(f"--{name}", action="store_true")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    wanted = Selection(options.pages)
    with tempfile.TemporaryDirectory() as scratch:
        for language in options.languages:
            for kind, file in reports(Path(scratch) / language, language, wanted):
                with opened(file, size=(options.widths[0], 1.0)) as page:
                    look(page, kind, language, options)
        named = {path: "workbench" + re.sub(r"\W+", "-", path).rstrip("-") for path in (*WORKBENCH, *OF_DEMO)}
        if not any(wanted(name) for name in named.values()):
            return
        project = shutil.copytree(demo("en"), Path(scratch) / "project")
        with served(project) as address, opened(address) as page:
            base = entered(page)
            for language in options.languages:
                press(page, f".language [value={language}]", f"document.documentElement?.lang === '{language}'")
                for path, name in named.items():
                    if wanted(name):
                        visit(page, base, path)
                        look(page, name, language, options)
                        page.errors.clear()
                        visit(page, base, "/")


if __name__ == "__main__":
    main()
