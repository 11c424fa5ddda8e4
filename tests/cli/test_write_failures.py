"""Each file operation of a command fails once: files are whole or as they were, one line says why, and a second run writes them."""

from pathlib import Path

import pytest
from desk import SHORT
from failing_files import Call, available, failing, run

pytestmark = pytest.mark.skipif(not available(), reason="this kernel lets no other process answer calls")


@pytest.mark.parametrize(("name", "answers"), [("key", ("ENOSPC",)), ("schema", ("EIO", "EINTR"))])
def test_every_operation_fails_once(name: str, answers: tuple[str, ...], desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kills are in `test_kills`, a recording on a full disk in `tests/acquisition/test_crash.py`."""
    monkeypatch.chdir(desk)
    found = failing(SHORT[name], desk / "out", answers, replacing=True)
    assert found.wrong == []
    assert found.failed >= 7
    assert found.reruns >= 1


def test_a_half_written_file_is_noticed(tmp_path: Path) -> None:
    """Nothing else here would show that the tests look."""

    def work() -> int:
        with (tmp_path / "a.json").open("wb", buffering=0) as file:
            file.write(b"{")
            try:
                file.write(b"}")
            except OSError:
                return 3
        return 0

    assert run(work, tmp_path).calls == [Call("openat", "a.json"), Call("write", "a.json"), Call("write", "a.json")]
    failed = run(work, tmp_path, 3, "ENOSPC")
    assert (failed.code, (tmp_path / "a.json").read_text()) == (3, "{")
    assert run(work, tmp_path, 2, "KILL").code == -9
