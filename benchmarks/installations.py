"""Build the release, check it, install it into empty environments, and run it there from outside the checkout, without a compiler.

    python benchmarks/installations.py --keep FILE [--seconds S] [--write]
    python benchmarks/installations.py --build DIR          only what is released: wheel, sdist, SBOM, licences, conda recipe, digests

Each record is one environment: a Python of this machine, an installer, and the highest or the lowest versions of the dependencies. Only
wheels are installed, and the PATH holds nothing but the environment. The tools (uv, pipx, build, twine, check-wheel-contents,
cyclonedx-bom, mypy, py-rattler-build) come from PyPI into an environment beside. A Python that is not here is a line that says so.
"""

import argparse
import contextlib
import hashlib
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import urllib.request
import zipfile
from collections.abc import Iterator, Sequence
from importlib.metadata import Distribution, PathDistribution
from pathlib import Path
from typing import Any

from study import Study, table

ROOT = Path(__file__).parents[1]
TRUTH = ROOT / "tests" / "authorities" / "truth"
SEALED = ROOT / "tests" / "authorities" / "sealed" / "with-run" / "inputs"
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
TOOLS = ("uv", "pipx", "build", "twine", "check-wheel-contents", "cyclonedx-bom", "mypy", "py-rattler-build")
WORK = Path(tempfile.gettempdir()) / "lmeasure-installations"
LONGEST_S = 900.0
TYPES = """from pathlib import Path

import lmeasure as lm
from lmeasure.rig import Rig

rig: Rig = lm.read_rig(Path("rig.toml"))
wrong: int = lm.read_rig(Path("rig.toml"))
"""
RECIPE = """# Made by benchmarks/installations.py from pyproject.toml.
context:
  version: "{version}"
package:
  name: lmeasure
  version: ${{{{ version }}}}
source:
  path: {sdist}
  sha256: {digest}
build:
  number: 0
  noarch: python
  script: ${{{{ PYTHON }}}} -m pip install . -vv --no-deps --no-build-isolation
  python:
    entry_points:
      - lmeasure = lmeasure.__main__:program
requirements:
  host:
    - python {python}.*
    - pip
    - {backend}
  run:
    - python {requires}
{run}
tests:
  - python:
      imports:
        - lmeasure
  - script:
      - lmeasure --version
about:
  summary: {summary}
  license: {licence}
  license_file: LICENSE
"""
CONDA = {"typst": "typst-py", "lazy_loader": "lazy-loader", "python-can[multicast,serial]": "python-can"}
"""Names that conda-forge has for packages of PyPI."""
FREE = re.compile(r"MIT|BSD|Apache|PSF|Python Software Foundation|ISC|MPL|Mozilla|HPND|Unlicense|0BSD|CC0|zlib|LGPL|Lesser", re.IGNORECASE)
"""Licences of packages that a program under Apache 2.0 may depend on; LGPL and MPL as libraries of their own."""


def run(*words: object, cwd: Path | None = None, env: dict[str, str] | None = None, good: Sequence[int] = (0,)) -> str:
    """Run a program to its end and return what it writes; RuntimeError with its last lines where its exit code is not as wanted."""
    done = subprocess.run([str(word) for word in words], cwd=cwd, env=env, capture_output=True, text=True, timeout=LONGEST_S, check=False)
    if done.returncode not in good:
        last = " / ".join((done.stdout + done.stderr).strip().splitlines()[-3:])
        raise RuntimeError(f"{' '.join(map(str, words[:3]))}: exit {done.returncode}: {last}")
    return done.stdout + done.stderr


def tool(name: str) -> Path:
    """Return a tool, after all of them were installed where they are not."""
    here = WORK / "tools"
    if not (here / "ready").exists():
        shutil.rmtree(here, ignore_errors=True)
        run(sys.executable, "-m", "venv", here)
        run(here / "bin" / "pip", "install", "--quiet", *TOOLS)
        (here / "ready").touch()
    return here / "bin" / name


def python(version: str) -> Path | None:
    """Return a Python of this machine, or None."""
    places = [*map(Path, os.environ["PATH"].split(os.pathsep)), *sorted(Path.home().glob(".pyenv/versions/*/bin"))]
    for path in (place / f"python{version}" for place in places):
        with contextlib.suppress(OSError, RuntimeError):
            if run(path, "-c", "import sys, venv, ensurepip; print(sys.prefix == sys.base_prefix)").strip() == "True":
                return path
    return None


# --- what is released


