"""A certificate as a noun: its folder, and what stands in it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lmeasure.certificate.bundle import CERTIFICATE
from lmeasure.certificate.verification import read_certificate
from lmeasure.core import DataFrame, Shown, framed


@dataclass(frozen=True, repr=False)
class Certificate(Shown):
    """Sealed folder of a certificate with its certificate.json. Call `verify` before you rely on it.

    Examples
    --------
    >>> lm.Certificate.read("certificate").content["id"]  # doctest: +SKIP
    '0b6f7c52'
    """

    folder: Path
    """Folder of the certificate."""
    content: dict[str, Any]
    """Content of certificate.json."""

    @classmethod
    def read(cls, folder: Path) -> "Certificate":
        """The certificate of a folder; CertificationError or FileFormatError where it is none."""
        return cls(Path(folder), read_certificate(Path(folder) / CERTIFICATE))

    def about(self) -> dict[str, str]:
        """Number, figures, of how many the instrument is capable, where it lies."""
        figures = self.content["characteristics"]
        capable = sum(bool(f["capable"]) for f in figures)
        return {"id": self.content["id"], "characteristics": str(len(figures)), "capable": str(capable), "folder": str(self.folder)}

    def to_frame(self) -> DataFrame:
        """A row for each characteristic."""
        return framed(self.content["characteristics"])
