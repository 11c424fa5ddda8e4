"""Several cells in one workbench: their list, a scheduler for their jobs, and browsers of other machines."""

import asyncio
import datetime
import re
import ssl
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from bench import client
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID
from typer.testing import CliRunner

from lmeasure.cli.app import app
from lmeasure.core import LMeasureError
from lmeasure.register import Entry, Register, Result
from lmeasure.workbench import Site
from lmeasure.workbench.jobs import Jobs
from lmeasure.workbench.project_list import Shelf
from lmeasure.workbench.server import Served


class Closed:
    """A desk with nothing open."""

    def address(self, folder: Path, shelf: Shelf) -> str:
        raise AssertionError(folder)

    def is_open(self, folder: Path) -> bool:
        return False


def test_other_machines_come_by_tls_alone(tmp_path: Path) -> None:
    """By a name that is stated with its certificate: by that name alone, with a cookie that no plain connection is sent."""
    for words in (["--host", "localhost"], ["--tls-key", "x.pem"], ["--host", "localhost", "--tls-certificate", "x.pem"]):
        refused = CliRunner().invoke(app, ["workbench", str(tmp_path / "cell"), "--no-browser", *words])
        assert (refused.exit_code, "by TLS only" in " ".join(refused.output.replace("│", " ").split())) == (2, True), refused.output
    certificate, key = self_signed(tmp_path, "localhost")
    site = Site("localhost", certificate, key)
    with pytest.raises(LMeasureError, match="no certificate with its key"):
        Served(tmp_path / "cell", 0, "en", site=Site("localhost", key, certificate))
    served = Served(tmp_path / "cell", 0, "en", site=site, scheduler="tcp://127.0.0.1:1")
    served.begin()
    try:
        address = served.address()
        assert address.startswith("https://localhost:")
        trust = ssl.create_default_context(cafile=str(certificate))
        with urllib.request.urlopen(address, context=trust, timeout=30) as answer:
            assert "; secure;" in answer.headers["Set-Cookie"].lower() + ";"
        base, token = address.partition("/?")[0], (tmp_path / "cell" / ".workbench" / "token").read_text().strip()
        head = {"Authorization": f"Bearer {token}"}
        with urllib.request.urlopen(urllib.request.Request(base, headers=head), context=trust, timeout=30) as answer:
            text = answer.read().decode()
        assert "Other machines reach this server as localhost, by TLS" in text
        assert "tcp://127.0.0.1:1" in text
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(urllib.request.Request(base, headers=head | {"Host": "other"}), context=trust, timeout=30)
        with pytest.raises(OSError):  # noqa: PT011 - whatever a client that speaks no TLS meets
            urllib.request.urlopen(base.replace("https", "http"), timeout=30)
    finally:
        served.end()


def self_signed(folder: Path, name: str) -> tuple[Path, Path]:
    """Write a certificate for a name, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.UTC)
    made = x509.CertificateBuilder(subject, subject, key.public_key(), x509.random_serial_number(), now, now + datetime.timedelta(days=1))
    signed = made.add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False).sign(key, hashes.SHA256())
    paths = folder / "certificate.pem", folder / "key.pem"
    paths[0].write_bytes(signed.public_bytes(Encoding.PEM))
    paths[1].write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return paths


def test_a_list_of_cells_has_their_state(tmp_path: Path) -> None:
    """What each register states as due; what is overdue comes first, and a register that is none says so."""
    day = datetime.date.today() - datetime.timedelta(days=900)
    for cell in ("first", "second", "third", "fourth"):
        (tmp_path / cell).mkdir()
    for cell in ("second", "third"):
        register = Register(tmp_path / cell / "register")
        register.add([Entry("certificate", "a" * 64, "c", "R-1", day, {"AP_p P1": Result(0.5, 0.01, "mm")})], "A")
        register.close()
    limits = 'schema = "lmeasure.limits/1"\n[[limit]]\nsubject = "R-1"\nresult = "AP_p P1"\nupper = 0.55\n'
    (tmp_path / "third" / "register" / "limits.toml").write_text(limits)
    (tmp_path / "fourth" / "register").mkdir()
    (tmp_path / "fourth" / "register" / "register.sqlite").write_text("x" * 5000)
    found = {one.name: one for one in Shelf(tmp_path, Closed()).projects()}
    assert {name for name, one in found.items() if one.overdue} == {"third", "fourth"}
    assert list(found)[:2] == ["fourth", "third"]
    with client(tmp_path / "first", shelf=Shelf(tmp_path, Closed())) as session:
        text = session.get("/").text
    assert re.search(r"<small class=.warning.>R-1.*AP_p P1", text)
    assert "register: cannot be read" in text
    assert "register: 1 document" in text
    assert "This server answers to this machine only" in text


def test_jobs_go_to_the_scheduler_of_the_workbench(tmp_path: Path) -> None:
    jobs = Jobs(tmp_path, scheduler="tcp://127.0.0.1:1")

    async def lines() -> list[str]:
        begun = [await jobs.begin(words) for words in (["zone", "rig.toml"], ["key", "--out", "k"])]
        await jobs.close()
        return [job.line for job in begun]

    assert asyncio.run(lines()) == ["lmeasure zone --scheduler tcp://127.0.0.1:1 rig.toml", "lmeasure key --out k"]