def built(out: Path) -> tuple[Path, Path]:
    """Build wheel and sdist from the commit that is checked out, check them, and return their paths."""
    with tempfile.TemporaryDirectory() as name:
        source = Path(name) / "source"
        run("git", "worktree", "add", "--detach", source, "HEAD", cwd=ROOT)
        try:
            run(tool("python"), "-m", "build", "--outdir", out, source)
        finally:
            run("git", "worktree", "remove", "--force", source, cwd=ROOT)
    wheel, sdist = next(out.glob("*.whl")), next(out.glob("*.tar.gz"))
    run(tool("twine"), "check", "--strict", wheel, sdist)
    run(tool("check-wheel-contents"), wheel)
    code = set(run("git", "ls-files", "lmeasure", cwd=ROOT).split())
    with zipfile.ZipFile(wheel) as packed, tarfile.open(sdist) as tar:
        names = {name for name in packed.namelist() if ".dist-info/" not in name}
        source_names = {one.name.split("/", 1)[1] for one in tar if one.isfile()}
    if names != code or not source_names >= code:
        raise RuntimeError(f"the wheel is not the package: {sorted(names ^ code) or sorted(code - source_names)}")
    if strange := {name.split("/")[0] for name in source_names} & {"tests", "benchmarks", "datasets", "docs"}:
        raise RuntimeError(f"the sdist contains {sorted(strange)}")
    tags = run("git", "tag", "--points-at", "HEAD", cwd=ROOT).split()
    version = wheel.name.split("-")[1]
    if tags and f"v{version}" not in tags:
        raise RuntimeError(f"version {version} has the tag {tags}")
    return wheel, sdist


