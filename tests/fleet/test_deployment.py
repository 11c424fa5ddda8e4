"""The image of deployment/: its RUN lines in an empty environment, and the commands of its services."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "deployment"


def dockerfile() -> list[tuple[str, str]]:
    """Return the instructions of the Dockerfile with their arguments."""
    lines = (FOLDER / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in lines if line and not line.startswith("#"))]


@pytest.mark.slow
def test_the_lines_of_the_image_run_in_an_empty_environment(tmp_path: Path) -> None:
    """As `docker build` runs them: a copy of the sources, and nothing of this environment but an interpreter and the package index."""
    work = tmp_path / "work"
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, listed.split("\0")):
        (work / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, work / name)
    kept = {name: value for name, value in os.environ.items() if name.startswith(("PIP_", "SSL_", "http", "HTTP", "no_proxy"))}
    bare = kept | {"PATH": "/usr/local/bin:/usr/bin:/bin", "HOME": str(tmp_path)}
    for word, line in dockerfile():
        if word == "RUN":
            own = line.replace("/opt/venv", str(tmp_path / "venv")).replace("python -m", f"{sys._base_executable} -m")  # type: ignore[attr-defined]
            subprocess.run(["/bin/sh", "-c", own], cwd=work, env=bare, check=True, timeout=900)
    for program, argument in (("lmeasure", "batch"), ("dask", "worker"), ("dask", "scheduler")):
        subprocess.run(
            [str(tmp_path / "venv" / "bin" / program), argument, "--help"], cwd=tmp_path, env=bare, check=True, capture_output=True
        )


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("docker") is None or subprocess.run(["docker", "info"], capture_output=True).returncode != 0, reason="no Docker"
)
def test_the_image_is_built() -> None:
    subprocess.run(["docker", "build", "-f", str(FOLDER / "Dockerfile"), "-t", "lmeasure-test", str(ROOT)], check=True, timeout=1800)


def test_services_and_unit_begin_programs_of_the_image() -> None:
    """Every program that the compose file and the systemd unit name is in the folder that the Dockerfile fills."""
    programs = [
        word
        for path in (FOLDER / "compose.yaml", FOLDER / "lmeasure-worker.service")
        for line in path.read_text().splitlines()
        if "venv" in line
        for word in shlex.split(line.replace("[", " ").replace("]", " ").replace(",", " ").replace("=", " "))
        if "venv" in word
    ]
    assert {Path(program).name for program in programs} == {"dask", "lmeasure"}
    assert {str(Path(program).parent) for program in programs} == {"/opt/venv/bin"}
    (environment,) = (rest for word, rest in dockerfile() if word == "ENV")
    assert "/opt/venv/bin" in environment
