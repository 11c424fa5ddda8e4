"""The texts have no misspelling that codespell knows; pyproject.toml names the words that are none."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def test_no_word_is_misspelt() -> None:
    pytest.importorskip("codespell_lib")
    texts = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs", "lmeasure")
    done = subprocess.run([sys.executable, "-m", "codespell_lib", *texts], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")