def recipe(out: Path, sdist: Path) -> str:
    """Write a recipe for conda, render it, and return the name of the package that it would make."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    about = project["project"]
    version = sdist.name.removeprefix("lmeasure-").removesuffix(".tar.gz")
    parts = [re.fullmatch(r"([\w.\[\],-]+?)([<>=].*)?", text) for text in about["dependencies"]]
    rows = [f"    - {CONDA.get(part[1], part[1])} {part[2] or ''}".rstrip() for part in parts if part]
    rows += [f"    - {name}" for name in ("msgpack-python", "pyserial")]  # of python-can's extras, which conda has not
    text = RECIPE.format(
        version=version, sdist=sdist.name, digest=hashlib.sha256(sdist.read_bytes()).hexdigest(), python=PYTHONS[0],
        backend=project["build-system"]["requires"][0].replace(">=", " >="), requires=about["requires-python"],
        summary=json.dumps(about["description"]), licence=about["license"], run="\n".join(rows),
    )  # fmt: skip
    path = out / "recipe.yaml"
    path.write_text(text, encoding="utf-8")
    code = (
        "import sys; from rattler_build import Stage0Recipe, VariantConfig\n"
        "for one in Stage0Recipe.from_file(sys.argv[1]).render(VariantConfig()): print(one.recipe.package.name, one.recipe.package.version)"
    )
    return run(tool("python"), "-c", code, path).strip()


def licences(environment: Path) -> list[tuple[str, str, str]]:
    """Return name, version and licence of every package of an environment but lmeasure and the installers."""
    (site,) = environment.glob("lib/python*/site-packages")
    found: list[Distribution] = [PathDistribution(path) for path in sorted(site.glob("*.dist-info"))]
    rows = []
    for one in found:
        kept = [text.split(" :: ")[-1] for text in one.metadata.get_all("Classifier", []) if text.startswith("License ::")]
        stated = one.metadata["License-Expression"] or ", ".join(kept) or (one.metadata["License"] or "").strip().splitlines()[0][:60]
        rows.append((one.metadata["Name"], one.version, stated))
    return [row for row in rows if row[0] not in ("lmeasure", "pip", "setuptools")]


# --- an environment


def installed(path: Path, way: str, versions: str, environment: Path, env: dict[str, str], files: tuple[Path, Path]) -> None:
    """Install the wheel, or the sdist, with the extra of the workbench, and for the lowest versions exactly these."""
    wheel, sdist = files
    wanted = [f"{wheel}[workbench]"]
    if versions == "lowest":
        stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        lowest = environment.with_suffix(".in")
        lowest.write_text("\n".join([*stated["dependencies"], *stated["optional-dependencies"]["workbench"]]))
        pins = run(tool("uv"), "pip", "compile", "-q", lowest, "--python", path, "--resolution", "lowest-direct", "--only-binary", ":all:")
        environment.with_suffix(".txt").write_text(pins)
        wanted += ["-r", str(environment.with_suffix(".txt"))]
    if way == "pipx":
        env = env | {"PIPX_HOME": str(environment / "pipx"), "PIPX_BIN_DIR": str(environment / "bin"), "PIPX_MAN_DIR": str(environment)}
        run(tool("pipx"), "install", "--backend", "pip", "--python", path, "--pip-args=--only-binary=:all:", *wanted, env=env)
    elif way == "uv":
        run(tool("uv"), "venv", "-q", "--python", path, environment, env=env)
        run(tool("uv"), "pip", "install", "-q", "--only-binary", ":all:", "--python", environment / "bin" / "python", *wanted, env=env)
    else:
        run(path, "-m", "venv", environment, env=env)
        pip = environment / "bin" / "pip"
        wanted = [f"{sdist}[workbench]"] if way == "sdist" else wanted
        run(pip, "install", "--quiet", *(["--only-binary=:all:"] if way == "pip" else ["--prefer-binary"]), *wanted, env=env)


def chain(environment: Path, here: Path, env: dict[str, str]) -> Iterator[tuple[str, float]]:
    """Run the commands of a chain one after the other from an empty folder, and yield the name and the seconds of each."""
    program = environment / "bin" / "lmeasure"
    lines: dict[str, list[str | Path]] = {
        "--version": ["--version", "--json"],
        "demo": ["demo", "--out", "demo"],
        "calibrate": ["calibrate", TRUTH / "cell-12-poses", "--out", "calibrated"],
        "reconstruct": ["reconstruct", TRUTH / "cell-run", "--out", "trajectory.parquet"],
        "zone": ["zone", "calibrated/rig.toml", "--x", "0:100:50", "--y", "0:100:50", "--z", "0:100:50", "--out", "zone.nc"],
        "certify": ["certify", SEALED / "trajectory.parquet", "--program", SEALED / "program.toml", "--out", "certificate"],
        "verify": ["verify", "certificate"],
    }
    for name, line in lines.items():
        begun = time.monotonic()
        text = run(program, *line, cwd=here, env=env, good=(0, 3) if name == "verify" else (0,))
        if "Traceback" in text or (name == "--version" and "lmeasure sources" not in text):
            raise RuntimeError(f"{name}: {text}")
        yield name, time.monotonic() - begun
    begun = time.monotonic()
    words = [str(program), "workbench", "project", "--no-browser"]
    with subprocess.Popen(words, cwd=here, env=env, stdout=subprocess.PIPE, text=True) as one:
        try:
            assert one.stdout is not None
            address = re.search(r"http://127\.0\.0\.1\S+", one.stdout.readline())
            opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
            with opener.open(address[0] if address else "", timeout=30) as answer:
                if b"lmeasure" not in answer.read():
                    raise RuntimeError("the workbench answers with another page")
        finally:
            one.terminate()
            one.communicate(timeout=30)
    yield "workbench", time.monotonic() - begun


def typed(environment: Path, here: Path, env: dict[str, str]) -> None:
    """Let mypy read the types of the installed package from outside."""
    (here / "outside.py").write_text(TYPES)
    interpreter = next(environment.glob("pipx/venvs/lmeasure/bin/python"), environment / "bin" / "python")
    words = ["--strict", "--python-executable", interpreter, "--cache-dir", WORK / "mypy", "outside.py"]
    text = run(tool("mypy"), *words, cwd=here, env=env, good=(1,))
    if 'has type "Rig"' not in text or "Found 1 error" not in text:
        raise RuntimeError(f"mypy: {text.strip()}")


def size_mb(folder: Path) -> int:
    """Return what the files of a folder take on the disk."""
    return round(sum(one.lstat().st_blocks for one in folder.rglob("*")) * 512 / 1e6)


def draw(seed: int, version: str, way: str, versions: str) -> dict[str, Any]:
    """Make one environment, run the chain in it, and return what came of it."""
    del seed
    record: dict[str, Any] = {"python": version, "way": way, "versions": versions, "steps": {}, "failed": ""}
    path = python(version)
    if path is None:
        return record | {"failed": "this Python is not here"}
    record["python"] = run(path, "-c", "import platform; print(platform.python_version())").strip()
    files = (next(WORK.glob("dist/*.whl"), None), next(WORK.glob("dist/*.tar.gz"), None))
    wheel, sdist = files if all(files) else built(WORK / "dist")
    assert wheel is not None
    assert sdist is not None
    with tempfile.TemporaryDirectory(prefix="lmeasure-installed-") as name:
        folder = Path(name)
        environment, here = folder / "environment", folder / "elsewhere"
        here.mkdir()
        env = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV", "NUMBA", "LMEASURE"))}
        try:
            begun = time.monotonic()
            installed(path, way, versions, environment, env, (wheel, sdist))
            record["steps"]["install"] = time.monotonic() - begun
            record["size_mb"] = size_mb(environment)
            bare = env | {"PATH": str(environment / "bin"), "XDG_CACHE_HOME": str(folder / "cache"), "CC": "/no/compiler"}
            for step, seconds in chain(environment, here, bare):
                record["steps"][step] = seconds
            if way == "uv":
                typed(environment, here, env)
        except (OSError, RuntimeError, subprocess.SubprocessError, json.JSONDecodeError) as error:
            record["failed"] = str(error).replace(str(folder), "").replace("|", "/")
    return record


def cases(options: argparse.Namespace, seed: int) -> Iterator[tuple[str, str, str]]:
    """Yield what can be installed in more than one way: only uv and pip take the lowest versions, and the sdist needs no second Python."""
    del seed
    for version, way, versions in itertools.product(options.python, options.way, options.versions):
        if (versions == "highest" or way == "uv") and (way != "sdist" or version == PYTHONS[0]):
            yield version, way, versions


def page(records: list[dict[str, Any]]) -> tuple[str, bool]:
    """Return the matrix of installations."""
    steps = ("install", "demo", "calibrate", "reconstruct", "zone", "certify", "verify", "workbench")
    absent = sorted({one["python"] for one in records if one["failed"].startswith("this Python")})
    tried = [one for one in records if one["python"] not in absent]
    rows = []
    for one in tried:
        times = [f"{one['steps'][step]:.1f}" if step in one["steps"] else "" for step in steps]
        rows.append([one["python"], one["way"], one["versions"], one.get("size_mb", ""), *times, one["failed"] or "all ran"])
    text = table(["Python", "installer", "versions", "MB", *(f"{step} [s]" for step in steps), "result"], rows)
    words = [
        "# Installations",
        "`python benchmarks/installations.py --keep FILE --write`",
        f"{len(tried)} empty environments, {sum(not one['failed'] for one in tried)} of them good. Each was made from the wheel (`sdist`: "
        "from the source archive) with the extra `workbench`, from binary packages alone. The commands ran in an empty folder. The PATH "
        "contained only the environment, so there was no compiler. The demo compiles the kernels first. Seconds are wall time on two "
        "processors that had other work.",
        *([f"Not on this machine, and so not tried: Python {', '.join(absent)}."] if absent else []),
        text,
    ]
    return "\n\n".join(words), not any(one["failed"] for one in tried)


def release(out: Path) -> None:
    """Write everything that is released into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    wheel, sdist = built(out)
    environment = WORK / "for-the-list"
    shutil.rmtree(environment, ignore_errors=True)
    path = python(PYTHONS[0])
    assert path is not None
    installed(path, "uv", "highest", environment, dict(os.environ), (wheel, sdist))
    bom = out / "sbom.cdx.json"
    run(tool("cyclonedx-py"), "environment", environment / "bin" / "python", "--output-reproducible", "-o", bom)
    rows = licences(environment)
    text = f"# Licences of what lmeasure needs\n\n{table(['package', 'version', 'licence'], rows)}\n"
    (out / "licences.md").write_text(text, encoding="utf-8")
    print(f"{len(json.loads(bom.read_text())['components'])} components, {len(rows)} licences; conda: {recipe(out, sdist)}")
    for name, version, licence in rows:
        if not FREE.search(licence):
            raise SystemExit(f"{name} {version}: licence {licence!r} is not known to be compatible")
    every = [path for path in sorted(out.iterdir()) if path.name != "SHA256SUMS"]
    (out / "SHA256SUMS").write_text("".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in every))


STUDY = Study(
    "installations", draw, page, "repeats", 1,
    {"python": PYTHONS, "way": ("pip", "pipx", "uv", "sdist"), "versions": ("highest", "lowest")}, "{python} {way} {versions}", cases,
)  # fmt: skip

if __name__ == "__main__":
    if "--build" in sys.argv[:2]:
        release(Path(sys.argv[2]))
    else:
        shutil.rmtree(WORK / "dist", ignore_errors=True)
        raise SystemExit(STUDY.command(__doc__))
