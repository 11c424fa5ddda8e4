"""The qualification by its command: it passes as the program is, and each planted fault fails it."""

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pypdfium2
import pytest
from in_process import ran, refused

from lmeasure import api
from lmeasure.certificate import read_public_key
from lmeasure.qualification import checks, judge_all, published_budgets, run_checks


def test_a_sound_installation_is_qualified_and_the_report_is_signed(tmp_path: Path) -> None:
    key, out = tmp_path / "k.pem", tmp_path / "q"
    ran("key", "--out", key)
    ran("qualify", "--out", out, "--key", key)
    content = json.loads((out / "qualification.json").read_bytes())
    assert content["passed"]
    assert len(content["checks"]) == 8
    signature = json.loads((out / "signature.json").read_bytes())
    read_public_key(key.with_name("k.pem.pub")).verify(base64.b64decode(signature["signature"]), (out / "qualification.json").read_bytes())
    text = pypdfium2.PdfDocument(out / "qualification.pdf")[0].get_textpage().get_text_bounded()
    assert "All checks passed" in text
    refused("qualify", "--out", out, code=2)


def test_nist_regressions_have_their_certified_values() -> None:
    """All 27 from both starts, and their standard deviations: MGH17's first start leads to a plateau."""
    every = list(judge_all())
    assert len(every) == 54
    assert all(j.converged for j in every)
    assert min(j.digits for j in every) > 5.0
    assert min(j.digits_of_u for j in every) > 5.0


@pytest.mark.parametrize(
    ("module", "name", "fault", "code"),
    [
        (checks, "span_lengths", lambda true: lambda rows, poses: true(rows, poses) + 1e-6, "cable_lengths"),
        (api, "reconstruct", lambda true: lambda run: _with(true(run), "systematic", 4.0), "coverage"),
        (api, "reconstruct", lambda true: lambda run: _with(true(run), "systematic", 0.1), "coverage"),
        (api, "evaluate", lambda true: lambda *given: _biased(true(*given)), "formulas"),
        (published_budgets, "propagate", lambda true: lambda *given, **more: [_wider(s) for s in true(*given, **more)], "budgets"),
        (checks, "judge_all", lambda true: lambda: [j.__class__(j.name, j.start, 2.0, 2.0, True) for j in true()], "regressions"),
        (api, "verify", lambda true: lambda folder: type("Seen", (), {"exit_code": 0})(), "sealed_certificates"),
    ],
)
def test_a_planted_fault_fails_it(monkeypatch: pytest.MonkeyPatch, module: Any, name: str, fault: Any, code: str) -> None:
    monkeypatch.setattr(module, name, fault(getattr(module, name)))
    (of,) = (check for check in checks.CHECKS if check.__name__ == code)
    assert not of().passed


def _wider(found: Any) -> Any:
    return replace(found, sensitivities=1.05 * found.sensitivities)


def _with(found: Any, field: str, factor: float) -> Any:
    return replace(found, **{field: getattr(found, field) * factor, "random": found.random * factor})


def _biased(found: Any) -> Any:
    return replace(found, characteristics=tuple(replace(c, value=c.value + 1e-6) for c in found.characteristics))


def test_an_error_in_a_check_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*given: object) -> np.ndarray:
        raise RuntimeError("broken")

    monkeypatch.setattr(checks, "span_lengths", broken)
    monkeypatch.setattr(checks, "CHECKS", (checks.cable_lengths, checks.formulas))
    assert [check.passed for check in run_checks(lambda done, of: None)] == [False, True]
